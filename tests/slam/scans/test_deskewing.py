"""Scans of any geometry on a circle around the robot, against exact ranges of a room."""

import dataclasses
import math

import numpy as np
import pytest

from twc_env.config import EnvConfig, override
from twc_env.records.geometry import between, compose
from twc_env.records.messages import UNSEEN_M, SensorFrame
from twc_env.records.scanner import Scanner
from twc_env.slam.front_end.scan_intake import ScanIntake

DIRECTIONS = 180
CONFIG = override(EnvConfig(robots=2), {"lidar.beam_count": DIRECTIONS, "lidar.range_max_m": 10.0})


def room_range(pose, angle_rad):
    """Range to the walls of a room of 6 x 5 m around the origin."""
    x, y, heading = pose
    dx, dy = math.cos(heading + angle_rad), math.sin(heading + angle_rad)
    along_x = ((3.0 if dx > 0 else -3.0) - x) / dx if abs(dx) > 1e-12 else math.inf
    along_y = ((2.5 if dy > 0 else -2.5) - y) / dy if abs(dy) > 1e-12 else math.inf
    return min(along_x, along_y)


def circle_at(pose):
    return np.array([room_range(pose, 2 * np.pi * k / DIRECTIONS) for k in range(DIRECTIONS)])


def scan_along(scanner: Scanner, beams: int, poses_at) -> np.ndarray:
    """Ranges of each beam; poses_at: time before the end of the scan -> pose of the robot."""
    ranges = []
    for beam in range(beams):
        pose = compose(poses_at(scanner.sweep_s * (1 - beam / (beams - 1))), np.array(scanner.mount))
        ranges.append(room_range(pose, scanner.first_rad + beam * scanner.step_rad))
    return np.array(ranges)


def frame(ranges_m, scanner, time_s=0.0, odometry=(0.0, 0.0, 0.0), turn_rate=0.0, step=0, robot=0):
    return SensorFrame(robot, step, time_s, np.array(odometry, float), turn_rate, ranges_m, scanner=scanner)


def taken(frames, **settings):
    """The last circle after these frames of one robot."""
    intake = ScanIntake(override(CONFIG, settings), 2)
    for each in frames:
        _, (circle,) = intake.on_circle([each])
    return circle


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("beams", [180, 360, 500])
@pytest.mark.parametrize("mount", [(0.0, 0.0, 0.0), (0.2, -0.1, 0.6)])
def test_a_standing_scanner_gives_the_exact_circle(side, beams, mount):
    scanner = Scanner(0.3, side * 2 * math.pi / beams, mount, 0.1, 10.0)
    here = np.array([0.4, -0.3, 0.2])
    circle = taken([frame(scan_along(scanner, beams, lambda _: here), scanner)])
    errors = np.abs(circle - circle_at(here))
    assert np.quantile(errors, 0.95) < 1e-6
    assert errors.max() < 0.05, "corners of the room may be cut"


@pytest.mark.parametrize("side", [1, -1])
def test_a_rolling_scan_is_undone_by_odometry_and_gyro(side):
    scanner = Scanner(0.0, side * 2 * math.pi / 360, (0.1, 0.0, 0.0), 0.0, 10.0, sweep_s=0.2 * 359 / 360)
    start, speed, rate = np.array([-0.5, 0.2, 0.1]), 1.0, 1.2

    def pose_at(time_s):
        angle = rate * time_s
        return compose(start, np.array([speed / rate * math.sin(angle), speed / rate * (1 - math.cos(angle)), angle]))

    def frames():
        last = pose_at(0.0)
        for k in range(5):
            pose = pose_at(0.1 * k)
            ranges = scan_along(scanner, 360, lambda back, k=k: pose_at(max(0.1 * k - back, 0.0)))
            yield frame(ranges, scanner, 0.1 * k, between(last, pose), rate if k else 0.0, k)
            last = pose

    truth = circle_at(pose_at(0.4))
    undone = np.abs(taken(frames()) - truth)
    bent = np.abs(taken(frames(), **{"slam.undoes_rolling": False}) - truth)
    assert np.quantile(undone[undone < 1.0], 0.95) < 0.005
    assert np.median(bent) > 0.1
    assert (undone > 1.0).sum() <= 360 * 0.24 / (2 * math.pi) + 2, "a robot that turns against its scanner sees less"


@pytest.mark.parametrize("nothing", [0.0, math.nan, math.inf, 10.0, 25.0, 0.05])
@pytest.mark.parametrize("free_m", [math.inf, 2.0, 0.0])
def test_every_way_to_tell_no_return_is_one(nothing, free_m):
    scanner = Scanner(0.0, 2 * math.pi / 180, range_min_m=0.1, range_max_m=10.0, free_m=free_m)
    ranges = np.full(180, 3.0)
    ranges[60:70] = nothing
    circle = taken([frame(ranges, scanner)])
    assert (circle[61:69] == (10.0 if free_m else UNSEEN_M)).all()
    assert circle[:60] == pytest.approx(3.0) and circle[71:] == pytest.approx(3.0)


def test_negative_ranges_and_directions_without_beams_have_no_information():
    scanner = Scanner(-math.pi / 2, math.pi / 180, range_max_m=10.0)
    ranges = np.full(181, 3.0)
    ranges[100:110] = -1.0
    circle = taken([frame(ranges, scanner)])
    behind = np.arange(DIRECTIONS)
    assert (circle[(behind > 46) & (behind < 134)] == UNSEEN_M).all()
    assert (circle[6:9] == UNSEEN_M).all(), "10 to 19 degrees to the left"


def test_a_scan_of_earlier_is_shown_from_where_the_robot_is_now():
    scanner = Scanner(0.0, 2 * math.pi / 360, range_max_m=10.0)
    first, later = np.array([0.0, 0.0, 0.0]), np.array([0.3, 0.0, 0.2])
    seen = scan_along(scanner, 360, lambda _: first)
    intake = ScanIntake(CONFIG, 2)
    intake.on_circle([frame(seen, scanner)])
    (passed,), (circle,) = intake.on_circle([frame(seen[:0], scanner, 0.1, later, 2.0, 1)])
    assert passed.ranges_m.shape == (0,)
    assert np.quantile(np.abs(circle - circle_at(later)), 0.9) < 0.01


def test_frames_without_scanner_pass_unchanged():
    plain = frame(np.full(DIRECTIONS, 3.0), None)
    (passed,), (circle,) = ScanIntake(CONFIG, 2).on_circle([plain])
    assert passed is plain and circle is plain.ranges_m


def test_each_robot_has_its_own_scanner():
    scanners = [
        Scanner(0.0, 2 * math.pi / 360, range_max_m=10.0),
        Scanner(-2.35, math.radians(0.25), (0.1, 0, 0), 0.1, 8.0),
    ]
    intake = ScanIntake(CONFIG, 2)
    here = np.array([0.2, 0.1, 0.0])
    frames = [
        frame(scan_along(scanner, beams, lambda _: here), scanner, robot=robot)
        for robot, (scanner, beams) in enumerate(zip(scanners, (360, 1081), strict=True))
    ]
    _, circles = intake.on_circle(frames)
    known = circles[1] != UNSEEN_M
    assert known.mean() == pytest.approx(0.75, abs=0.05)
    assert np.quantile(np.abs(circles[0] - circles[1])[known], 0.95) < 1e-3


def test_the_latest_scanner_says_what_no_return_means():
    intake = ScanIntake(CONFIG, 2)
    for free_m in (math.inf, 2.0):
        scanner = dataclasses.replace(Scanner(0.0, 2 * math.pi / 180), free_m=free_m)
        intake.on_circle([frame(np.full(180, 3.0), scanner)])
        assert intake.free_m.tolist() == [free_m, math.inf]
