"""When a robot takes a keyframe, and what its front end uses."""

import numpy as np
import pytest

from twc_env.config import EnvConfig, override
from twc_env.records.messages import SensorFrame, SignReading
from twc_env.slam.matching.scan_matching import LineField
from twc_env.slam.robot import READINGS_MAX, FrontEnds

STEP_M, STEP_RAD = 0.05, 0.05
ROOM = [(-4, -4), (4, -4), (4, 4), (-4, 4)]
ROUND_A_CORNER = [(-2, -1), (6, -1), (6, 8), (4, 8), (4, 1), (-2, 1)]


def keyframes(scan, walls, corners, poses):
    """Keyframes of a robot without noise at a sequence of poses."""
    ends = FrontEnds(override(EnvConfig(), {"robots": 1}), 1)
    found, last = [], poses[0]
    for step, pose in enumerate(poses):
        motion = np.array([np.hypot(*(pose - last)[:2]), 0.0, pose[2] - last[2]])
        frame = SensorFrame(0, step, 0.1 * step, motion, 10 * motion[2], scan(walls(*corners), pose), None, ())
        found += ends.update([frame])
        last = pose
    return found


def straight(from_m, to_m):
    along = np.arange(from_m, to_m, STEP_M)
    return np.stack([along, np.zeros_like(along), np.zeros_like(along)], axis=1)


def test_in_a_fully_visible_room_keyframes_are_evenly_spaced(scan, walls):
    found = keyframes(scan, walls, ROOM, straight(-2.0, 2.0))
    gaps_m = np.diff([k.travel_m for k in found[1:]])
    assert gaps_m == pytest.approx(EnvConfig().slam.keyframe.distance_m, abs=1.1 * STEP_M)


def test_keyframes_are_denser_where_new_area_becomes_visible(scan, walls):
    found = keyframes(scan, walls, ROUND_A_CORNER, straight(-1.0, 5.0))
    travel_m = np.array([k.travel_m for k in found])
    gaps_m = np.diff(travel_m)[travel_m[1:] > 3.5]
    assert np.median(gaps_m) == pytest.approx(EnvConfig().slam.keyframe.distance_new_m, abs=1.1 * STEP_M)


def test_a_robot_turning_on_the_spot_takes_few_keyframes(scan, walls):
    angles = np.arange(0.0, 2 * np.pi, STEP_RAD)
    found = keyframes(scan, walls, ROOM, np.stack([0 * angles, 0 * angles, angles], axis=1))
    assert 6 <= len(found) <= 8, "one every radian"


@pytest.mark.parametrize("backend", ["compiled", "filterpy"])
def test_a_match_that_contradicts_the_odometry_without_better_fit_is_ignored(scan, walls, backend):
    poses, slip_m = straight(-2.0, 0.0), 0.03
    strict = {"slam.odometry_filter.match_gate": 1.0, "slam.odometry_filter.backend": backend}
    ends = FrontEnds(override(EnvConfig(), {"robots": 1, **strict}), 1)
    room, tracker = walls(*ROOM), ends._tracker
    for step in range(len(poses) + 1):
        moved_m = slip_m if step == len(poses) else STEP_M * (step > 0)
        seen = scan(room, poses[min(step, len(poses) - 1)])
        before = ends.poses_odom[0].copy()
        ends.update([SensorFrame(0, step, 0.1 * step, np.array([moved_m, 0.0, 0.0]), 0.0, seen, None, ())])
        assert tracker.information[0].any() == (0 < step < len(poses))
    assert ends.poses_odom[0, 0] - before[0] == pytest.approx(slip_m, abs=0.003)


def test_robots_with_different_clocks_are_tracked_independently(scan, walls):
    """The clocks of robots may start at any time, and their frame rates may differ."""
    poses, room = straight(-2.0, 1.0), walls(*ROOM)
    clocks = 0.1 * np.arange(len(poses)), 500.0 + 0.3 * np.arange(len(poses))

    def frame(robot, step):
        motion = np.array([STEP_M if step else 0.0, 0.0, 0.0])
        turn_rate = 0.02  # gyro bias, whose effect depends on the time between frames
        return SensorFrame(robot, step, clocks[robot][step], motion, turn_rate, scan(room, poses[step]), None, ())

    both = FrontEnds(override(EnvConfig(), {"robots": 2}), 2)
    alone = [FrontEnds(override(EnvConfig(), {"robots": 2}), 2) for _ in clocks]
    for step in range(len(poses)):
        found = both.update([frame(0, step), frame(1, step)])
        apart = [keyframe for robot in (0, 1) for keyframe in alone[robot].update([frame(robot, step)])]
        assert [(k.robot, k.time_s) for k in found] == [(k.robot, k.time_s) for k in apart]
    assert np.array_equal(both.poses_odom[0], alone[0].poses_odom[0])
    assert np.array_equal(both.poses_odom[1], alone[1].poses_odom[1])
    assert not np.array_equal(both.poses_odom[0], both.poses_odom[1])


def test_a_waiting_robot_keeps_only_its_latest_sign_readings(scan, walls):
    room, ends = walls((-6, -6), (6, -6), (6, 6), (-6, 6)), FrontEnds(EnvConfig(robots=1), 1)
    ranges_m = scan(room, (0.0, 0.0, 0.0))
    for step in range(1000):
        read = SignReading("EXIT" if step < 900 else "A101", 0.0, 6.0)
        ends.update([SensorFrame(0, step, 0.1 * step, np.zeros(3), 0.0, ranges_m, None, (read,))])
    (keyframe,) = ends.update([SensorFrame(0, 1000, 100.0, np.array([1.0, 0, 0]), 0.0, scan(room, (1.0, 0.0, 0.0)))])
    texts = [sign.text for sign in keyframe.signs]
    assert len(texts) == READINGS_MAX
    assert texts.count("A101") == 100


@pytest.mark.parametrize("has_lidar", [True, False])
def test_only_where_no_scans_are_matched_all_walls_around_a_sign_tell_its_facing(scan, walls, monkeypatch, has_lidar):
    monkeypatch.setattr(LineField, "facing_at", lambda *_: 1.0)
    monkeypatch.setattr(LineField, "facing_around", lambda *_: 2.0)
    ends = FrontEnds(override(EnvConfig(), {"robots": 1, "slam.cues.lidar": has_lidar}), 1)
    signs = (SignReading("A101", 0.0, 2.0),)
    (first,) = ends.update([SensorFrame(0, 0, 0.0, np.zeros(3), 0.0, scan(walls(*ROOM), np.zeros(3)), None, signs)])
    assert first.signs[0].facing_rad == (1.0 if has_lidar else 2.0)


@pytest.mark.parametrize("backend", ["compiled", "filterpy"])
def test_without_laser_gyro_bias_updates_do_not_move_a_robot_turning_on_the_spot(backend):
    """Otherwise each update would move the end of the whole path, and hence change the motion between keyframes."""
    settings = {"robots": 1, "slam.cues.lidar": False, "slam.odometry_filter.backend": backend}
    ends, random, blind = FrontEnds(override(EnvConfig(), settings), 1), np.random.default_rng(0), np.zeros(180)
    found, gone_m = [], 30.0
    for step in range(800):
        ahead_m, turn = (STEP_M, 0.0) if STEP_M * step < gone_m else (0.0, STEP_RAD)
        odometry = np.array([ahead_m, 0.0, turn + random.normal(0, 0.01)])
        found += ends.update([SensorFrame(0, step, 0.1 * step, odometry, 10 * turn + 0.004, blind, None, ())])
    turning = [k for k in found if STEP_M * k.step > gone_m][1:]
    assert len(turning) > 8
    assert max(np.hypot(*k.motion[:2]) for k in turning) < 0.01
