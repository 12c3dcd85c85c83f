"""Where a robot goes that must stay in radio range of the one that it follows."""

from types import SimpleNamespace

import numpy as np
import pytest
from twc_env.agents.slam_aware.relay import GIVE_UP_S, LOST_S, Relay
from twc_env.agents.teams.minpos import MinPos

from twc_env.config import EnvConfig, override
from twc_env.planning import Terrain
from twc_env.records.messages import GridMap

PEER = override(EnvConfig(), {"link.topology": "peer", "link.range_max_m": 10.0, "link.wall_range_m": 5.0})
TICK_S = PEER.dynamics.time_step_s
BESIDE_M, NEAR_M, FAR_M = [1.0, 3.0], [7.0, 5.0], [19.0, 5.0]
"""Frontiers in a hall of 20 m by 6 m: two on the side of the leader, who stands at (2, 5), and one out of its range."""


def hall(wall_at_m: float | None = None) -> Terrain:
    """Floor from (0, 0) to (20, 6), perhaps with a wall across it but for a gap of 1.5 m."""
    log_odds = np.full((60, 200), -30, np.int8)
    if wall_at_m is not None:
        log_odds[15:, int(wall_at_m / 0.1)] = 60
    return Terrain(GridMap(log_odds, np.zeros(2), 0.1), 0.2)


def chosen(team, terrain, silent_s=0.0, lengths_m=(9.0, 5.0, 1.0)):
    """The number of the frontier that robot 1 takes, which has heard robot 0 so long ago."""
    step = 1000
    belief = SimpleNamespace(
        robot=1, step=step, teammates={0: np.array([2.0, 5.0, 0.0])}, contact_steps={0: step - round(silent_s / TICK_S)}
    )
    team.reset(0, ["robot_0", "robot_1"])
    team.teammates_in_contact = lambda *_: []
    frontiers = SimpleNamespace(
        terrain=terrain,
        places_m=np.array([BESIDE_M, NEAR_M, FAR_M]),
        lengths_m=np.array(lengths_m),
        teammate_lengths_m=np.zeros((0, 3)),
    )
    return team.choose("robot_1", {"robot_1": belief}, frontiers)


def test_a_robot_takes_the_nearest_frontier_from_which_it_reaches_its_leader():
    assert chosen(MinPos(PEER), hall()) == 2
    assert chosen(Relay(PEER), hall()) == 1


def test_walls_on_its_map_shorten_the_range():
    assert chosen(Relay(PEER), hall(wall_at_m=4.5)) == 0


def test_a_robot_without_a_frontier_in_range_goes_where_its_leader_is():
    short = override(PEER, {"link.range_max_m": 2.0})
    assert chosen(Relay(short), hall(), lengths_m=(9.0, 8.0, 1.0)) == 0


@pytest.mark.parametrize("team", [Relay(PEER), Relay(override(PEER, {"link.topology": "central"}))])
def test_with_a_central_mapper_or_a_leader_that_was_not_heard_for_long_it_is_its_blind_twin(team):
    silent_s = GIVE_UP_S + 1.0 if team._is_peer else 0.0
    assert chosen(team, hall(), silent_s) == chosen(MinPos(PEER), hall()) == 2


@pytest.mark.parametrize(("silent_s", "goal"), [(LOST_S + 1.0, "place"), (0.0, "frontier")])
def test_a_robot_that_hears_its_leader_no_more_drives_back_to_it(silent_s, goal, monkeypatch):
    monkeypatch.setattr(MinPos, "best_plan", lambda *_: (None, "frontier"))
    team, terrain, step = Relay(PEER), hall(), 1000
    team.reset(0, ["robot_0", "robot_1"])
    team.robots["robot_1"].pose = np.array([12.0, 3.0, 0.0])
    belief = SimpleNamespace(
        robot=1, step=step, teammates={0: np.array([2.0, 5.0, 0.0])}, contact_steps={0: step - round(silent_s / TICK_S)}
    )
    plan, kind = team.best_plan("robot_1", {"robot_1": belief}, terrain, [])
    assert kind == goal
    assert plan is None or 8.0 < plan.length_m < 12.0
