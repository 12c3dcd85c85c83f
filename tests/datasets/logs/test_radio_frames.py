import numpy as np
import pytest

import twc_env
from tests.real_data import DATA, needs_data
from twc_env.config import EnvConfig, override
from twc_env.datasets.logs.radio_frames import radio_frames
from twc_env.datasets.surveys.step_heading import read_walks
from twc_env.datasets.surveys.uw_floor import read_uw_floor
from twc_env.errors import DataError
from twc_env.metrics import absolute_trajectory_error_m
from twc_env.records.geometry import compose
from twc_env.records.messages import Fingerprint
from twc_env.reproduce.logs.real_radio import drifted

RADIO_ALONE = {"slam.cues.lidar": False, "slam.cues.text": False}


def config(robots):
    return override(EnvConfig(robots=robots), RADIO_ALONE)


def heard(count):
    return [Fingerprint(np.array([7], np.int64), np.array([-50.0 - k])) for k in range(count)]


def test_frames_hold_the_path_the_turns_and_the_scans():
    poses = np.array([[1.0, 2.0, 0.5], [2.0, 2.0, 3.0], [2.0, 4.0, -3.0]])
    turned = np.array([2.5, 0.2832])
    frames = radio_frames(np.array([10.0, 12.0, 13.0]), poses, turned, heard(3), 36, robot=2)
    pose = poses[0]
    for k, frame in enumerate(frames):
        pose = compose(pose, frame.odometry)
        assert pose == pytest.approx(poses[k])
        assert (frame.robot, frame.step, frame.wifi.rssi_dbm[0]) == (2, k, -50.0 - k)
        assert len(frame.ranges_m) == 36
    assert [frame.time_s for frame in frames] == [0.0, 2.0, 3.0]
    assert [frame.turn_rate_rad_s for frame in frames] == pytest.approx([0.0, 1.25, 0.2832])


@pytest.mark.parametrize("times, scans", [((0.0, 1.0), 3), ((0.0, 2.0, 2.0), 3), ((0.0, 1.0, 2.0), 2)])
def test_a_recording_that_contradicts_itself_is_refused(times, scans):
    with pytest.raises(DataError):
        radio_frames(np.array(times), np.zeros((3, 3)), np.zeros(2), heard(scans), 36)


@pytest.mark.parametrize(
    "changes",
    [
        {"reckoned": np.zeros((3, 2))}, {"reckoned": np.full((3, 3), np.nan)}, {"turned_rad": np.full(2, np.inf)},
        {"times_s": [0.0, 1.0, np.inf]}, {"fingerprints": [None] * 3},
    ],
)  # fmt: skip
def test_a_recording_with_values_missing_is_refused(changes):
    recording = {"times_s": [0.0, 1.0, 2.0], "reckoned": np.zeros((3, 3)), "turned_rad": np.zeros(2)}
    with pytest.raises(DataError):
        radio_frames(**{**recording, "fingerprints": heard(3), "beam_count": 36, **changes})


def test_odometry_makes_the_whole_turns_that_the_gyro_counts():
    poses, turned = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 3.3], [1.0, 1.0, 0.0]]), np.array([3.3, -3.2])
    frames = radio_frames(np.array([0.0, 2.0, 3.0]), poses, turned, heard(3), 36)
    assert [frame.odometry[2] for frame in frames] == pytest.approx([0.0, 3.3, -3.3])
    assert [frame.turn_rate_rad_s for frame in frames] == pytest.approx([0.0, 1.65, -3.2])


@needs_data
def test_the_engine_runs_on_a_robots_radio_log_and_puts_its_odometry_right():
    survey = read_uw_floor(DATA / "wifi" / "uw_floor" / "uw-floor.txt")
    true, shares = np.column_stack([survey.position_m, np.zeros(len(survey.position_m))]), []
    for seed in range(8):
        log = drifted(survey, seed)
        engine = twc_env.CooperativeSlam(config(1), 1)
        frames = radio_frames(survey.time_s, log.odometry, log.turned_rad, log.fingerprints, config(1).lidar.beam_count)
        for frame in frames:
            engine.update([frame])
        engine.finish()
        chosen = engine.team.keyframe_steps(0)
        by_engine, by_odometry = (
            absolute_trajectory_error_m(poses, true[chosen])
            for poses in (engine.team.poses_of(0), log.odometry[chosen])
        )
        shares.append(by_engine / by_odometry)
    assert max(shares) < 1.0
    assert np.mean(shares) < 0.25


@needs_data
def test_the_engine_runs_on_walks_of_phones():
    walks = read_walks(DATA / "indoor20" / "site2_F6", traces_max=3)
    settings = config(len(walks))
    engine = twc_env.CooperativeSlam(settings, len(walks))
    logs = [
        radio_frames(w.time_s, w.reckoned, w.turned_rad, w.fingerprints, settings.lidar.beam_count, robot)
        for robot, w in enumerate(walks)
    ]
    for step in range(max(map(len, logs))):
        engine.update([frames[step] for frames in logs if step < len(frames)])
    engine.finish()
    for robot, walk in enumerate(walks):
        path = engine.team.poses_of(robot)
        assert len(path) > 2 and np.isfinite(path).all()
        there = np.linalg.norm(walk.reckoned[-1, :2] - walk.reckoned[0, :2])
        assert np.linalg.norm(path[-1, :2] - path[0, :2]) == pytest.approx(there, rel=0.3, abs=2.0)
