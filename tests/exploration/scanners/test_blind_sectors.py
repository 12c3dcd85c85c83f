"""Teams with scanners that do not see all around, or whose scans have holes: robots move and map."""

import math

import numpy as np
import pytest
from twc_env.agents.policy import make_policy
from twc_env.agents.shared.openings import is_open_behind

import twc_env
from twc_env.config import DynamicsConfig
from twc_env.exploration.actions import velocity_space
from twc_env.planning import drive_to, room_around_m
from twc_env.records.messages import UNSEEN_M
from twc_env.world.world import World

TEAMS = ("nearest-frontier", "cost-utility", "assignment", "voronoi", "radio-frontier", "random")
STEPS = 250


def seen_beams(degrees, beams, holes=0.0):
    """(beams,) bool: whether each beam is within the field of view and not a hole."""
    bearings = np.abs(np.remainder(np.arange(beams) * 360.0 / beams + 180.0, 360.0) - 180.0)
    return (bearings <= degrees / 2) & (np.random.default_rng(0).random(beams) >= holes)


@pytest.fixture
def blinded(monkeypatch):
    """Call it with degrees and a share of holes: every scan of the world is masked from then on."""

    def mask(degrees, holes=0.0):
        tick = World.tick

        def masked(world, commands):
            frames = tick(world, commands)
            frames.ranges_m = np.where(seen_beams(degrees, frames.ranges_m.shape[1], holes), frames.ranges_m, UNSEEN_M)
            return frames

        monkeypatch.setattr(World, "tick", masked)

    return mask


def moved_and_mapped(env):
    figures = env.result().figures
    return figures["path_length_m"] / env.config.robots, figures["coverage_true"]


def explored(team, steps=STEPS):
    env = twc_env.parallel_env(map="twin-01", robots=2, max_cycles=steps)
    env.reset(seed=3)
    policy = make_policy(team, env.config)
    policy.reset(3, env.agents)
    while env.agents:
        env.step(policy.act({agent: env.belief(agent) for agent in env.agents}))
    return moved_and_mapped(env)


@pytest.mark.parametrize("team", TEAMS)
def test_every_team_explores_with_a_blind_sector_and_holes(blinded, team):
    blinded(270, holes=0.1)
    path_m, coverage = explored(team)
    assert path_m > 4.0
    assert coverage > 0.2


@pytest.mark.parametrize("degrees", [90, 180, 340, 359])
def test_the_default_team_explores_with_every_field_of_view(blinded, degrees):
    blinded(degrees)
    path_m, coverage = explored("nearest-frontier")
    assert path_m > 4.0
    assert coverage > 0.2


def test_a_wall_follower_moves_with_a_blind_sector(blinded):
    blinded(270)
    assert explored("wall-follower")[0] > 4.0


@pytest.mark.parametrize("kind", ["frontier", "waypoint"])
@pytest.mark.parametrize("degrees", [90, 270])
def test_long_actions_are_driven_with_a_blind_sector(blinded, kind, degrees):
    blinded(degrees)
    env = twc_env.parallel_env(map="twin-01", robots=2, max_cycles=STEPS, config={"action.kind": kind})
    observations, _ = env.reset(seed=3)
    ahead, random = np.array([0.8, 0.1], np.float32), np.random.default_rng(0)
    while env.agents:
        chosen = {
            a: ahead if kind == "waypoint" else int(random.choice(np.flatnonzero(o["action_mask"])))
            for a, o in observations.items()
        }
        observations = env.step(chosen)[0]
        assert all(env.observation_space(a).contains(o) for a, o in observations.items())
    assert moved_and_mapped(env)[0] > 2.0


def test_beams_without_information_are_no_obstacle():
    dynamics, ranges = DynamicsConfig(), np.full(180, UNSEEN_M)
    assert drive_to(2.0, 0.0, ranges, dynamics) == drive_to(2.0, 0.0, None, dynamics)
    ranges[3] = -0.5  # free up to there, but no wall
    assert drive_to(2.0, 0.0, ranges, dynamics) == drive_to(2.0, 0.0, None, dynamics)
    ranges[0] = 0.5
    assert drive_to(2.0, 0.0, ranges, dynamics)[0] < drive_to(2.0, 0.0, None, dynamics)[0]


def test_room_is_that_of_the_beams_that_see_something():
    ranges = np.where(seen_beams(180, 180, holes=0.2), 2.0, UNSEEN_M)
    room = room_around_m(ranges)
    assert room[0] == 2.0
    assert room[90] == 0.0
    assert set(room) == {0.0, 2.0}


def test_a_robot_drives_back_only_where_it_sees():
    assert is_open_behind(np.full(180, 2.0), 0.2)
    assert not is_open_behind(np.where(seen_beams(180, 180), 2.0, UNSEEN_M), 0.2)
    assert is_open_behind(np.where(seen_beams(361, 180, holes=0.1), 2.0, UNSEEN_M), 0.2)
    assert not is_open_behind(np.where(np.arange(180) == 90, 0.3, 2.0), 0.2)


def test_the_benchmarks_wanderer_moves_with_a_blind_sector():
    from twc_env.bench.rates import Wanderer

    for degrees in (90, 270):
        action = Wanderer(0).act(np.where(seen_beams(degrees, 180, holes=0.1), 2.0, UNSEEN_M))
        assert velocity_space().contains(action.astype(np.float32))
        assert math.isclose(action[0], 1.0)
