"""Invalid frames are rejected before a kernel reads outside an array."""

from dataclasses import replace

import numpy as np
import pytest

from twc_env.config import EnvConfig, override
from twc_env.errors import ConfigError, DataError, TwcError
from twc_env.records.messages import UNSEEN_M, SensorFrame, SignReading, WifiScan
from twc_env.records.scanner import Scanner
from twc_env.slam.engine import CooperativeSlam
from twc_env.slam.matching.scan_matching import LineField

CONFIG = override(EnvConfig(), {"lidar.beam_count": 60, "robots": 2})
SOUND = SensorFrame(
    0, 0, 0.0, np.zeros(3), 0.0, np.full(60, 3.0), WifiScan(np.array([1, 2]), np.array([-40.0, -50.0])),
    (SignReading("A101", 0.0, 2.0),),
)  # fmt: skip


def scan(macs, rssi_dbm) -> WifiScan:
    return WifiScan(np.array(macs), np.array(rssi_dbm))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ranges_m": np.full(59, 3.0)}, "lidar.beam_count is 60"),
        ({"ranges_m": np.full(180, 3.0)}, "lidar.beam_count is 60"),
        ({"ranges_m": np.full(60, np.nan)}, "no numbers"),
        ({"ranges_m": np.r_[np.full(59, 3.0), 0.0]}, "ranges that are 0 or no numbers"),
        ({"robot": 0.0}, "different robots 0 to 1"),
        ({"step": None}, "has a step that is not a whole number"),
        ({"robot": 2}, "different robots 0 to 1"),
        ({"robot": -1}, "different robots 0 to 1"),
        ({"odometry": np.array([0.0, np.nan, 0.0])}, "motion since the last frame"),
        ({"odometry": np.array([1e6, 0.0, 0.0])}, "motion since the last frame"),
        ({"odometry": np.zeros(2)}, "motion since the last frame"),
        ({"turn_rate_rad_s": float("nan")}, "must be finite"),
        ({"time_s": float("inf")}, "must be finite"),
        ({"signs": (SignReading("A", float("nan"), 2.0),)}, "finite bearing"),
        ({"signs": (SignReading(None, 0.0, 2.0),)}, "give a text"),
        ({"signs": (SignReading("\ud800", 0.0, 2.0),)}, "surrogates"),
        ({"wifi": scan([2, 1], [-40.0, -50.0])}, "do not ascend"),
        ({"wifi": scan([1, 1], [-40.0, -50.0])}, "do not ascend"),
        ({"wifi": scan(np.array([2, 1], np.uint64), [-40.0, -50.0])}, "do not ascend"),
        ({"wifi": scan(np.array([1, 2**63], np.uint64), [-40.0, -50.0])}, "more than 63 bits"),
        ({"wifi": scan([1, 2], [-40.0, -999.0])}, "-999 dBm: leave out what was not heard"),
        ({"wifi": scan([1, 2, 3], [-40.0, -50.0])}, "strengths"),
        ({"wifi": scan([1, 2], [-40.0, np.nan])}, "what was not heard"),
        ({"wifi": scan([1.5, 2.0], [-40.0, -50.0])}, "whole numbers"),
        ({"wifi": replace(scan([1, 2], [-40.0, -50.0]), age_s=np.zeros(1))}, "one age each"),
        ({"wifi": replace(scan([1, 2], [-40.0, -50.0]), age_s=np.array([0.0, np.nan]))}, "one age each"),
        ({"wifi": scan(["aa:01", "aa:02"], [-40.0, -50.0])}, r"such as .*'aa:01'.*: int\(mac.replace\(':', ''\), 16\)"),
        ({"wifi": scan([1, 2], [40.0, 50.0])}, "a WiFi scan with strengths from 40 to 50: give dBm"),
        ({"wifi": {1: -40.0}}, r"has dict as WiFi: give WifiScan"),
        ({"signs": (("A101", 0.0, 2.0),)}, r"holds \('A101', 0.0, 2.0\) as a sign: give SignReading"),
        ({"signs": (SignReading("A101", 0.0, -2.0),)}, "a finite, non-negative range"),
        ({"time_s": 1.7e18}, "is of 1.7e\\+18 s, which no clock shows: times are in seconds"),
        ({"wifi": scan([1, 2], ["loud", "low"])}, "values of another kind"),
        ({"ranges_m": np.array(["far"] * 60)}, "values of another kind"),
        ({"turn_rate_rad_s": "left"}, "values of another kind"),
        ({"odometry": ("x", 0.0, 0.0)}, "values of another kind"),
        ({"signs": None}, "values of another kind"),
    ],
)
def test_an_invalid_frame_is_rejected(changes, message):
    engine = CooperativeSlam(CONFIG, 2)
    with pytest.raises(DataError, match=message):
        engine.update([replace(SOUND, **changes)])
    engine.update([SOUND, replace(SOUND, robot=1)])
    assert engine.belief(0).grid.log_odds.any(), "nothing is broken by it"


@pytest.mark.parametrize("count", [0, -1, 2.5, "2", None, 65, 10**39])
def test_an_invalid_number_of_robots_is_rejected(count):
    with pytest.raises(ConfigError, match=f"robot_count must be a whole number from 1 to 64; got {count!r}"):
        CooperativeSlam(CONFIG, count)


def test_empty_frames_and_two_frames_of_one_robot_are_rejected():
    for frames in ([], [SOUND, SOUND]):
        with pytest.raises(DataError, match=r"no frames|different robots"):
            CooperativeSlam(CONFIG, 2).update(frames)


@pytest.mark.parametrize(
    ("given", "named"),
    [
        (SOUND, "a SensorFrame"), (None, "a NoneType"), ([SOUND, None], "a list of SensorFrame, NoneType"),
        (["frame"], "a list of str"),
    ],
)  # fmt: skip
def test_the_error_of_an_invalid_list_of_frames_names_its_type(given, named):
    with pytest.raises(DataError, match=f"give a list of SensorFrame, one for each robot; got {named}$"):
        CooperativeSlam(CONFIG, 2).update(given)


@pytest.mark.parametrize("nothing", [np.inf, UNSEEN_M, 1e9])
def test_ranges_of_beams_without_return_may_exceed_the_maximum(nothing):
    ranges_m = np.full(60, 3.0)
    ranges_m[10:20] = nothing
    engine = CooperativeSlam(CONFIG, 2)
    engine.update([replace(SOUND, ranges_m=ranges_m)])
    assert np.isfinite(engine.pose_map_robot(0)).all()


def test_non_finite_scans_and_poses_are_not_drawn():
    field = LineField(size_m=24.0, resolution_m=0.1, range_max_m=10.0)
    scans = np.full((1, 60), 3.0)
    field.add(np.zeros((1, 3)), scans)
    for poses, drawn in ((np.zeros((1, 3)), np.full((1, 60), np.nan)), (np.full((1, 3), np.inf), scans)):
        with pytest.raises(DataError, match="numbers"):
            field.add(poses, drawn)


@pytest.mark.parametrize("kind", [np.float32, np.float16, ">f8", np.int64])
def test_frames_of_other_number_types_are_accepted_at_any_time(kind):
    later = {"odometry": np.zeros(3, kind), "ranges_m": np.full(60, 3, kind), "step": 1, "time_s": 1}
    engine, same = CooperativeSlam(CONFIG, 2), CooperativeSlam(CONFIG, 2)
    for each, changes in ((engine, later), (same, {"step": 1, "time_s": 1.0})):
        each.update([SOUND])
        each.update([replace(SOUND, **changes)])
        each.update([replace(SOUND, step=2, time_s=2.0)])
    assert engine.belief(0).pose_map_robot.tobytes() == same.belief(0).pose_map_robot.tobytes()


@pytest.mark.parametrize("robot", [2, -1])
def test_a_robot_outside_the_team_is_rejected(robot):
    engine = CooperativeSlam(CONFIG, 2)
    team = engine.team
    for asked in (engine.belief, engine.pose_map_robot, engine.mapper_of, team.poses_of, team.keyframe_steps):
        with pytest.raises(TwcError, match=f"robots are 0 to 1; got {robot}"):
            asked(robot)
    with pytest.raises(TwcError, match=f"groups are 0 to 1; got {robot}"):
        team.grid_of(robot)


def test_an_engine_needs_a_config():
    with pytest.raises(ConfigError, match="config must be an EnvConfig"):
        CooperativeSlam({"robots": 2}, 2)


@pytest.mark.parametrize("time_s", [0.9, 1.0])
def test_frames_that_go_back_in_time_are_rejected(time_s):
    engine = CooperativeSlam(CONFIG, 2)
    engine.update([replace(SOUND, time_s=1.0)])
    with pytest.raises(DataError, match="give frames in order, each with its time"):
        engine.update([replace(SOUND, time_s=time_s, odometry=np.array([0.1, 0.0, 0.0]))])
    engine.update([replace(SOUND, time_s=1.0), replace(SOUND, robot=1, time_s=0.5)])


@pytest.mark.parametrize("begun_s", [(1.6e9, 1.6e9), (-50.0, 0.0), (0.0, 300.0)])
def test_clocks_may_start_at_any_time(begun_s):
    """The time before a robot's first frame does not count as time in which it turned or read nothing."""
    engine, same = CooperativeSlam(CONFIG, 2), CooperativeSlam(CONFIG, 2)
    around = 2 * np.pi * np.arange(60) / 60
    for step in range(30):
        heading = 0.1 * (step + 1) + around
        scan_m = 3.0 / np.maximum(abs(np.cos(heading)), abs(np.sin(heading)))
        frame = replace(SOUND, step=step, odometry=np.array([0.0, 0.0, 0.1]), turn_rate_rad_s=1.0, ranges_m=scan_m)
        for each, clocks in ((engine, begun_s), (same, (0.0, 0.0))):
            each.update([replace(frame, robot=r, time_s=clock + 0.1 * step) for r, clock in enumerate(clocks)])
    for robot in range(2):
        found, expected = engine.belief(robot), same.belief(robot)
        assert np.allclose(found.pose_odom, expected.pose_odom, atol=1e-5)
        assert np.allclose(found.pose_std, expected.pose_std, rtol=1e-3)
        times_s = [[keyframe.time_s for keyframe in each.team.keyframes[robot]] for each in (engine, same)]
        assert np.allclose(*times_s, atol=1e-5)


LASER = Scanner(-1.5, 0.05, range_max_m=10.0)


@pytest.mark.parametrize(
    ("scanner", "beams", "message"),
    [
        ("lms-200", 61, r"has 'lms-200' as scanner: give a twc_env.records.scanner.Scanner"),
        (
            replace(LASER, step_rad=1.0),
            61,
            "61 beams 1 rad apart: they must be on one circle; give step_rad in radians",
        ),
        (replace(LASER, step_rad=0.0), 61, "61 beams 0 rad apart"),
        (replace(LASER, first_rad=float("nan")), 61, "give finite numbers"),
        (replace(LASER, mount=(0.0, 0.0)), 61, "a pose as mount"),
        (replace(LASER, mount=None), 61, "values of another kind"),
        (replace(LASER, sweep_s=-0.1), 61, "a time above 0 as sweep_s"),
        (replace(LASER, free_m=float("nan")), 61, "give finite numbers"),
        (LASER, (2, 61), r"has ranges of shape \(2, 61\)"),
    ],
)
def test_a_frame_with_an_impossible_scanner_is_rejected(scanner, beams, message):
    engine = CooperativeSlam(CONFIG, 2)
    with pytest.raises(DataError, match=message):
        engine.update([replace(SOUND, scanner=scanner, ranges_m=np.full(beams, 3.0))])
    engine.update([replace(SOUND, scanner=LASER, ranges_m=np.full(61, 3.0)), replace(SOUND, robot=1)])
    assert engine.belief(0).grid.log_odds.any()


@pytest.mark.parametrize("count", [1, 2, 3, 126])
def test_scans_of_any_number_of_beams_are_taken(count):
    engine = CooperativeSlam(CONFIG, 2)
    engine.update([replace(SOUND, scanner=LASER, ranges_m=np.full(count, 3.0))])
    assert engine.belief(0).ranges_m.shape == (60,)


def test_robots_without_a_scan_in_a_step_keep_their_place_and_take_no_keyframe():
    engine = CooperativeSlam(CONFIG, 2)
    for step in range(30):
        moved = {"step": step, "time_s": 0.1 * step, "odometry": np.array([0.1 * (step > 0), 0.0, 0.0])}
        keyframes = engine.track([replace(SOUND, ranges_m=np.zeros(0), **moved)])
        engine.absorb(step)
        assert not keyframes
    assert engine.belief(0).pose_odom[0] == pytest.approx(2.9, abs=0.3)
    assert engine.track([replace(SOUND, step=30, time_s=3.0)])
