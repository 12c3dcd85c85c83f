import math

import numpy as np
import pytest
from twc_env.agents.radio.radio_bound import shortest_known_walk_m
from twc_env.agents.radio.radio_walk import ARRIVAL_M, RadioWalk
from twc_env.agents.radio.ray_gain import RayGain
from twc_env.agents.teams.wall_follower import ESCAPE_S, STANDOFF_M, STUCK_S, WallFollower, nearest_wall

from twc_env.config import EnvConfig
from twc_env.records.messages import Belief, GridMap


def grid(levels):
    return GridMap(levels, np.zeros(2), 0.1)


def room():
    seen = np.full((40, 60), -10, np.int16)
    seen[[0, -1]] = seen[:, [0, -1]] = 10
    return seen


def test_the_wall_to_follow_is_the_nearest_on_the_right_or_ahead():
    ranges = np.full(8, 3.0)
    ranges[2], ranges[6] = 0.3, 0.5  # nearer on the left than on the right
    bearing, distance = nearest_wall(ranges)
    assert bearing == pytest.approx(-math.pi / 2)
    assert distance == 0.5
    assert nearest_wall(None) == (0.0, math.inf)


def test_a_wall_follower_drives_straight_at_its_distance_and_turns_away_when_too_near():
    turns = []
    for distance in (STANDOFF_M, 0.22):
        ranges = np.full(180, 4.0)
        ranges[135] = distance
        agent = WallFollower(EnvConfig())
        agent.reset(0, ["robot_0"])
        belief = Belief(0, 0, np.zeros(3), grid(room()), ranges_m=ranges)
        turns.append(agent.act({"robot_0": belief})["robot_0"][1])
    assert abs(turns[0]) < 0.1 < turns[1]


def test_a_wall_follower_that_is_caught_in_a_pocket_drives_to_open_floor_and_then_follows_walls_again():
    ranges = np.full(180, 0.4)
    ranges[125:145] = 4.0  # the way out is on the right
    ranges[0] = 0.25  # and the wall to follow ahead, with the robot to turn left
    agent = WallFollower(EnvConfig())
    agent.reset(0, ["robot_0"])
    beliefs = [Belief(0, step, np.zeros(3), grid(room()), ranges_m=ranges) for step in range(120)]
    actions = np.array([agent.act({"robot_0": belief})["robot_0"] for belief in beliefs])
    begin = round(STUCK_S / EnvConfig().dynamics.time_step_s)
    end = begin + round(ESCAPE_S / EnvConfig().dynamics.time_step_s)
    assert np.array_equal(actions[:begin], np.tile(actions[0], (begin, 1))), "caught: the same again and again"
    assert actions[0, 1] > 0.5 and (actions[begin:end, 1] < -0.5).all()
    assert np.array_equal(actions[end:], np.tile(actions[0], (120 - end, 1)))


def test_rays_clear_uncertain_floor_once_and_nothing_across_many_walls():
    seen, router = room(), np.array([[0.5, 2.0]])
    radio, nowhere = grid(np.zeros((40, 60), np.int16)), np.zeros((0, 2))
    places = np.array([[1.0, 2.0], [5.0, 2.0]])
    gain = RayGain(radio, grid(seen), router, 0.25)
    near, far = gain.cells_cleared(places, nowhere)
    assert far.sum() > near.sum() > 0
    assert not gain.cells_cleared(places, places[1:])[1].any()
    sure = grid(np.full((40, 60), -30, np.int16))
    assert not RayGain(sure, grid(seen), router, 0.25).cells_cleared(places, nowhere).any()
    walled = seen.copy()
    walled[:, [15, 20, 25, 30]] = 10
    near, far = RayGain(radio, grid(walled), router, 0.25).cells_cleared(places, nowhere)
    assert near.any()
    assert not far.any()


def test_the_agent_continues_while_rays_clear_cells_and_finishes_otherwise():
    agent, seen = RadioWalk(EnvConfig()), room()
    for level, is_done in ((0, False), (-30, True)):
        agent.reset(0, ["robot_0"])
        radio = grid(np.full((40, 60), level, np.int16))
        belief = Belief(
            0, 0, np.array([1.0, 2.0, 0.0]), grid(seen), radio_map=radio, transmitter_m=np.array([[0.5, 2.0]])
        )
        for _ in range(40):
            action = agent.act({"robot_0": belief})["robot_0"]
        assert agent.finished({"robot_0": belief}) == is_done
        assert np.any(action != 0.0)


def test_floor_that_cannot_be_cleared_from_its_goal_is_not_tried_again():
    agent, radio, here = RadioWalk(EnvConfig()), grid(np.zeros((40, 60), np.int16)), np.array([1.0, 2.0])
    agent.reset(0, ["robot_0"])
    for _ in range(60):
        belief = Belief(0, 0, np.append(here, 0.0), grid(room()), radio_map=radio, transmitter_m=np.array([[0.5, 2.0]]))
        agent.act({"robot_0": belief})
        goal = agent._goals_m["robot_0"]
        here = goal + (here - goal) * min(0.9 * ARRIVAL_M / max(math.dist(here, goal), 1e-9), 1.0)
    assert agent.finished({"robot_0": belief})


def test_the_shortest_known_walk_grows_with_the_share_to_clear():
    import twc_env

    plan = twc_env.load_map("sfw-e1")
    lengths = [shortest_known_walk_m(plan, plan.interior_m[0], share) for share in (0.2, 0.6, 1.0)]
    assert 0.0 < lengths[0] < lengths[1] < 20.0
    assert lengths[2] == math.inf
