"""Injected wrong merges must be undone once measurements contradict them."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest

from twc_env import metrics
from twc_env.config import EnvConfig, override
from twc_env.records.geometry import between, compose
from twc_env.records.messages import LoopCandidate, LoopClosure
from twc_env.slam.engine import CooperativeSlam
from twc_env.slam.merging.map_merging import MergeProposal
from twc_env.slam.merging.merge_review import Merge, MergeReview
from twc_env.slam.merging.merge_tests import MergeTests
from twc_env.slam.merging.mutual_observations import MutualObservations, ObservationCounts
from twc_env.slam.team import TeamMapper

PLANTED_STEP = 60
ROOM_M = (8.0, 0.0, 0.0)
"""Error of the injected relative pose: robot 1 is placed one room too far."""
BLIND = {"slam.merging.contradiction_max": 1.0, "slam.merging.wifi_check": False}
UNSEEN = {"slam.merging.mutual_observations_check": False}
"""Robots do not look for each other; otherwise they soon merge rightly, by one closure."""


@pytest.fixture(autouse=True)
def no_names(monkeypatch):
    """Disables the comparison of sign texts: the signs of injected closures do not exist."""
    monkeypatch.setattr(MergeTests, "names_agree", lambda *_: True)


def closures(team, true_poses, shift=(0.0, 0.0, 0.0), count=5, signs_m=None, text=1.0) -> list[LoopClosure]:
    """Consistent closures between robots 0 and 1 that place robot 1 wrongly by `shift` in the building frame.

    Each has its own sign, or in turn one of those at `signs_m` (building frame); text: similarity of the two readings.
    """
    first, second = (true_poses[team.keyframe_steps(robot), robot] for robot in (0, 1))
    said = compose(np.array(shift), second)
    made = []
    for k in np.linspace(0, min(len(first), len(second)) - 1, count).astype(int).tolist():
        pose = between(first[k], said[k])
        at = (3.0 * len(made), 0.0) if signs_m is None else signs_m[len(made) % len(signs_m)]
        sign_m = between(first[k], np.array([*at, 0.0]))[:2]
        candidate = LoopCandidate((0, k), (1, k), pose, "twc", sign_m, text_similarity=text)
        made.append(LoopClosure(candidate, pose, np.diag([0.01, 0.01, 0.002]), 0.9, "pending"))
    return made


def plant(team, made) -> None:
    """Merge by these closures without the checks of walls and radio."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MergeTests, "walls_disagree", lambda *_: False)
        patch.setattr(MergeTests, "radio_agrees", lambda *_: True)
        for closure in made:
            team._graph.add_closure(closure)
        assert team._try_merge(*sorted(team.group_index(robot) for robot in (0, 1)))


def wrong_pairs(team, true_poses) -> list[tuple[int, int]]:
    wrong = []
    for group in team.groups:
        counts = [len(team.keyframes[r]) for r in group.robots]
        estimated = np.concatenate([team.poses_of(r) for r in group.robots])
        true = np.concatenate([true_poses[team.keyframe_steps(r), r] for r in group.robots])
        frames = metrics.implied_frames(estimated, true, np.repeat(np.arange(len(counts)), counts))
        pairs = metrics.wrong_pairs(frames, estimated[:, :2].mean(axis=0))
        wrong += [(group.robots[i], group.robots[j]) for i, j in pairs]
    return wrong


def run(recorded, shift=ROOM_M, steps=400, **settings):
    """An engine with an injected merge; its groups and robot 0's teammates and map version after every step."""
    config, frames, true_poses = recorded
    engine = CooperativeSlam(override(config, settings), 3)
    groups, beliefs = [], []
    for step, now in enumerate(frames[:steps]):
        engine.update(now)
        if step == PLANTED_STEP:
            plant(engine.team, closures(engine.team, true_poses, shift))
        groups.append([group.robots for group in engine.team.groups])
        belief = engine.belief(0)
        beliefs.append((set(belief.teammates), belief.map_version))
    return engine, groups, beliefs


def team_before(recorded, settings=None) -> tuple[TeamMapper, np.ndarray]:
    """The team of an engine up to that step, without an injected merge; and the true poses."""
    config, frames, true_poses = recorded
    engine = CooperativeSlam(override(config, settings or {}), 3)
    for now in frames[: PLANTED_STEP + 1]:
        engine.update(now)
    return engine.team, true_poses


@pytest.fixture(scope="module")
def undone(recorded):
    return run(recorded, **UNSEEN)


def test_a_merge_of_similar_rooms_is_undone_when_walls_contradict_it(recorded, undone):
    engine, groups, _ = undone
    together = [any(0 in robots and 1 in robots for robots in now) for now in groups]
    assert together[PLANTED_STEP] and not together[PLANTED_STEP + 60]
    assert together.index(False, PLANTED_STEP) > PLANTED_STEP
    assert not any(together[PLANTED_STEP + 60 :]), "torn apart once, and not put together wrongly again"
    assert wrong_pairs(engine.team, recorded[2]) == []


def test_beliefs_follow_when_a_merge_is_undone(undone):
    _, groups, beliefs = undone
    split = next(k for k in range(PLANTED_STEP, 400) if (0,) in groups[k])
    assert beliefs[split - 1][0] == {1} and beliefs[split][0] == set()
    assert beliefs[split][1] > beliefs[split - 1][1], "plans made before must be dropped"
    assert [version for _, version in beliefs] == sorted(version for _, version in beliefs)


def test_the_closures_of_an_undone_merge_state_the_reason(undone):
    reasons = [c.reason for c in undone[0].team.closures if c.status == "rejected" and c.candidate.target[0] == 0]
    told = [reason for reason in reasons if reason.startswith("the merge it spoke for was undone: ")]
    assert len(told) == 5 and "of the walls of one lie in the free space of the other" in told[0]


def test_undoing_is_deterministic(recorded, undone):
    digests = [
        hashlib.sha256(b"".join(e.team.poses_of(r).tobytes() for r in range(3))).hexdigest()
        for e in (undone[0], run(recorded, **UNSEEN)[0])
    ]
    assert digests[0] == digests[1]


def test_only_steps_without_messages_and_due_work_are_skipped(recorded, monkeypatch):
    looked = []
    monkeypatch.setattr(MergeReview, "wrong", lambda review, step, one_by_one: looked.append(("merges", step)))
    monkeypatch.setattr(TeamMapper, "_retry_merges", lambda team: looked.append(("pending", team._step)))
    found = []
    for is_always_asked in (False, True):
        looked.clear()
        team = run(recorded, steps=PLANTED_STEP + 1)[0].team
        for step in range(PLANTED_STEP + 1, PLANTED_STEP + 200):
            if is_always_asked:
                team._idle_changes = -1
            team.update(step, [])
        found.append(looked.copy())
    assert found[0] == found[1]
    assert {what for what, _ in found[0]} == {"merges", "pending"}


@pytest.fixture
def say_seen_through(monkeypatch):
    """A function: from its call on, mutual observations contradict every merge."""
    return lambda: monkeypatch.setattr(MutualObservations, "count", lambda *_: ObservationCounts(0, 5))


def test_robots_are_not_merged_if_mutual_observations_contradict(recorded, say_seen_through):
    config, frames, _ = recorded
    merged = []
    for is_told in (False, True):
        if is_told:
            say_seen_through()
        engine = CooperativeSlam(config, 3)
        counts = [engine.update(now) or len(engine.team.groups) for now in frames]
        merged.append(min(counts) < 3)
    assert merged == [True, False]


def test_a_merge_is_undone_when_mutual_observations_contradict_it(recorded, say_seen_through):
    team = run(recorded, shift=(0.0, 0.0, 0.0), steps=PLANTED_STEP + 1)[0].team
    step = team._review.merges[-1].due_step
    assert team._review.wrong(step - 1, False) is None
    say_seen_through()
    assert team._review.wrong(step, False)[1] == "robots saw through the places where it puts others"


def test_a_merge_with_only_loose_closures_is_undone(recorded):
    team = run(recorded, shift=(0.0, 0.0, 0.0), steps=PLANTED_STEP + 1)[0].team
    assert team._review.wrong(PLANTED_STEP + 1, False) is None
    for closure in team.closures:
        closure.covariance = np.diag([4.0, 0.01, 0.01])
    team._review.merges[-1].due_step = PLANTED_STEP + 1
    assert team._review.wrong(PLANTED_STEP + 1, False)[1] == "no closure is left that speaks for it"


def test_without_undo_the_wrong_merge_stays(recorded):
    engine, groups, _ = run(recorded, **{"slam.merging.undo": False})
    assert any(0 in robots and 1 in robots for robots in groups[-1])
    assert wrong_pairs(engine.team, recorded[2]) != []


def test_more_closures_for_another_pose_replace_a_merge(recorded):
    engine, _, _ = run(recorded, steps=PLANTED_STEP + 1, **BLIND)
    team, true_poses = engine.team, recorded[2]
    for count, is_merged in ((4, False), (7, True)):
        for closure in closures(team, true_poses, count=count):
            team._graph.add_closure(closure)
            team._test_inside_map(closure)
        for step in range(PLANTED_STEP + 1, PLANTED_STEP + 4):
            team.update(step, [])
        if not is_merged:
            assert wrong_pairs(team, true_poses) == [(0, 1)], "four against five are not enough"
    assert team.group_index(0) == team.group_index(1), "and those who outvoted it merge at once"
    assert wrong_pairs(team, true_poses) == []


def test_a_rival_by_which_robots_saw_through_each_other_outvotes_nothing(recorded, monkeypatch):
    engine, _, _ = run(recorded, shift=(0.0, 0.0, 0.0), steps=PLANTED_STEP + 1, **BLIND)
    team, true_poses = engine.team, recorded[2]
    for closure in closures(team, true_poses, ROOM_M, count=7):
        team._graph.add_closure(closure)
        team._test_inside_map(closure)
    review, merge, found = team._review, team._review.merges[-1], {}
    for name, seen, seen_through in (("allowed", 0, 0), ("contradicted", 0, 5), ("confirmed", 10, 0)):
        counted = ObservationCounts(seen, seen_through)
        monkeypatch.setattr(MutualObservations, "count", lambda *_, counted=counted: counted)
        merge.refusals_seen = -1
        found[name] = review.wrong(PLANTED_STEP + 1, False)
    assert "closures agree on another place" in found["allowed"][1]
    assert found["contradicted"] is None
    assert found["confirmed"] is None, "robots that saw each other were there"


def test_one_closure_is_enough_where_robots_saw_each_other(recorded, monkeypatch):
    team, true_poses = team_before(recorded, BLIND)
    sides = sorted(team.group_index(robot) for robot in (0, 1))
    team._graph.add_closure(closures(team, true_poses, count=1)[0])
    monkeypatch.setattr(MutualObservations, "count", lambda *_: ObservationCounts(9, 0, 9))
    assert not team._try_merge(*sides)
    monkeypatch.setattr(MutualObservations, "count", lambda *_: ObservationCounts(10, 0, 5))
    assert team._try_merge(*sides)
    assert wrong_pairs(team, true_poses) == []


@pytest.mark.parametrize("count", [7, 12])
def test_many_closures_by_two_signs_do_not_replace_a_merge_by_more_signs(recorded, count):
    engine, _, _ = run(recorded, shift=(0.0, 0.0, 0.0), steps=PLANTED_STEP + 1, **BLIND)
    team, true_poses = engine.team, recorded[2]
    spot = true_poses[PLANTED_STEP, 0, :2]
    for closure in closures(team, true_poses, ROOM_M, count, signs_m=[spot, spot + 3.0]):
        team._graph.add_closure(closure)
        team._test_inside_map(closure)
    team.optimiser.optimise(team.group_index(0), is_thorough=True)
    for step in range(PLANTED_STEP + 1, PLANTED_STEP + 4):
        team.update(step, [])
    assert wrong_pairs(team, true_poses) == []
    assert [c.status for c in team.closures[-count:]] == ["rejected"] * count
    assert team.merges_undone == 0


def test_similar_texts_do_not_merge_maps_without_an_equal_one(recorded):
    team, true_poses = team_before(recorded, BLIND | UNSEEN)
    for closure in closures(team, true_poses, text=0.9):
        team._graph.add_closure(closure)
    sides = sorted(team.group_index(robot) for robot in (0, 1))
    assert not team._try_merge(*sides)
    team.closures[-1].candidate.text_similarity = 1.0
    assert team._try_merge(*sides)


def test_repeating_an_undone_merge_needs_twice_as_many_closures(undone):
    team = undone[0].team
    review = team._review
    i, j, before = review._undone[0]
    graph = team._graph
    again = compose(compose(graph.pose_map_odom(i), before), between(graph.pose_map_odom(j), np.zeros(3)))
    elsewhere = compose(again, [5.0, 0.0, 0.0])
    for is_proven, count in ((False, 3), (True, 1)):
        there, further = (
            MergeProposal(pose, np.ones(9, bool), (1, 2, 9), is_proven=is_proven) for pose in (again, elsewhere)
        )
        assert review.closures_needed((i,), (j,), there) == 2 * count
        assert review.closures_needed((i,), (j,), further) == review.closures_needed((i,), (2,), there) == count


def test_the_latest_merge_is_undone_if_closures_strain_the_odometry(recorded):
    engine, _, _ = run(recorded, (0.0, 0.0, 0.0), 200, **BLIND)
    team, graph = engine.team, engine.team._graph
    robots = team.groups[team.group_index(0)].robots
    assert {0, 1} <= set(robots)
    squared, count = graph.strain(robots)
    assert squared < 0.3 * 3 * count
    latest = team._review.merges[-1]
    for merge in team._review.merges:
        merge.due_step = 0
    assert team._review.wrong(200) is None
    nodes = graph.subgraph(robots)[0]
    graph.place(nodes, graph.poses[nodes] * (1.4, 1.0, 1.0))
    for merge in team._review.merges:
        merge.due_step = 0
    found = team._review.wrong(201)
    assert found is not None and found[0] is latest and "odometry" in found[1]


def test_correct_merges_are_kept(recorded):
    config, frames, true_poses = recorded
    engine = CooperativeSlam(config, 3)
    for step in frames:
        engine.update(step)
    engine.finish()
    assert max(len(group.robots) for group in engine.team.groups) >= 2
    assert engine.team._review._undone == []
    assert wrong_pairs(engine.team, true_poses) == []


@pytest.mark.parametrize(
    ("sides", "left"),
    [
        (((0, 2, 3), (1,)), [((0,), (2, 3)), ((2,), (3,)), ((4,), (5,))]),
        (((0, 2), (1, 3)), [((0,), (2,)), ((1,), (3,)), ((4,), (5,))]),
    ],
    ids=["one goes", "across a later merge"],
)
def test_after_a_split_other_merges_are_restricted_to_one_side(undone, sides, left):
    review = undone[0].team._review
    wrong = Merge((0,), (1,), due_step=9)
    fresh = MergeReview(review._rule, review._graph, review._maps, review._tests)
    fresh.merges = [wrong, Merge((0, 1), (2, 3), 20), Merge((2,), (3,), 30), Merge((4,), (5,), 40)]
    fresh.record_undone(wrong, sides)
    assert sorted((merge.a, merge.b) for merge in fresh.merges) == left
    assert fresh.undone_count == 1


@pytest.mark.parametrize(("count", "tries"), [(10, 10), (200, 70)])
def test_retries_become_rarer_with_more_pending_closures(recorded, monkeypatch, count, tries):
    (team, true_poses), asked = team_before(recorded), []
    coming = [replace(closure, status="accepted") for closure in closures(team, true_poses, count=count)]
    monkeypatch.setattr(team._search, "next_closure", iter([*coming, None]).__next__)
    monkeypatch.setattr(MergeTests, "proposal", lambda *_: asked.append(1))
    while team._verify_one():
        pass
    assert {closure.status for closure in coming} == {"pending"}
    assert min(count, 16) <= len(asked) <= tries


@pytest.mark.parametrize(("home", "steps"), [(None, [0, 1, 2, 3, 4, 5]), (0, [0, 3]), (2, [2, 5])])
def test_mappers_on_robots_review_merges_in_turns(monkeypatch, home, steps):
    looked, mapper = [], TeamMapper(EnvConfig(), 3, home)
    monkeypatch.setattr(MergeReview, "due_step", 0)
    monkeypatch.setattr(MergeReview, "wrong", lambda review, step, one_by_one: looked.append(step))
    for step in range(6):
        mapper.update(step, [])
    assert looked == steps


@pytest.mark.parametrize(("loose", "firm", "b"), [(5, 3, (1, 2)), (5, 0, (1,)), (0, 3, (1, 2))])
def test_a_robot_merged_later_goes_to_the_side_with_most_firm_closures(keyframe, scan, walls, loose, firm, b):
    room = scan(walls((-3, -2), (3, -2), (3, 2), (-3, 2)), (0.0, 0.0, 0.0))
    team = TeamMapper(EnvConfig(), 3)
    team.give_starts(np.zeros((3, 3)))
    team.update(0, [keyframe(robot, 0, (0.0, 0.0, 0.0), 0.0, room) for robot in range(3)])
    for target, count, axis_m2 in ((0, loose, 4.0), (1, firm, 0.01)):
        for _ in range(count):
            candidate = LoopCandidate((target, 0), (2, 0), np.zeros(3), "wifi")
            team._graph.add_closure(
                LoopClosure(candidate, np.zeros(3), np.diag([axis_m2, 0.01, 0.01]), 1.0, "accepted")
            )
    assert team._review.sides(Merge((0,), (1,), 50))[1] == b
