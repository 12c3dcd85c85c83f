"""Who goes to which frontier, by each way of sharing out the work."""

import numpy as np
import pytest

from agents.frontier_teams import WORTH_M, Assignment, CostUtility, Voronoi
from twc_env.config import EnvConfig
from twc_env.messages import Belief, GridMap
from twc_env.planning import Terrain

CELL_M = 0.1


def corridor() -> GridMap:
    """A corridor 20 m long and 2 m wide along x, open and unknown at both ends."""
    log_odds = np.zeros((40, 240), np.int16)
    log_odds[10:30, 20:220] = -50
    log_odds[9, 20:220] = log_odds[30, 20:220] = 50
    return GridMap(log_odds, np.zeros(2), CELL_M)


def believed(*x_m: float) -> dict[str, Belief]:
    """Robots of one group at places along the corridor."""
    poses = [np.array([x, 2.0, 0.0]) for x in x_m]
    grid = corridor()
    return {
        f"robot_{k}": Belief(
            k, 0, pose, grid, mates={m: p for m, p in enumerate(poses) if m != k}, ranges_m=np.zeros(0)
        )
        for k, pose in enumerate(poses)
    }


def penalties(team, beliefs: dict[str, Belief]) -> dict[str, dict[str, float]]:
    """By robot: metres added to the left and the right end."""
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
def test_a_robot_alone_wants_what_is_near(team):
    assert not any(penalties(team(EnvConfig()), believed(8.0))["robot_0"].values())


def test_an_assignment_sends_two_robots_to_two_ends_though_both_are_nearer_to_one():
    found = penalties(Assignment(EnvConfig()), believed(6.0, 4.0))
    assert found["robot_0"]["left"] > 0 == found["robot_0"]["right"]
    assert found["robot_1"]["right"] > 0 == found["robot_1"]["left"]


def test_a_robot_keeps_to_its_own_side_of_the_voronoi_partition():
    found = penalties(Voronoi(EnvConfig()), believed(6.0, 16.0))
    assert found["robot_0"]["right"] > 0 == found["robot_0"]["left"]
    assert found["robot_1"]["left"] > 0 == found["robot_1"]["right"]


def test_a_frontier_that_a_mate_is_bound_for_has_lost_its_worth():
    found = penalties(CostUtility(EnvConfig()), believed(6.0, 16.0))
    assert found["robot_0"]["right"] == pytest.approx(WORTH_M, rel=0.15)
    assert found["robot_0"]["left"] == 0.0
