"""Merge hypotheses are tested by whether robots see each other's bodies where and when they should."""

from types import SimpleNamespace

import numpy as np
import pytest

from twc_env import parallel_env
from twc_env.config import EnvConfig, override
from twc_env.geometry import beam_directions, between, compose, inverse
from twc_env.slam.merge_judge import MergeJudge
from twc_env.slam.robot_sightings import CONFIRMATION_MIN, RobotSightings, Sightings

BEAMS, WALL_M, COUNT = 180, 7.5, 20
RADIUS_M = EnvConfig().dynamics.robot_radius_m
START_B = np.array([1.0, 0.5, 0.7])
"""Where the map of robot 1 lies in that of robot 0."""
HERE = np.column_stack([np.full(COUNT, 0.0), 0.3 * np.arange(COUNT), np.linspace(0.0, 2.0, COUNT)])
THERE = np.column_stack([np.full(COUNT, 3.0), 0.3 * np.arange(COUNT), np.linspace(3.0, -1.0, COUNT)])
"""The true paths, side by side."""


def scan(disc_m: np.ndarray | None) -> np.ndarray:
    """(beams,) in an open hall, with a robot at a place (2,) in the scanner's frame marked as such."""
    ranges = np.full(BEAMS, WALL_M)
    if disc_m is not None:
        along = beam_directions(BEAMS) @ disc_m
        across = np.sqrt(np.maximum(disc_m @ disc_m - along**2, 0.0))
        hit = (along > 0) & (across < RADIUS_M)
        ranges[hit] = -(along[hit] - np.sqrt(RADIUS_M**2 - across[hit] ** 2))
    return ranges


def sightings(other_steps=None, have_scans=True, is_seen=True, config=None) -> RobotSightings:
    """Of robots 0 and 1 on their paths, which took their keyframes at steps 10 apart, robot 1 half-way between."""
    steps = [10 * np.arange(COUNT), 10 * np.arange(COUNT) if other_steps is None else other_steps]
    poses = np.concatenate([HERE, between(START_B, THERE)])
    both_ways = [*zip(HERE, THERE, strict=True), *zip(THERE, HERE, strict=True)]
    scans = [scan(between(a, b)[:2] if is_seen else None) for a, b in both_ways]
    graph = SimpleNamespace(
        poses=poses,
        keyframes=[[SimpleNamespace(team_step=step) for step in own] for own in steps],
        path_of=lambda robot: np.arange(COUNT) + COUNT * robot,
        rows_of=lambda nodes: (poses[nodes], np.array([scans[node] for node in nodes]).reshape(-1, BEAMS)),
    )
    maps = SimpleNamespace(have_scans=lambda nodes: np.full(len(nodes), have_scans))
    return RobotSightings(config or EnvConfig(robots=2), graph, maps)


def test_robots_that_see_each_other_confirm_where_they_are():
    counted = sightings().count([0], [1], START_B)
    assert counted == Sightings(2 * COUNT, 0)
    assert counted.confirm and not counted.contradict


@pytest.mark.parametrize("aside_m", [(0.0, -3.0, 0.0), (-1.5, -2.5, 0.0), (0.5, 2.5, 0.3)])
def test_free_space_where_a_robot_should_stand_contradicts(aside_m):
    wrong = compose(np.array(aside_m), START_B)
    counted = sightings().count([0], [1], wrong)
    assert counted.contradict and not counted.confirm
    assert sightings(is_seen=False).count([0], [1], START_B).contradict


def test_a_path_that_has_drifted_is_no_contradiction():
    counted = sightings().count([0], [1], compose(np.array([-1.0, 0.0, 0.0]), START_B))
    assert counted.seen_through == 0


def test_the_other_robot_is_interpolated_between_its_keyframes():
    assert sightings(10 * np.arange(COUNT) + 3).count([0], [1], START_B).confirm


def test_robots_that_were_there_at_other_times_say_nothing():
    later = 10 * np.arange(COUNT) + 10_000
    assert sightings(later).count([0], [1], START_B) == Sightings(0, 0)


@pytest.mark.parametrize("steps", [np.full(COUNT, 10 * COUNT - 10), np.full(COUNT, -1)])
def test_frames_of_one_robot_after_those_of_another_say_nothing(steps):
    """A log given robot by robot: all of the second come in after the last step of the first; or steps are unknown."""
    wrong = compose(np.array([0.0, -3.0, 0.0]), START_B)
    assert sightings(steps).count([0], [1], wrong) == Sightings(0, 0)


def test_only_scans_that_have_come_are_looked_at():
    assert sightings(have_scans=False).count([0], [1], START_B) == Sightings(0, 0)


@pytest.mark.parametrize(
    "setting",
    [{"slam.merging.sightings_check": False}, {"slam.keyframe.mask_mates": False}, {"slam.cues.lidar": False}],
)
def test_it_can_be_switched_off_and_needs_marked_scans(setting):
    off = sightings(config=override(EnvConfig(robots=2), setting))
    assert off.count([0], [1], START_B) == Sightings(0, 0)


def test_one_robot_of_another_team_behind_a_wall_is_not_expected():
    """A wall in between hides it: neither seen nor seen through."""
    hidden = sightings()
    hidden._graph.rows_of = lambda nodes: (hidden._graph.poses[nodes], np.full((len(nodes), BEAMS), 1.0))
    assert hidden.count([0], [1], START_B) == Sightings(0, 0)


def test_counts_decide():
    assert Sightings(CONFIRMATION_MIN, 1).confirm and not Sightings(CONFIRMATION_MIN - 1, 0).confirm
    assert not Sightings(CONFIRMATION_MIN, 2).confirm
    assert Sightings(1, 2).contradict and not Sightings(2, 2).contradict and not Sightings(0, 1).contradict


def test_a_merge_is_refused_and_undone_by_what_robots_did_not_see():
    judge = MergeJudge(EnvConfig().slam.merging, SimpleNamespace(), sightings=sightings())
    assert judge.sightings_contradict([0], [1], compose(np.array([0.0, -3.0, 0.0]), START_B))
    assert not judge.sightings_contradict([0], [1], START_B)
    assert not MergeJudge(EnvConfig().slam.merging, SimpleNamespace()).sightings_contradict([0], [1], START_B)


def test_true_paths_of_an_episode_confirm_and_shifted_ones_do_not():
    """The engine's own keyframes of two robots that meet, put where they truly were and 3 m aside."""
    env = parallel_env(
        map="train/0312", max_cycles=300, config={"action.kind": "frontier", "slam.merging.enabled": False}
    )
    observations, _ = env.reset(seed=312)
    truth = [env.unwrapped.episode.world.poses_home.copy()]
    env.unwrapped.watch(lambda: truth.append(env.unwrapped.episode.world.poses_home.copy()))
    while env.agents:
        actions = {agent: seen["action_mask"].argmax() for agent, seen in observations.items()}
        observations, *_ = env.step(actions)
    team = env.unwrapped.engine.mappers[0]
    frames = [compose(truth[team.keyframe_steps(r)[-1] + 1][r], inverse(team.latest_pose_of(r))) for r in (1, 2)]
    counted = [
        team._judge._sightings.count([1], [2], compose(np.array(by), between(*frames)))
        for by in ((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (0.0, 3.0, 0.0))
    ]
    assert counted[0].confirm and not counted[0].contradict, counted
    assert not any(c.confirm for c in counted[1:]) and any(c.contradict for c in counted[1:]), counted
