"""Test of merge hypotheses: robots must see each other where and when the merge predicts it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from twc_env import parallel_env
from twc_env.config import EnvConfig, override
from twc_env.records.geometry import beam_directions, between, compose, inverse
from twc_env.records.messages import LoopCandidate, LoopClosure
from twc_env.slam.engine import CooperativeSlam
from twc_env.slam.mapping.segments import NO_ROBOT, Segments
from twc_env.slam.merging.merge_tests import HYPOTHESES_MAX, MergeTests
from twc_env.slam.merging.mutual_observations import (
    CONFIRMATION_MIN,
    GAP_MAX_M,
    PLACES_MIN,
    MutualObservations,
    ObservationCounts,
    _count,
    _places_at,
)

BEAMS, WALL_M, COUNT = 180, 7.5, 20
RADIUS_M = EnvConfig().dynamics.robot_radius_m
START_B = np.array([1.0, 0.5, 0.7])
"""Pose of the map frame of robot 1 in that of robot 0."""
HERE = np.column_stack([np.full(COUNT, 0.0), 0.3 * np.arange(COUNT), np.linspace(0.0, 2.0, COUNT)])
THERE = np.column_stack([np.full(COUNT, 3.0), 0.3 * np.arange(COUNT), np.linspace(3.0, -1.0, COUNT)])
"""True poses of robots 0 and 1 on parallel paths, in the map frame of robot 0."""


def scan(disc_m: np.ndarray | None) -> np.ndarray:
    """(beams,) scan in an open hall, with marked returns of a robot at `disc_m` (2,) in the scanner's frame."""
    ranges = np.full(BEAMS, WALL_M)
    if disc_m is not None:
        along = beam_directions(BEAMS) @ disc_m
        across = np.sqrt(np.maximum(disc_m @ disc_m - along**2, 0.0))
        hit = (along > 0) & (across < RADIUS_M)
        ranges[hit] = -(along[hit] - np.sqrt(RADIUS_M**2 - across[hit] ** 2))
    return ranges


def observations_of(
    other_steps=None, have_scans=True, is_seen=True, config=None, paths=(HERE, THERE), segments=None
) -> MutualObservations:
    """Mutual observations of robots 0 and 1, with a keyframe every 10 steps; other_steps: those of robot 1's
    keyframes."""
    steps = [10 * np.arange(COUNT), 10 * np.arange(COUNT) if other_steps is None else other_steps]
    here, there = paths
    poses = np.concatenate([here, between(START_B, there)])
    both_ways = [*zip(here, there, strict=True), *zip(there, here, strict=True)]
    scans = [scan(between(a, b)[:2] if is_seen else None) for a, b in both_ways]
    graph = SimpleNamespace(
        poses=poses,
        keyframes=[[SimpleNamespace(team_step=step) for step in own] for own in steps],
        path_of=lambda robot: np.arange(COUNT) + COUNT * robot,
        rows_of=lambda nodes: (poses[nodes], np.array([scans[node] for node in nodes]).reshape(-1, BEAMS)),
    )
    maps = SimpleNamespace(have_scans=lambda nodes: np.full(len(nodes), have_scans))
    return MutualObservations(config or EnvConfig(robots=2), graph, maps, segments or Segments(2))


def test_robots_that_see_each_other_confirm_a_merge():
    counted = observations_of().count([0], [1], START_B)
    assert counted == ObservationCounts(2 * COUNT, 0, COUNT), (
        "every second keyframe is 0.5 m or more from the last place"
    )
    assert counted.confirm and counted.prove and not counted.contradict


def test_a_robot_that_stands_still_proves_nothing():
    """It may be a pillar as wide as a robot, whichever room the hypothesis puts it in."""
    still = observations_of(paths=(HERE, np.tile(THERE[COUNT // 2], (COUNT, 1))))
    counted = still._between(0, 1, (0,), START_B, False)
    assert counted[0] == COUNT and counted[2] == 1
    assert not ObservationCounts(*counted).prove and ObservationCounts(*counted).confirm


@pytest.mark.parametrize("aside_m", [(0.0, -3.0, 0.0), (-1.5, -2.5, 0.0), (0.5, 2.5, 0.3)])
def test_free_space_at_a_predicted_robot_contradicts_a_merge(aside_m):
    wrong = compose(np.array(aside_m), START_B)
    counted = observations_of().count([0], [1], wrong)
    assert counted.contradict and not counted.confirm
    assert observations_of(is_seen=False).count([0], [1], START_B).contradict


def test_an_error_along_the_path_is_no_contradiction():
    counted = observations_of().count([0], [1], compose(np.array([-1.0, 0.0, 0.0]), START_B))
    assert counted.seen_through == 0


def test_the_other_robot_is_interpolated_between_its_keyframes():
    assert observations_of(10 * np.arange(COUNT) + 3).count([0], [1], START_B).confirm


def test_robots_at_other_times_give_no_evidence():
    later = 10 * np.arange(COUNT) + 10_000
    assert observations_of(later).count([0], [1], START_B) == ObservationCounts(0, 0)


@pytest.mark.parametrize("step", [10 * COUNT - 10, 0, -1])
def test_frames_that_all_arrived_in_one_step_give_no_evidence(step):
    """As in a log that is replayed robot by robot; -1: unknown step."""
    steps = np.full(COUNT, step)
    wrong = compose(np.array([0.0, -3.0, 0.0]), START_B)
    assert observations_of(steps).count([0], [1], wrong) == ObservationCounts(0, 0)


def test_only_scans_that_have_arrived_are_used():
    assert observations_of(have_scans=False).count([0], [1], START_B) == ObservationCounts(0, 0)


@pytest.mark.parametrize(
    "setting",
    [
        {"slam.merging.mutual_observations_check": False},
        {"slam.keyframe.mask_teammates": False},
        {"slam.cues.lidar": False},
    ],
)
def test_the_check_can_be_disabled_and_needs_marked_scans(setting):
    off = observations_of(config=override(EnvConfig(robots=2), setting))
    assert off.count([0], [1], START_B) == ObservationCounts(0, 0)


@pytest.mark.parametrize("owner", [0, NO_ROBOT])
def test_in_a_mixed_team_a_carried_robot_keeps_its_size_and_a_prior_map_has_none(owner):
    """Segments are more than robots."""
    segments = Segments(1)
    segments.owners.append(owner)
    config = override(EnvConfig(robots=1), {"robot": [{"dynamics.robot_radius_m": RADIUS_M}]})
    assert observations_of(config=config, segments=segments).count([0], [1], START_B).confirm


def test_a_robot_is_not_interpolated_over_a_gap():
    steps, other_steps = np.array([5]), np.array([0, 10])
    for gap_m, expected in ((GAP_MAX_M - 0.1, (2.0, (GAP_MAX_M - 0.1) / 2)), (GAP_MAX_M + 0.1, (np.nan, np.nan))):
        others = np.array([[2.0, 0.0, 0.0], [2.0, gap_m, 0.0]])
        assert tuple(_places_at(steps, others, other_steps)[0]) == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize(("aside_m", "is_told"), [(1.4, False), (1.6, True)])
def test_a_robot_of_the_own_group_that_stood_there_may_be_the_one_that_was_seen(aside_m, is_told):
    """Robots that drive one wing behind each other were seen where robots of the other group should have been."""
    watched = observations_of()
    graph = watched._graph
    fellow = THERE + np.array([aside_m, 0.0, 0.0])
    graph.poses, graph.keyframes = np.concatenate([graph.poses, fellow]), [*graph.keyframes, graph.keyframes[0]]
    counted = watched._between(0, 1, (0, 2), START_B, False)
    assert counted[:2] == ((COUNT, 0) if is_told else (0, 0))
    other_way = watched._between(1, 0, (1, 2), START_B, True)
    assert other_way[0] == COUNT, "the fellow is not beside robot 0"


def test_robots_are_together_that_explore_at_the_same_time():
    assert observations_of().are_together([0], [1])
    assert not observations_of(10 * np.arange(COUNT) + 10_000).are_together([0], [1])
    assert not observations_of(np.full(COUNT, -1)).are_together([0], [1])
    off = observations_of(config=override(EnvConfig(robots=2), {"slam.cues.lidar": False}))
    assert not off.are_together([0], [1])


@pytest.mark.parametrize(("distance_m", "seen_through"), [(1.0, 1), (3.0, 0)])
def test_few_beams_may_miss_a_robot_far_away(distance_m, seen_through):
    """36 beams may all miss a robot 3 m away, so that gives no evidence."""
    place = np.array([[distance_m, 0.0]])
    assert _count(np.full((1, 36), WALL_M), place, place, RADIUS_M) == (0, seen_through, 0)


@pytest.mark.parametrize(("seen", "is_confirmed"), [(CONFIRMATION_MIN, True), (CONFIRMATION_MIN - 1, False)])
def test_mutual_observations_confirm_a_merge_by_few_scans(seen, is_confirmed):
    rule = override(EnvConfig(), {"slam.merging.wifi_check": False}).slam.merging
    told = SimpleNamespace(are_known=True, count=lambda *_: ObservationCounts(seen, 0))
    compared = SimpleNamespace(sign_m=None, text_similarity=np.nan)
    proposal = SimpleNamespace(pose_a_b=START_B, agreeing=[SimpleNamespace(candidate=compared)] * 3, weight=(3, 3, 3))
    assert (
        MergeTests(rule, SimpleNamespace(), mutual_observations=told).cues_confirm((0,), (1,), proposal) is is_confirmed
    )


SEEN = ObservationCounts(CONFIRMATION_MIN, 0, PLACES_MIN)


def merge_tests_of(told) -> MergeTests:
    """Of robots 0 and 1, with one keyframe each; `told`: the mutual observations by the pose of robot 1's map in that
    of robot 0."""
    graph = SimpleNamespace(poses=np.zeros((2, 3)), node=lambda key: key[0])
    counted = SimpleNamespace(are_known=True, count=lambda _a, _b, pose: told(pose))
    return MergeTests(EnvConfig().slam.merging, graph, mutual_observations=counted)


def closure(x_m: float, is_loose=False, sign_m=(1.0, 0.0)):
    """Robot 1 stands `x_m` ahead of robot 0, by the same sign."""
    sign = None if sign_m is None else np.array(sign_m)
    candidate = LoopCandidate((0, 0), (1, 0), np.array([x_m, 0.0, 0.0]), "twc", sign)
    covariance = np.diag([4.0, 0.01, 0.01]) if is_loose else np.diag([0.01, 0.01, 0.002])
    return LoopClosure(candidate, candidate.guess, covariance, 0.9, "pending")


def test_of_single_closures_the_one_by_which_robots_saw_each_other_is_proposed():
    made = [closure(x_m) for x_m in (2.0, 5.0, 5.1, 9.0)]
    tests = merge_tests_of(lambda pose: SEEN if abs(pose[0] - 5.0) < 0.5 else ObservationCounts(3, 0, 3))
    found = tests.observed_proposal(made, (0,), (1,))
    assert found.pose_a_b == pytest.approx((5.1, 0.0, 0.0)) and found.is_proven
    assert found.support.tolist() == [False, True, True, False] and found.agreeing == (made[1], made[2])
    assert (
        merge_tests_of(lambda _: ObservationCounts(CONFIRMATION_MIN, 0, 1)).observed_proposal(made, (0,), (1,)) is None
    )


def test_the_most_mutual_observations_decide_between_proven_hypotheses():
    tests = merge_tests_of(lambda pose: SEEN._replace(seen=30) if pose[0] == 2.0 else SEEN)
    found = tests.observed_proposal([closure(2.0), closure(9.0)], (0,), (1,))
    assert found.pose_a_b[0] == 2.0


@pytest.mark.parametrize("setting", [{"is_loose": True}, {"sign_m": None}])
def test_loose_closures_and_those_without_a_sign_are_not_proven_by_mutual_observations(setting):
    assert merge_tests_of(lambda _: SEEN).observed_proposal([closure(2.0, **setting)], (0,), (1,)) is None


def test_only_the_latest_hypotheses_are_tested():
    tested = []
    tests = merge_tests_of(lambda pose: tested.append(pose[0]) or ObservationCounts(0, 0))
    tests.observed_proposal([closure(2.0 * k) for k in range(2 * HYPOTHESES_MAX)], (0,), (1,))
    assert tested == [2.0 * k for k in reversed(range(HYPOTHESES_MAX, 2 * HYPOTHESES_MAX))]


def test_keyframes_carry_the_step_of_the_engine_whatever_the_frame_numbers():
    env = parallel_env(map="twin-02", robots=2, max_cycles=60)
    env.reset(seed=0)
    engine = CooperativeSlam(env.unwrapped.config, 2)
    steps = set()
    for step in range(60):
        frames = [replace(frame, step=frame.step + 1000 * frame.robot) for frame in env.unwrapped.frames]
        taken = engine.track(frames)
        engine.absorb(step)
        steps |= {(k.robot, k.step - k.team_step) for k in taken}
        env.step(dict.fromkeys(env.agents, np.array([1.0, 0.2])))
    assert {robot for robot, _ in steps} == {0, 1}
    assert all(abs(own - 1000 * robot) <= 1 for robot, own in steps), "the first frame may count as the second"


def test_a_robot_hidden_by_a_wall_gives_no_evidence():
    """A wall in between hides the robot: neither seen nor seen through."""
    hidden = observations_of()
    hidden._graph.rows_of = lambda nodes: (hidden._graph.poses[nodes], np.full((len(nodes), BEAMS), 1.0))
    assert hidden.count([0], [1], START_B) == ObservationCounts(0, 0)


def test_the_decision_follows_from_the_counts():
    assert ObservationCounts(CONFIRMATION_MIN, 1).confirm and not ObservationCounts(CONFIRMATION_MIN - 1, 0).confirm
    assert not ObservationCounts(CONFIRMATION_MIN, 2).confirm
    assert (
        ObservationCounts(CONFIRMATION_MIN, 1, PLACES_MIN).prove
        and not ObservationCounts(CONFIRMATION_MIN, 1, PLACES_MIN - 1).prove
    )
    assert not ObservationCounts(CONFIRMATION_MIN - 1, 0, PLACES_MIN).prove
    assert (
        ObservationCounts(1, 2).contradict
        and not ObservationCounts(2, 2).contradict
        and not ObservationCounts(0, 1).contradict
    )


def test_missing_mutual_observations_contradict_a_merge():
    tests = MergeTests(EnvConfig().slam.merging, SimpleNamespace(), mutual_observations=observations_of())
    assert tests.mutual_observations_contradict([0], [1], compose(np.array([0.0, -3.0, 0.0]), START_B))
    assert not tests.mutual_observations_contradict([0], [1], START_B)
    assert not MergeTests(EnvConfig().slam.merging, SimpleNamespace()).mutual_observations_contradict([0], [1], START_B)


def test_true_relative_poses_are_confirmed_and_shifted_ones_are_not():
    """The engine's keyframes of two robots that meet, with the true relative pose and with ones wrong by 3 m."""
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
        team._tests._mutual_observations.count([1], [2], compose(np.array(by), between(*frames)))
        for by in ((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (0.0, 3.0, 0.0))
    ]
    assert counted[0].confirm and not counted[0].contradict, counted
    assert not any(c.confirm for c in counted[1:]) and any(c.contradict for c in counted[1:]), counted
