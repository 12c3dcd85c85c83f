"""Relative pose of two groups from closures of which some are false."""

from types import SimpleNamespace

import numpy as np
import pytest

from twc_env.config import MergingConfig
from twc_env.records.geometry import between, compose
from twc_env.records.messages import LoopCandidate, LoopClosure, SignObservation
from twc_env.slam.merging.merge_tests import MergeTests
from twc_env.slam.merging.mutual_observations import ObservationCounts

PLACES = 12
PATH = np.stack([2.0 * np.arange(PLACES), np.zeros(PLACES), np.zeros(PLACES)], axis=1)
"""Path of both robots, each in its own map: a keyframe every 2 m."""
TRUE, A_SHELF_ASIDE, ELSEWHERE = (5.0, 1.0, 0.0), (5.0, 3.2, 0.0), (9.0, -4.0, 0.0)
GRAPH = SimpleNamespace(poses=np.concatenate([PATH, PATH]), node=lambda key: PLACES * key[0] + key[1])


def say(count: int, pose_a_b: tuple, recogniser: str) -> list[LoopClosure]:
    """Closures that put robot 1 at a pose in the map of robot 0."""
    made = []
    for k in range(count):
        pose = between(PATH[k], compose(np.array(pose_a_b), PATH[k]))
        sign = {"sign_m": np.zeros(2), "text_similarity": 1.0} if recogniser == "twc" else {}
        candidate = LoopCandidate((0, k), (1, k), pose, recogniser, **sign)
        made.append(LoopClosure(candidate, pose, np.diag([0.01, 0.01, 0.002]), 0.9, "pending"))
    return made


def merge_tests() -> MergeTests:
    return MergeTests(MergingConfig(), GRAPH)


def place_said(closures: list[LoopClosure]):
    found = merge_tests().proposal(closures, (0,))
    return None if found is None else pytest.approx(tuple(found.pose_a_b), abs=1e-6)


def test_sign_closures_may_be_inconsistent():
    assert place_said(say(4, TRUE, "twc") + say(3, ELSEWHERE, "twc")) == TRUE


@pytest.mark.parametrize("axis", [0, 1])
def test_loose_closures_have_no_weight(axis):
    loose = say(8, TRUE, "wifi")
    for closure in loose:
        closure.covariance[axis, axis] = 4.0
    assert all(closure.is_loose for closure in loose)
    assert place_said(loose) is None
    assert place_said(say(3, ELSEWHERE, "twc") + loose) == ELSEWHERE
    assert merge_tests().weight(loose, (0,)) == (0, 0, 0)


@pytest.mark.parametrize(("before_m", "after_m", "may"), [(0.0, 2.0, False), (2.0, 0.0, True), (2.0, 4.0, True)])
def test_a_solution_that_overlays_paths_with_different_signs_is_rejected(before_m, after_m, may):
    doors = [[SignObservation(f"A10{k}", np.array([0.0, 1.0]), np.pi / 2)] * 2 for k in range(PLACES)]
    ways = [[SimpleNamespace(signs=signs) for signs in doors]] * 2
    nodes = np.arange(2 * PLACES)
    graph = SimpleNamespace(**vars(GRAPH), keyframes=ways, path_of=lambda robot: PLACES * robot + np.arange(PLACES))
    few, more = say(3, TRUE, "twc"), say(6, ELSEWHERE, "twc")
    for number, closure in enumerate(few + more):
        closure.number = number

    def answer(believed, ahead_m):
        return believed, np.concatenate([PATH, PATH + (ahead_m, 0.0, 0.0)])

    asked = MergeTests(MergingConfig(), graph)
    assert asked.may_replace((0, 1), nodes, answer(few, before_m), answer(more, after_m)) is may
    assert not asked.may_replace((0, 1), nodes, answer(more, before_m), answer(few, after_m)), "fewer signs"


def test_closures_by_lidar_alone_must_agree_at_many_places():
    deaf = MergeTests(MergingConfig(wifi_check=False), GRAPH)
    few, enough = (deaf.proposal(say(count, TRUE, "lidar"), (0,)) for count in (7, 8))
    assert not deaf.cues_confirm((0,), (1,), few) and deaf.cues_confirm((0,), (1,), enough)
    one_will_do = MergeTests(MergingConfig(wifi_check=False, spread_min_m=0.0), GRAPH)
    assert one_will_do.cues_confirm((0,), (1,), few)


def seen(seen_count: int, through: int = 0) -> SimpleNamespace:
    """Mutual observations that count the same for every hypothesis."""
    return SimpleNamespace(are_known=True, count=lambda *_: ObservationCounts(seen_count, through, 5))


def test_scans_alone_merge_nothing_where_robots_look_for_each_other():
    proposal = MergeTests(MergingConfig(wifi_check=False), GRAPH).proposal(say(PLACES, TRUE, "lidar"), (0,))
    for watched, may in ((seen(0), False), (seen(9), False), (seen(10), True)):
        asked = MergeTests(MergingConfig(wifi_check=False), GRAPH, mutual_observations=watched)
        assert asked.cues_confirm((0,), (1,), proposal) is may


def test_names_alone_merge_nothing_where_robots_were_seen_through():
    proposal = merge_tests().proposal(say(4, TRUE, "twc"), (0,))
    for through, may in ((0, True), (1, True), (2, False)):
        asked = MergeTests(MergingConfig(wifi_check=False), GRAPH, mutual_observations=seen(2, through))
        asked.names_agree = lambda *_: True
        assert asked.cues_confirm((0,), (1,), proposal) is may


@pytest.mark.parametrize(
    ("names", "repeated", "may"), [(1, 0, False), (2, 0, True), (6, 1, False), (7, 1, True), (11, 2, False)]
)
def test_names_alone_merge_only_where_names_seldom_repeat(names, repeated, may):
    spots = [SignObservation(f"A{k}", np.array([0.0, 1.0]), np.pi / 2) for k in range(names)]
    ways = [[SimpleNamespace(signs=[spot] * 2) for spot in [*spots, *spots[:repeated]]]] * 2
    path = np.stack([2.0 * np.arange(names + repeated), *np.zeros((2, names + repeated))], axis=1)
    count = len(path)
    graph = SimpleNamespace(
        poses=np.concatenate([path, path]), keyframes=ways, path_of=lambda robot: count * robot + np.arange(count),
        nodes_of=lambda robots: np.concatenate([count * robot + np.arange(count) for robot in robots]),
    )  # fmt: skip
    assert MergeTests(MergingConfig(), graph).names_agree((0,), (1,), np.zeros(3)) is may
    assert MergeTests(MergingConfig(signs_read_alike_min=0), graph).names_agree((0,), (1,), np.zeros(3))


def between_two_poses(support: int, rival: int, differences: dict | None = None, watched=None) -> bool:
    """Whether a hypothesis with this support is ambiguous, given this many closures for another; `differences`: of the
    fingerprints at both."""
    supporting, others = say(support, TRUE, "wifi"), say(rival, A_SHELF_ASIDE, "wifi")
    for number, closure in enumerate(supporting + others):
        closure.number = number
    waiting = SimpleNamespace(between=lambda a, b: supporting + others[: rival // 2])
    graph = SimpleNamespace(**vars(GRAPH), waiting=waiting, closures_between=lambda a, b, status: others[rival // 2 :])
    asked = MergeTests(MergingConfig(), graph, mutual_observations=watched)
    asked.radio_difference = lambda a, b, pose: (differences or {}).get(round(float(pose[1]), 1))
    return asked.is_ambiguous((0,), (1,), asked.proposal(supporting, (0,)))


@pytest.mark.parametrize(("support", "rival", "ambiguous"), [(4, 1, False), (4, 2, True), (9, 4, False), (9, 5, True)])
def test_a_merge_is_ambiguous_if_half_as_many_closures_agree_on_another_pose(support, rival, ambiguous):
    alike = {TRUE[1]: 1.0, A_SHELF_ASIDE[1]: 1.0}
    assert between_two_poses(support, rival, alike) is ambiguous


@pytest.mark.parametrize(("support", "rival", "ambiguous"), [(4, 3, False), (4, 4, True), (9, 8, False), (9, 9, True)])
def test_where_radio_compares_nothing_as_many_closures_must_agree_on_another_pose(support, rival, ambiguous):
    assert between_two_poses(support, rival) is ambiguous


@pytest.mark.parametrize(("here", "there", "ambiguous"), [(0.7, 1.0, False), (0.95, 1.0, True), (1.0, 0.7, True)])
def test_radio_resolves_an_ambiguous_merge_if_it_prefers_the_proposal(here, there, ambiguous):
    assert between_two_poses(4, 4, {TRUE[1]: here, A_SHELF_ASIDE[1]: there}) is ambiguous


def test_robots_that_saw_each_other_resolve_an_ambiguous_merge():
    assert between_two_poses(4, 4, watched=seen(9)) and not between_two_poses(4, 4, watched=seen(10))


def test_a_closure_is_confirmed_by_another_from_elsewhere_that_moves_the_robots_alike():
    first, beside, *further = say(4, TRUE, "wifi")
    beside.pose_target_source = first.pose_target_source.copy()
    beside.candidate = first.candidate
    false = say(4, A_SHELF_ASIDE, "wifi")
    assert merge_tests().agreeing_with(first, [beside, *further, *false]) == further
    assert merge_tests().agreeing_with(first, []) == []


@pytest.mark.parametrize(("count", "away_m", "may"), [(1, 0.4, True), (1, 0.6, False), (2, 0.6, True)])
def test_a_solution_in_which_a_single_closure_moves_the_map_is_rejected(count, away_m, may):
    nodes, new = np.arange(2 * PLACES), say(count, TRUE, "twc")
    ways = [[SimpleNamespace(signs=[])] * PLACES] * 2
    graph = SimpleNamespace(
        **vars(GRAPH), keyframes=ways, path_of=lambda robot: PLACES * robot + np.arange(PLACES),
        disagreement=lambda closure: (away_m, 0.0, 0.0),
    )  # fmt: skip
    for number, closure in enumerate(new):
        closure.number = number
    asked = MergeTests(MergingConfig(), graph)
    assert asked.may_replace((0, 1), nodes, ([], GRAPH.poses), (new, GRAPH.poses)) is may


@pytest.mark.parametrize(("kept", "may"), [(2, False), (3, True)])
def test_a_solution_that_moves_robots_against_most_closures_between_them_is_rejected(kept, may):
    nodes = np.arange(2 * PLACES)
    ways = [[SimpleNamespace(signs=[])] * PLACES] * 2
    graph = SimpleNamespace(**vars(GRAPH), keyframes=ways, path_of=lambda robot: PLACES * robot + np.arange(PLACES))
    held, new = say(6, TRUE, "twc"), say(PLACES, ELSEWHERE, "twc")[6:]
    for number, closure in enumerate(held + new):
        closure.number = number
    before, after = (np.concatenate([PATH, compose(np.array(pose), PATH)]) for pose in (TRUE, ELSEWHERE))
    after[PLACES : PLACES + kept] = before[PLACES : PLACES + kept]
    accepted = [*held[:kept], *new, *say(3, ELSEWHERE, "twc")]
    for number, closure in enumerate(accepted[kept + len(new) :], 100):
        closure.number = number
    asked = MergeTests(MergingConfig(), graph)
    assert asked.may_replace((0, 1), nodes, (held, before), (accepted, after)) is may
