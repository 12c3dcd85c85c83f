"""Relative pose of two groups from closures of which some are false."""

from types import SimpleNamespace

import numpy as np
import pytest

from twc_env.config import MergingConfig
from twc_env.records.geometry import between, compose
from twc_env.records.messages import LoopCandidate, LoopClosure, SignObservation
from twc_env.slam.merging.map_merging import SOON_M
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
    ("names", "repeated", "may"),
    [(1, 0, False), (8, 0, False), (9, 0, True), (28, 1, False), (29, 1, True), (29, 2, False)],
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


@pytest.mark.parametrize(
    ("difference", "counts", "way", "may"),
    [
        (0.7, (1, 0), "wifi", True),
        (0.7, (0, 0), "wifi", False),
        (0.7, (1, 1), "wifi", False),
        (0.5, (0, 0), "wifi", True),
        (0.7, (0, 0), "twc", True),
        (1.1, (9, 0), "wifi", False),
    ],
)
@pytest.mark.parametrize("are_together", [True, False])
def test_robots_that_never_saw_each_other_need_a_sign_or_places_that_sound_much_alike(
    difference, counts, way, may, are_together
):
    watch = SimpleNamespace(
        are_together=lambda *_: are_together, count=lambda *_: ObservationCounts(*counts), are_known=True
    )
    asked = MergeTests(MergingConfig(), GRAPH, mutual_observations=watch)
    asked.radio_difference = lambda a, b, pose, between_m=SOON_M: difference
    proposal = asked.proposal(say(4, TRUE, way), (0,))
    assert asked.cues_confirm((0,), (1,), proposal) is (may or (not are_together and difference < 1.0))


@pytest.mark.parametrize(
    ("told", "wifi_check", "is_other"),
    [((60, 0, 34), False, True), ((60, 0, 34), True, False), ((11, 0, 34), False, False)],
)
def test_of_two_places_where_robots_were_seen_the_one_where_most_often_counts(told, wifi_check, is_other):
    """Not the one with most closures: in identical wings there are more between wrong rooms than between right ones."""
    seen_there = {tuple(np.round(ELSEWHERE, 6)): (12, 0, 6), tuple(np.round(TRUE, 6)): told}
    watch = SimpleNamespace(
        are_known=True,
        count=lambda a, b, pose: ObservationCounts(*seen_there.get(tuple(np.round(pose, 6)), (0, 9, 0))),
    )
    closures = say(7, ELSEWHERE, "twc") + say(4, TRUE, "twc")
    asked = MergeTests(MergingConfig(wifi_check=wifi_check), GRAPH, mutual_observations=watch)
    proposal = asked.proposal(closures, (0,))
    assert np.allclose(proposal.pose_a_b, ELSEWHERE)
    chosen = asked.most_observed((0,), (1,), proposal, closures)
    assert np.allclose(chosen.pose_a_b, TRUE if is_other else ELSEWHERE) and chosen.is_proven is is_other


def test_a_closure_is_confirmed_by_another_from_elsewhere_that_moves_the_robots_alike():
    first, beside, *further = say(4, TRUE, "wifi")
    beside.pose_target_source = first.pose_target_source.copy()
    beside.candidate = first.candidate
    false = say(4, A_SHELF_ASIDE, "wifi")
    assert merge_tests().agreeing_with(first, [beside, *further, *false]) == further
    assert merge_tests().agreeing_with(first, []) == []


@pytest.mark.parametrize(
    ("soon", "later", "merges", "stays"),
    [
        (0.99, 1.2, True, True),
        (1.06, 1.06, False, True),
        (1.2, 1.2, False, False),
        (1.2, 0.99, True, True),
        (1.2, None, False, None),
        (None, 0.99, False, None),
    ],
)
def test_radio_asks_more_of_a_new_merge_than_of_an_existing_one(soon, later, merges, stays):
    """Four closures by radio put a robot into a warehouse turned by half a circle, at a difference of 1.06.

    Beside what robots hear soon after, what they hear when they come back may speak for a merge.
    """
    asked = merge_tests()
    asked.radio_difference = lambda a, b, pose, between_m=SOON_M: soon if between_m == SOON_M else later
    assert asked.cues_confirm((0,), (1,), asked.proposal(say(4, TRUE, "wifi"), (0,))) is merges
    assert asked.radio_still_agrees((0,), (1,)) is stays


@pytest.mark.parametrize(("kept", "moves"), [(2, True), (3, False)])
def test_a_solution_moves_robots_against_most_closures_between_them(kept, moves):
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
    assert asked.moves_robots_apart((held, before), (accepted, after), nodes) is moves
