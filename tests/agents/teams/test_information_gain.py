"""Information gain: the best view at each moment, and no goal for its own sake."""

import numpy as np
import pytest
from twc_env.agents.teams.information_gain import CHOOSE_S, InformationGain
from twc_env.agents.teams.minpos import MinPos

from tests.planning.test_candidates import belief_of, corridor
from twc_env.config import EnvConfig, override


@pytest.fixture
def team():
    team = InformationGain(override(EnvConfig(), {"robots": 2, "lidar.range_max_m": 3.0}))
    team.reset(0, ("robot_0", "robot_1"))
    return team


def at(step, *poses, mates=False):
    beliefs = {}
    for robot, pose in enumerate(poses):
        others = {1 - robot: np.array(poses[1 - robot])} if mates else {}
        told = {other: step for other in others}
        belief = belief_of(corridor(), pose, robot, others, contact_steps=told)
        beliefs[f"robot_{robot}"] = type(belief)(**{**{k: getattr(belief, k) for k in belief.__slots__}, "step": step})
    return beliefs


def test_a_robot_changes_its_mind_while_it_drives(team):
    team.act(at(0, (1.0, 3.0, 0.0), (1.0, 2.6, 0.0)))
    near = team.robots["robot_0"].goal_m
    assert np.hypot(*(near - (2.0, 4.0))) < 1.5, "the door of the unknown room"
    ticks = round(CHOOSE_S / 0.1)
    team.act(at(ticks, (5.0, 3.0, 0.0), (1.0, 2.6, 0.0)))
    assert team.robots["robot_0"].goal_m[0] > 4.5, "the end of the corridor is nearer now, though the room is unknown"


def test_robots_with_a_common_map_go_to_different_views(team):
    poses = (1.0, 3.0, 0.0), (1.0, 2.6, 0.0)
    for step in (0, round(CHOOSE_S / 0.1)):
        team.act(at(step, *poses, mates=True))
    first, second = (team.robots[agent].goal_m for agent in ("robot_0", "robot_1"))
    assert np.hypot(*(first - second)) > 2.0


def test_robots_that_can_drive_backwards_to_a_view():
    mixed = override(EnvConfig(), {"robots": 2, "robot": ["wheeled", {"lidar.field_of_view_rad": 4.0}]})
    team = InformationGain(mixed)
    team.reset(0, ("robot_0", "robot_1"))
    assert [robot.follower.reverses for robot in team.robots.values()] == [True, False]
    frontiers = MinPos(mixed)
    frontiers.reset(0, ("robot_0", "robot_1"))
    assert not any(robot.follower.reverses for robot in frontiers.robots.values()), "as published"
