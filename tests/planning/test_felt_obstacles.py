"""What a robot bumps into without seeing it: remembered where it is, shown in scans, forgotten again."""

import math

import numpy as np
import pytest

from twc_env.config import DynamicsConfig
from twc_env.planning import FeltObstacles, shown
from twc_env.planning.felt_obstacles import MEMORY_S, RETREAT_M_S, RETREAT_S
from twc_env.records.messages import Belief, GridMap

NO_MAP = GridMap(np.zeros((1, 1), np.int16), np.zeros(2), 0.1)
OWN = DynamicsConfig()
RIM_M = OWN.robot_radius_m


def belief_at(pose, step, ranges_m=None) -> Belief:
    return Belief(0, step, np.zeros(3), NO_MAP, ranges_m=ranges_m, pose_odom=np.array(pose, float))


@pytest.fixture
def driven():
    """A robot at the origin that is told speeds [m/s] and stops before something `free_m` ahead of its centre and
    behind it; what it has felt, and the points after the last step."""

    def drive(speeds, free_m: float = 0.5, ranges_m=None, heading: float = 0.0):
        felt, at, speed = FeltObstacles(OWN), 0.0, 0.0
        change = OWN.acceleration_max_m_s2 * OWN.time_step_s
        points = np.zeros((0, 2))
        for step, told in enumerate(speeds):
            points = felt.feel(belief_at((at * math.cos(heading), at * math.sin(heading), heading), step, ranges_m))
            felt.tell(told)
            speed = min(max(told, speed - change), speed + change)
            if abs(at + speed * OWN.time_step_s) < free_m:
                at += speed * OWN.time_step_s
            else:
                speed = 0.0
        return felt, points

    return drive


@pytest.mark.parametrize("forward", [1.0, -1.0])
@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_who_is_stopped_feels_something_at_its_rim(driven, forward, heading):
    _, points = driven([forward * 0.5] * 40, heading=heading)
    assert len(points) >= 1 and np.ptp(points, axis=0).max() < 0.05
    assert points[-1] == pytest.approx([forward * RIM_M, 0.0], abs=0.05)


def test_who_drives_stands_or_changes_its_speed_feels_nothing(driven):
    for speeds in ([1.0] * 40, [0.0] * 40, [0.5] * 15 + [-0.5] * 15 + [0.0, 0.6] * 10, [0.02] * 40):
        assert len(driven(speeds, free_m=1e9)[1]) == 0


def test_what_the_scan_shows_ahead_is_not_felt_too(driven):
    ranges = np.full(90, 3.0)
    ranges[[0, 1, -1]] = RIM_M + 0.05
    assert len(driven([0.5] * 40, ranges_m=ranges)[1]) == 0
    assert len(driven([0.5] * 40, ranges_m=np.roll(ranges, 45))[1]) > 0  # something behind it


def test_a_scan_shows_what_was_felt_unless_something_is_nearer():
    ranges = shown(np.full(90, -2.0), np.array([[0.0, 0.5]]))
    assert (ranges[[21, 22, 23, 24]] == 0.5).all() and (np.delete(ranges, np.arange(20, 26)) == -2.0).all()
    near = np.full(90, 0.3)
    assert np.array_equal(shown(near, np.array([[0.0, 0.5]])), near)
    assert shown(None, np.array([[0.0, 0.5]])) is None and shown(near, np.zeros((0, 2))) is near


def test_it_is_forgotten_after_a_while_or_where_the_robot_itself_stands(driven):
    felt, points = driven([0.5] * 40)
    place = 0.5 + RIM_M
    seen = felt.feel(belief_at((0.0, 0.0, math.pi), 41))
    assert len(seen) == len(points) and seen[0] == pytest.approx([-place, 0.0], abs=0.06)
    assert len(felt.feel(belief_at((place, 0.0, 0.0), 42))) == 0 == len(felt.feel(belief_at((0.0, 0.0, 0.0), 43)))
    felt, _ = driven([0.5] * 40)
    late = round(MEMORY_S / OWN.time_step_s)
    assert len(felt.feel(belief_at((0.0, 0.0, 0.0), late))) > 0
    assert len(felt.feel(belief_at((0.0, 0.0, 0.0), late + 60))) == 0


@pytest.mark.parametrize("forward", [1.0, -1.0])
def test_who_bumped_into_something_drives_back_for_a_while_unless_something_is_there(driven, forward):
    def retreats_m_s(ranges_m=None):
        felt, points = driven([forward * 0.5] * 40)
        at, first = felt._poses[-1], felt._retreat_until - round(RETREAT_S / OWN.time_step_s)
        assert len(points) and felt._retreat_until > 0
        return [felt.retreat_m_s(belief_at(at, first + k, ranges_m)) for k in range(20)]

    steps = round(RETREAT_S / OWN.time_step_s)
    assert retreats_m_s() == [-forward * RETREAT_M_S] * steps + [0.0] * (20 - steps)
    behind = np.full(90, 3.0)
    behind[45 if forward > 0 else 0] = RIM_M + 0.2
    assert retreats_m_s(behind) == [0.0] * 20
    assert any(retreats_m_s(np.roll(behind, 45)))


def test_who_felt_nothing_does_not_drive_back(driven):
    felt, _ = driven([0.5] * 40, free_m=1e9)
    assert felt.retreat_m_s(belief_at((0.0, 0.0, 0.0), 40)) == 0.0


def test_who_is_not_switched_on_yet_feels_nothing(driven):
    """It is told to drive, does not move, and has no scan."""
    felt, points = driven([0.5] * 40, free_m=0.0, ranges_m=np.empty(0))
    assert len(points) == 0 and felt.retreat_m_s(belief_at((0.0, 0.0, 0.0), 39)) == 0.0


def test_a_slow_robot_retreats_no_faster_than_it_can():
    slow = DynamicsConfig(speed_max_m_s=0.15)
    felt, back_m_s = FeltObstacles(slow), []
    for step in range(20):
        belief = belief_at((0.0, 0.0, 0.0), step)
        felt.feel(belief)
        back_m_s.append(felt.retreat_m_s(belief))
        felt.tell(0.15)
    assert min(back_m_s) == -0.15
