"""Allocation of frontiers to robots by each team, in cases that can be solved by hand."""

import numpy as np
from twc_env.agents.teams import assignment, cost_utility
from twc_env.agents.teams.market import auctioned
from twc_env.agents.teams.minpos import MinPos
from twc_env.agents.teams.voronoi import Voronoi

from twc_env.config import EnvConfig
from twc_env.planning import Terrain
from twc_env.planning.segmentation import segmented
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


def ends(team, beliefs: dict[str, Belief]) -> list[str]:
    """To which end of the corridor each robot drives."""
    team.reset(0, list(beliefs))
    team.act(beliefs)
    return ["left" if team.robots[agent].goal_m[0] < 12.0 else "right" for agent in beliefs]


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


def test_a_single_robot_gets_no_penalties():
    assert not any(penalties(Voronoi(EnvConfig()), believed(8.0))["robot_0"].values())


def test_a_robot_stays_on_its_side_of_the_voronoi_partition():
    found = penalties(Voronoi(EnvConfig()), believed(6.0, 16.0))
    assert found["robot_0"]["right"] > 0 == found["robot_0"]["left"]
    assert found["robot_1"]["left"] > 0 == found["robot_1"]["right"]


def test_an_assignment_sends_two_robots_to_different_ends_even_if_both_are_nearer_to_one():
    assert ends(assignment.Assignment(EnvConfig()), believed(6.0, 4.0)) == ["right", "left"]


def test_the_robot_second_in_line_has_its_lowest_rank_at_the_other_end():
    assert ends(MinPos(EnvConfig()), believed(6.0, 4.0)) == ["right", "left"]


def test_an_assignment_is_the_cheapest_of_all():
    random = np.random.default_rng(0)
    for _ in range(20):
        lengths_m = random.uniform(1.0, 20.0, (2, 4))
        pairs = [(i, j) for i in range(4) for j in range(4) if i != j]
        best = min(pairs, key=lambda pair: lengths_m[0, pair[0]] + lengths_m[1, pair[1]])
        assert assignment.assigned(lengths_m) == best[0]


def test_two_robots_share_a_single_frontier_if_there_is_no_other():
    assert assignment.assigned(np.array([[3.0], [4.0]])) == 0


def test_a_frontier_in_sight_of_a_teammates_goal_loses_its_utility():
    lengths_m, sight_m = np.array([[6.0, 9.0], [1.0, 30.0]]), 5.0
    far_apart = np.array([[0.0, 0.0], [20.0, 0.0]])
    assert (
        cost_utility.assigned(lengths_m, far_apart, sight_m) == 1
    )  # the teammate takes the first: it loses all utility
    assert cost_utility.assigned(lengths_m[:1], far_apart, sight_m) == 0


def test_goals_are_sold_to_robots_whose_tours_stay_shortest():
    places_m = np.array([[1.0, 0.0], [2.0, 0.0], [9.0, 0.0], [8.0, 0.0]])
    starts_m = np.array([[0.0, 0.0], [10.0, 0.0]])
    lengths_m = np.hypot(*np.moveaxis(starts_m[:, None] - places_m, -1, 0))
    assert auctioned(lengths_m, places_m) == [[0, 1], [2, 3]]


def test_a_map_is_cut_at_its_door():
    log_odds = np.full((40, 80), -50, np.int16)
    log_odds[[0, -1]] = log_odds[:, [0, -1]] = 50
    log_odds[:, 38:40] = 50
    log_odds[16:25, 38:40] = -50  # a door of 0.9 m
    segments = segmented(Terrain(GridMap(log_odds, np.zeros(2), CELL_M), 0.2))
    left, right = segments[20, 10], segments[20, 70]
    assert left > 0
    assert right > 0
    assert left != right
    sizes_m2 = np.bincount(segments.ravel())[1:] * CELL_M**2
    assert (sizes_m2 > 1.0).sum() == 2


def test_an_open_hall_is_one_segment():
    log_odds = np.full((32, 80), -50, np.int16)
    log_odds[[0, -1]] = log_odds[:, [0, -1]] = 50
    segments = segmented(Terrain(GridMap(log_odds, np.zeros(2), CELL_M), 0.2))
    assert segments[15, 20] == segments[15, 60]
