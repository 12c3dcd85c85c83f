"""When a robot drives back to where it was, and when it goes on."""

from types import SimpleNamespace

import numpy as np
import pytest
from twc_env.agents.slam_aware.closure_seeker import REST_M, ClosureSeeker
from twc_env.agents.teams.minpos import MinPos

from twc_env.config import EnvConfig
from twc_env.planning import Terrain
from twc_env.records.messages import GridMap


@pytest.fixture
def uncertain(monkeypatch):
    """A closure seeker that has driven from (2, 3) to the far end and back to (6, 3), its terrain and its belief."""
    monkeypatch.setattr(MinPos, "best_plan", lambda *_: (None, "frontier"))
    team = ClosureSeeker(EnvConfig())
    team.reset(0, ["robot_0"])
    robot = team.robots["robot_0"]
    there_m = np.array([[x, 3.0] for x in np.arange(2.0, 19.0, 0.5)])
    robot.track_m = [*there_m, *there_m[:7:-1]]
    robot.pose = np.array([6.0, 3.0, 0.0])
    hall = Terrain(GridMap(np.full((60, 200), -30, np.int8), np.zeros(2), 0.1), 0.2)
    return team, hall, SimpleNamespace(robot=0, pose_std=np.array([0.2, 0.2, 0.1]))


def test_an_uncertain_robot_returns_to_where_it_was_long_ago(uncertain):
    team, terrain, belief = uncertain
    team.robots["robot_0"].pose = np.array([6.0, 1.0, 0.0])
    plan, kind = team.best_plan("robot_0", {"robot_0": belief}, terrain, [])
    assert kind == "place" and 1.0 < plan.length_m < 3.0


def test_a_certain_robot_and_one_that_has_come_back_explore(uncertain):
    team, terrain, belief = uncertain
    assert team.best_plan("robot_0", {"robot_0": belief}, terrain, [])[1] == "frontier"  # it is there
    assert team._may_return_m["robot_0"] == REST_M
    team.robots["robot_0"].pose = np.array([6.0, 1.0, 0.0])
    assert team.best_plan("robot_0", {"robot_0": belief}, terrain, [])[1] == "frontier"  # it rests
    team._may_return_m["robot_0"] = 0.0
    belief.pose_std = np.array([0.01, 0.01, 0.1])
    assert team.best_plan("robot_0", {"robot_0": belief}, terrain, [])[1] == "frontier"


def test_a_place_left_a_short_way_ago_closes_no_loop(uncertain):
    team, terrain, belief = uncertain
    robot = team.robots["robot_0"]
    robot.track_m, robot.pose = robot.track_m[-10:], np.array([6.0, 1.0, 0.0])
    assert team.best_plan("robot_0", {"robot_0": belief}, terrain, [])[1] == "frontier"
