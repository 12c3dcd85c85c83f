import copy

import numpy as np
import pytest

from twc_env.config import DynamicsConfig
from twc_env.world.building.wall_index import index_walls
from twc_env.world.motion.dynamics import Dynamics

ROOM = np.array([[[0, 0], [6, 0]], [[6, 0], [6, 6]], [[6, 6], [0, 6]], [[0, 6], [0, 0]]], float)


def robots_in(config: DynamicsConfig, walls_m: np.ndarray, starts) -> Dynamics:
    return Dynamics(config, index_walls(walls_m, np.ones(len(walls_m))), np.array(starts, float))


def drive(dynamics, commands, steps: int) -> None:
    for _ in range(steps):
        dynamics.step(np.array(commands, float))


def test_a_robot_drives_straight_at_the_commanded_speed():
    dynamics = robots_in(DynamicsConfig(acceleration_max_m_s2=100.0), ROOM, [[1, 3, 0]])
    drive(dynamics, [[0.5, 0.0]], 40)
    assert dynamics.poses[0] == pytest.approx([3.0, 3.0, 0.0], abs=1e-9)


def test_a_turning_robot_follows_the_arc():
    config = DynamicsConfig(acceleration_max_m_s2=100.0, turn_acceleration_max_rad_s2=1000.0)
    dynamics = robots_in(config, ROOM, [[3, 2, 0]])
    drive(dynamics, [[0.5, 0.5]], 31)
    angle = 0.5 * 3.1
    assert dynamics.poses[0] == pytest.approx([3 + np.sin(angle), 3 - np.cos(angle), angle], abs=0.02)


def test_headings_stay_within_half_a_turn():
    dynamics = robots_in(DynamicsConfig(), ROOM, [[3, 3, 3.0]])
    drive(dynamics, [[0.0, 1.5]], 100)
    assert -np.pi <= dynamics.poses[0, 2] < np.pi


def test_commands_are_clipped_to_the_limits():
    config = DynamicsConfig(speed_max_m_s=0.4, turn_rate_max_rad_s=0.2)
    dynamics = robots_in(config, ROOM, [[1, 3, 0], [3, 5, 0]])
    drive(dynamics, [[99.0, 0.0], [0.0, -99.0]], 50)
    assert 2.8 < dynamics.poses[0, 0] <= 3.0 + 1e-9
    assert -1.0 - 1e-9 <= dynamics.poses[1, 2] < -0.95


def test_speed_grows_no_faster_than_the_acceleration_allows():
    dynamics = robots_in(DynamicsConfig(acceleration_max_m_s2=1.0), ROOM, [[1, 3, 0]])
    positions = []
    for _ in range(20):
        positions.append(dynamics.poses[0, 0])
        drive(dynamics, [[1.0, 0.0]], 1)
    speeds = np.diff(positions) / 0.1
    assert np.diff(speeds).max() <= 0.1 + 1e-9
    assert speeds[-1] == pytest.approx(1.0)


@pytest.mark.parametrize(("speed", "step_s"), [(1.0, 0.1), (5.0, 0.1), (5.0, 1.0)])
def test_robots_cannot_pass_through_walls(speed, step_s):
    random = np.random.default_rng(0)
    config = DynamicsConfig(speed_max_m_s=speed, time_step_s=step_s, acceleration_max_m_s2=100.0)
    inner = np.array([[[3, 0], [3, 6]], [[0, 3], [6, 3]]], float)
    starts = [[1, 1, 0.0], [5, 1, 1.0], [1, 5, 2.0], [5, 5, 3.0]]
    dynamics = robots_in(config, np.concatenate([ROOM, inner]), starts)
    for _ in range(40):
        drive(dynamics, np.column_stack([np.full(4, speed), random.uniform(-1.5, 1.5, 4)]), 5)
        assert ((dynamics.poses[:, :2] > 3) == np.array([[0, 0], [1, 0], [0, 1], [1, 1]])).all()
        assert (dynamics.poses[:, :2] > 0).all()
        assert (dynamics.poses[:, :2] < 6).all()


def test_a_robot_against_a_wall_keeps_its_radius_from_it():
    dynamics = robots_in(DynamicsConfig(), ROOM, [[4, 3, 0]])
    drive(dynamics, [[1.0, 0.0]], 60)
    assert dynamics.poses[0, 0] == pytest.approx(5.8, abs=0.02)
    assert dynamics.poses[0, 1:] == pytest.approx([3.0, 0.0], abs=1e-9)


def test_a_robot_slides_along_a_wall_without_being_turned():
    dynamics = robots_in(DynamicsConfig(), ROOM, [[1, 5.7, 0.5]])
    drive(dynamics, [[1.0, 0.0]], 30)
    assert dynamics.poses[0, 0] > 2.5
    assert dynamics.poses[0, 2] == pytest.approx(0.5)


def test_contact_with_a_wall_is_flagged_and_ends():
    dynamics = robots_in(DynamicsConfig(), ROOM, [[5, 3, 0], [1, 1, 0]])
    assert not dynamics.contacts.any()
    drive(dynamics, [[1.0, 0.0], [0.0, 0.0]], 30)
    assert dynamics.contacts.tolist() == [True, False]
    drive(dynamics, [[-1.0, 0.0], [0.0, 0.0]], 10)
    assert dynamics.contacts.tolist() == [False, False]


def test_robots_in_contact_are_both_flagged_and_do_not_overlap():
    dynamics = robots_in(DynamicsConfig(), ROOM, [[2, 3, 0], [4, 3, np.pi], [1, 1, 0]])
    drive(dynamics, [[1.0, 0.0], [1.0, 0.0], [0.0, 0.0]], 30)
    assert dynamics.contacts.tolist() == [True, True, False]
    assert np.hypot(*(dynamics.poses[0] - dynamics.poses[1])[:2]) >= 0.36


def test_a_blocked_robot_regains_speed_only_by_accelerating():
    config = DynamicsConfig(acceleration_max_m_s2=1.0, turn_rate_max_rad_s=10.0, turn_acceleration_max_rad_s2=1000.0)
    dynamics = robots_in(config, ROOM, [[5, 3, 0]])
    drive(dynamics, [[1.0, 0.0]], 30)
    drive(dynamics, [[0.0, 10.0]], 3)
    before = dynamics.poses[0].copy()
    drive(dynamics, [[1.0, 0.0]], 1)
    assert np.hypot(*(dynamics.poses[0] - before)[:2]) < 0.03


def test_a_copy_continues_identically_though_its_rigid_body_world_was_rebuilt(monkeypatch):
    monkeypatch.setattr("twc_env.world.motion.dynamics._LOG_MAX", 60)
    random = np.random.default_rng(5)
    first = robots_in(DynamicsConfig(), ROOM, [[1, 1, 0.0], [1.6, 1, 1.0], [1, 1.7, 2.0]])
    for step in range(100):
        commands = random.choice([-1.0, 0.5, 1.0], (3, 2))
        if step == 40:
            first.anchor([2])
        other = copy.deepcopy(first)
        drive(other, commands, 3)
        drive(first, commands, 3)
        assert np.array_equal(first.poses, other.poses)
    assert first.contacts.any() and len(first._log) <= 60


def test_steps_without_the_rigid_body_world_equal_those_with_it():
    random = np.random.default_rng(3)
    inner = np.array([[[3, 0], [3, 2.2]], [[0, 3], [2, 3]]], float)
    starts = [[1, 1, 0.0], [5, 1, 1.0], [4, 4.5, 2.0]]
    mixed, asked = (robots_in(DynamicsConfig(), np.concatenate([ROOM, inner]), starts) for _ in range(2))
    calls = []
    collide = mixed.collide
    mixed.collide = lambda: (calls.append(1), collide())
    touched = 0
    for _ in range(60):
        commands = np.column_stack([random.uniform(0, 1, 3), random.uniform(-1.5, 1.5, 3)])
        for _ in range(10):
            mixed.step(commands)
            asked._gaps.fill(0.0)  # as if a wall were always near
            asked.step(commands)
            assert mixed.poses == pytest.approx(asked.poses, abs=1e-9)
            assert mixed.contacts.tolist() == asked.contacts.tolist()
            touched += mixed.contacts.sum()
    assert touched > 20 and 0 < len(calls) < 600


def test_robots_of_a_mixed_team_collide_with_their_own_radius_and_drive_at_their_own_speed():
    kinds = [DynamicsConfig(robot_radius_m=radius, speed_max_m_s=speed) for radius, speed in ((0.1, 0.5), (0.5, 2.0))]
    dynamics = Dynamics(kinds, index_walls(ROOM, np.ones(len(ROOM))), np.array([[3.0, 2.0, 0.0], [3.0, 4.0, 0.0]]))
    drive(dynamics, [[9.0, 0.0], [9.0, 0.0]], 10)
    assert dynamics.poses[:, 0] - 3.0 == pytest.approx([0.5, 1.6], abs=0.05)
    drive(dynamics, [[9.0, 0.0], [9.0, 0.0]], 90)
    assert dynamics.poses[:, 0] == pytest.approx([5.9, 5.5], abs=0.02)
    assert dynamics.contacts.all()
