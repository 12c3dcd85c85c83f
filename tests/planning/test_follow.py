"""Path following and obstacle avoidance, in closed loop with an ideal robot and scanner."""

import math

import numpy as np
import pytest

from twc_env.config import DynamicsConfig, EnvConfig, override, robot_configs
from twc_env.planning.follow import Follower, as_action, can_reverse, drive_to
from twc_env.records.messages import GridMap

DYNAMICS = DynamicsConfig()


def drive(pose, speed, turn_rate):
    heading = pose[2] + 0.5 * turn_rate * 0.1
    moved = pose + [speed * 0.1 * math.cos(heading), speed * 0.1 * math.sin(heading), turn_rate * 0.1]
    moved[2] = math.remainder(moved[2], 2 * math.pi)
    return moved


def scan_of_box(pose, half_x, half_y, beams=180):
    """Ranges in an axis-parallel box around the origin."""
    angles = pose[2] + np.arange(beams) * 2 * np.pi / beams
    with np.errstate(divide="ignore"):
        x = np.where(np.cos(angles) > 0, half_x - pose[0], -half_x - pose[0]) / np.cos(angles)
        y = np.where(np.sin(angles) > 0, half_y - pose[1], -half_y - pose[1]) / np.sin(angles)
    return np.minimum(np.minimum(np.abs(x), np.abs(y)), 10.0)


def scan_of_disc(pose, centre, radius, beams=180):
    """Ranges in the open with one disc."""
    angles = pose[2] + np.arange(beams) * 2 * np.pi / beams
    dx, dy = centre[0] - pose[0], centre[1] - pose[1]
    along = dx * np.cos(angles) + dy * np.sin(angles)
    beside2 = dx * dx + dy * dy - along**2
    hit = (along > 0) & (beside2 < radius**2)
    return np.where(hit, along - np.sqrt(np.maximum(radius**2 - beside2, 0)), 10.0)


@pytest.mark.parametrize("heading", [0.0, 1.5, 3.1, -2.0])
def test_a_path_is_followed_to_its_end(heading):
    follower = Follower(DYNAMICS)
    path = np.array([[0, 0], [2, 0], [2, 2], [0, 2.5]])
    follower.start(path)
    pose, furthest = np.array([0, 0, heading]), 0.0
    for _ in range(120):
        pose = drive(pose, *follower.command(pose, None))
        furthest = max(furthest, distance_to(path, pose))
    assert math.hypot(*(pose[:2] - path[-1])) < 0.2
    assert furthest < 0.35


def distance_to(path, pose):
    a, b = path[:-1], path[1:]
    t = np.clip(((pose[:2] - a) * (b - a)).sum(1) / ((b - a) ** 2).sum(1), 0, 1)[:, None]
    return np.hypot(*(pose[:2] - a - t * (b - a)).T).min()


def test_without_a_path_the_robot_stops():
    follower = Follower(DYNAMICS)
    assert follower.command(np.zeros(3), None) == (0.0, 0.0)
    follower.start(np.array([[0, 0], [1, 0]]))
    follower.stop()
    assert follower.command(np.zeros(3), None) == (0.0, 0.0)


@pytest.mark.parametrize("start", [(0.0, 0.0, 0.0), (1.0, 0.4, 2.0), (-1.2, -0.5, -1.0)])
def test_a_robot_never_hits_the_wall_in_front_of_its_goal(start):
    pose = np.array(start)
    for _ in range(150):
        speed, turn_rate = drive_to(
            *(rotation(-pose[2]) @ (np.array([5.0, 3.0]) - pose[:2])), scan_of_box(pose, 2.0, 1.0), DYNAMICS
        )
        pose = drive(pose, speed, turn_rate)
        assert abs(pose[0]) < 2.0 - DYNAMICS.robot_radius_m
        assert abs(pose[1]) < 1.0 - DYNAMICS.robot_radius_m


def rotation(angle):
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def test_a_teammate_on_the_path_is_driven_around():
    follower = Follower(DYNAMICS)
    follower.start(np.array([[0.0, 0.0], [5.0, 0.0]]))
    pose, teammate, nearest = np.zeros(3), np.array([2.5, 0.05]), 10.0
    for _ in range(150):
        pose = drive(pose, *follower.command(pose, scan_of_disc(pose, teammate, 0.2)))
        nearest = min(nearest, math.hypot(*(pose[:2] - teammate)))
    assert nearest > 0.4
    assert pose[0] > 4.7


def test_a_patient_robot_waits_behind_an_obstacle():
    speed, _ = drive_to(1.0, 0.0, scan_of_disc(np.zeros(3), (0.48, 0.0), 0.2), DYNAMICS, patience=True)
    assert speed == 0.0


def test_a_robot_that_reverses_is_sooner_back_and_keeps_off_what_is_behind_it():
    ticks = {}
    for reverses in (False, True):
        follower, pose = Follower(DYNAMICS, reverses=reverses), np.array([0.0, 0.0, 0.1])
        follower.start(np.array([[0.0, 0.0], [-4.0, 0.0]]))
        teammate, nearest, speeds = np.array([-2.0, 0.05]), 10.0, []
        while math.hypot(*(pose[:2] - (-4.0, 0.0))) > 0.3:
            speed, turn_rate = follower.command(pose, scan_of_disc(pose, teammate, 0.2))
            pose = drive(pose, speed, turn_rate)
            speeds.append(speed)
            nearest = min(nearest, math.hypot(*(pose[:2] - teammate)))
        ticks[reverses] = len(speeds)
        assert nearest > 0.4
        assert (min(speeds) < -0.5) == reverses
    assert ticks[True] + 10 < ticks[False], "half a turn is 2 s"


def test_who_drives_backwards_sees_all_around_and_is_carried_by_nobody():
    assert can_reverse(EnvConfig())
    assert not can_reverse(override(EnvConfig(), {"lidar.field_of_view_rad": 4.7}))
    assert [can_reverse(own) for own in robot_configs(override(EnvConfig(), {"team": "twc-slam"}))] == [
        False,
        True,
        True,
    ]


def test_a_robot_slows_down_in_a_narrow_passage():
    wide, _ = drive_to(1.0, 0.0, scan_of_box(np.zeros(3), 9.0, 2.0), DYNAMICS)
    narrow, _ = drive_to(1.0, 0.0, scan_of_box(np.zeros(3), 9.0, 0.3), DYNAMICS)
    assert 0.0 < narrow < wide == pytest.approx(1.0)


def test_actions_are_shares_of_the_maxima_and_clipped():
    assert np.allclose(as_action(0.5, -0.75, DYNAMICS), [0.5, -0.5])
    assert np.allclose(as_action(9.0, -9.0, DYNAMICS), [1.0, -1.0])


def follower_in_room(wall_at_m=None):
    """A follower of a path of 8 m from x = 1, in a room of 10 x 6 m, and its grid."""
    levels = np.full((60, 100), -8, np.int16)
    levels[[0, -1]] = levels[:, [0, -1]] = 10
    if wall_at_m is not None:
        levels[round(wall_at_m[1] / 0.1), round(wall_at_m[0] / 0.1)] = 10
    follower = Follower(DYNAMICS)
    follower.start(np.array([[1.0, 3.0], [9.0, 3.0]]))
    return follower, GridMap(levels, np.zeros(2), 0.1)


def test_a_new_wall_on_the_path_blocks_it_once_it_is_within_three_metres_ahead():
    pose = np.array([1.0, 3.0, 0.0])
    for wall_at_m, is_blocked in ((None, False), ((2.0, 3.1), True), ((2.0, 3.4), False), ((5.0, 3.1), False)):
        follower, grid = follower_in_room(wall_at_m)
        assert follower.is_blocked(pose, grid, 0.2) == is_blocked
    assert follower.is_blocked(np.array([3.0, 3.0, 0.0]), grid, 0.2)


def test_a_path_far_outside_the_map_is_not_blocked():
    follower, grid = follower_in_room()
    follower.start(np.array([[1e4, -1e4], [1e4, -9e3]]))
    assert not follower.is_blocked(np.array([1e4, -1e4, 0.0]), grid, 0.2)
