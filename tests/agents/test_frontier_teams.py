"""Allocation of frontiers to robots by each frontier team."""

import numpy as np
import pytest
from twc_env.agents.frontier_teams import WORTH_M, Assignment, CostUtility, Voronoi

from twc_env.config import EnvConfig
from twc_env.planning import Terrain
from twc_env.records.messages import Belief, GridMap

CELL_M = 0.1


def corridor() -> GridMap:
    """A corridor 20 m long and 2 m wide along x, open and unknown at both ends."""
    log_odds = np.zeros((40, 240), np.int16)
    log_odds[10:30, 20:220] = -50
    log_odds[9, 20:220] = log_odds[30, 20:220] = 50
    return GridMap(log_odds, np.zeros(2), CELL_M)


def believed(*x_m: float) -> dict[str, Belief]:
    """Beliefs of robots of one group at positions x [m] along the corridor."""
    poses = [np.array([x, 2.0, 0.0]) for x in x_m]
    grid = corridor()
    return {
        f"robot_{k}": Belief(
            k, 0, pose, grid, teammates={m: p for m, p in enumerate(poses) if m != k}, ranges_m=np.zeros(0)
        )
        for k, pose in enumerate(poses)
    }


def penalties(team, beliefs: dict[str, Belief]) -> dict[str, dict[str, float]]:
    """Per robot, the penalty [m] of the frontiers at the left and the right end."""
    team.reset(0, list(beliefs))
    team.act(beliefs)
    terrain = Terrain(next(iter(beliefs.values())).grid, EnvConfig().dynamics.robot_radius_m)
    left = terrain.label_near(np.array([2.0, 2.0]), 0.5)
    right = terrain.label_near(np.array([22.0, 2.0]), 0.5)
    assert left
    assert right
    found = {agent: team.extra_penalty_m(agent, beliefs, terrain) for agent in beliefs}
    return {agent: {"left": float(p[left]), "right": float(p[right])} for agent, p in found.items()}


@pytest.mark.parametrize("team", [Assignment, Voronoi, CostUtility])
def test_a_single_robot_gets_no_penalties(team):
    assert not any(penalties(team(EnvConfig()), believed(8.0))["robot_0"].values())


def test_an_assignment_sends_two_robots_to_different_ends_even_if_both_are_nearer_to_one():
    found = penalties(Assignment(EnvConfig()), believed(6.0, 4.0))
    assert found["robot_0"]["left"] > 0 == found["robot_0"]["right"]
    assert found["robot_1"]["right"] > 0 == found["robot_1"]["left"]


def test_a_robot_stays_on_its_side_of_the_voronoi_partition():
    found = penalties(Voronoi(EnvConfig()), believed(6.0, 16.0))
    assert found["robot_0"]["right"] > 0 == found["robot_0"]["left"]
    assert found["robot_1"]["left"] > 0 == found["robot_1"]["right"]


def test_the_frontier_goal_of_a_teammate_loses_its_utility():
    found = penalties(CostUtility(EnvConfig()), believed(6.0, 16.0))
    assert found["robot_0"]["right"] == pytest.approx(WORTH_M, rel=0.15)
    assert found["robot_0"]["left"] == 0.0
