"""Removal of redundant keyframes from large maps: accuracy, closures, signs, merges and snapshots still work."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from twc_env import parallel_env
from twc_env.bench.rates import wander
from twc_env.config import EnvConfig, override
from twc_env.exploration.assessment.team_alignment import team_error_m
from twc_env.records.geometry import between, compose
from twc_env.records.messages import LoopCandidate, LoopClosure, SignObservation
from twc_env.slam.mapping.keyframe_sparsification import CLOSURES_KEPT, KeyframeSparsification
from twc_env.slam.mapping.removed_keyframes import RemovedKeyframes
from twc_env.slam.merging.map_optimiser import MapOptimiser
from twc_env.slam.places.device_offsets import DeviceOffsets
from twc_env.slam.places.place_evidence import PlaceMemory
from twc_env.slam.places.place_recognition import ProposalFilter
from twc_env.slam.places.sign_readings import SignReadings
from twc_env.slam.pose_graph.fixed_keyframes import FixedKeyframes
from twc_env.slam.pose_graph.graph_arrays import ODOMETRY
from twc_env.slam.team import TeamMapper

STEPS, SMALL = 3000, (300, 100)
"""In these tests maps of 300 keyframes count as large, and the latest 100 keyframes as movable."""


def started(steps=STEPS, sparsifies=True, **settings):
    """An environment of three robots after `reset`, and the actions of a reactive policy."""
    env = parallel_env(config=override(EnvConfig(), {"max_cycles": steps, "map": "twin-02", **settings}))
    env.reset(seed=1)
    for mapper in env.episode.engine.mappers:
        mapper.optimiser.fixed_keyframes = FixedKeyframes(*SMALL, sparsifies)
    return env, wander(env, 1)


def before_the_end(steps, sparsifies=True, **settings):
    """The environment after all but the last step of such an episode."""
    env, actions = started(steps, sparsifies, **settings)
    for _ in range(steps - 1):
        env.step(next(actions))
    return env


def error_m(env) -> float:
    record = env.episode.record
    return team_error_m(env.episode.engine, record.odom_poses, record.true_poses)


@pytest.fixture(scope="module")
def walked():
    """The same long episode with and without removal of keyframes, before its last step."""
    return [before_the_end(STEPS, sparsifies) for sparsifies in (True, False)]


def mappers_of(walked):
    return [env.episode.engine.team for env in walked]


def test_a_map_with_removed_keyframes_is_smaller_and_as_accurate(walked):
    sparse, other = mappers_of(walked)
    assert len(other.nodes[0]) > 900 and len(sparse.nodes[0]) < 0.6 * len(other.nodes[0])
    assert [group.robots for group in sparse.groups] == [group.robots for group in other.groups] == [(0, 1, 2)]
    errors = [error_m(env) for env in walked]
    assert errors[0] < max(1.1 * errors[1], 0.02)


def test_poses_of_removed_keyframes_are_still_known(walked):
    for sparse, other in [mappers_of(walked)]:
        for robot in range(3):
            assert np.array_equal(sparse.keyframe_steps(robot), other.keyframe_steps(robot))
            assert np.abs(sparse.poses_of(robot) - other.poses_of(robot))[:, :2].max() < 0.15


def test_the_graph_is_consistent_after_removal(walked):
    graph = mappers_of(walked)[0]._graph
    numbers = [closure.number for closure in graph.closures]
    assert numbers == list(range(len(numbers))) and graph.closures_verified > len(numbers)
    assert graph.ends.max() < graph.node_count < graph.arrived_count
    tying = graph.closure_of_edge[graph.closure_of_edge != ODOMETRY]
    assert {graph._edge_of_closure[number] for number in tying} == set(np.flatnonzero(graph.closure_of_edge >= 0))
    for robot, path in enumerate(graph.keyframes):
        nodes = graph.path_of(robot)
        assert [graph.node((robot, keyframe.index)) for keyframe in path] == nodes.tolist()
        assert all(graph.keyframe((robot, keyframe.index)) is keyframe for keyframe in path)
        chain = graph.ends[(graph.closure_of_edge == ODOMETRY) & (graph.robot_of_node[graph.ends[:, 0]] == robot)]
        assert sorted(chain.tolist()) == list(map(list, itertools.pairwise(nodes)))


def test_closures_connect_keyframes_that_are_held(walked):
    graph = mappers_of(walked)[0]._graph
    for closure in graph.closures:
        ends = closure.candidate.target, closure.candidate.source
        assert all(graph.keyframe(end).index == end[1] for end in ends)
        if closure.number in graph._edge_of_closure:
            assert graph.ends[graph._edge_of_closure[closure.number]].tolist() == [graph.node(end) for end in ends]
    errors = [graph.disagreement(closure)[0] for closure in graph.closures if closure.status == "accepted"]
    assert len(errors) > 50 and np.quantile(errors, 0.9) < 0.1


def test_the_graph_hardly_grows_once_the_building_is_known():
    env, actions = started(6000)
    graph, seen = env.episode.engine.team._graph, []
    for step in range(5999):
        env.step(next(actions))
        if step % 50 == 48:
            seen.append((graph.arrived_count, graph.node_count))
    arrived, held = np.transpose(seen[:90])  # the first three quarters of the episode
    least_then, least_now = held[60:].min(), min(nodes for _, nodes in seen[90:])
    assert seen[-1][0] - arrived[-1] > 500 and least_now - least_then < 0.1 * (seen[-1][0] - arrived[-1])
    assert seen[-1][0] == sum(len(graph.steps_of(robot)) for robot in range(3)) > 2000
    assert len(graph._node_rows[0]) < 1000 and len(graph._edge_rows[0]) < 2000, "nor room for it"
    assert len(graph.closures) < graph.node_count < 0.25 * seen[-1][0]


def test_loops_are_closed_with_remaining_keyframes(walked):
    team = mappers_of(walked)[0]
    held = [{keyframe.index for keyframe in path} for path in team.keyframes]
    accepted = [c.candidate for c in team.closures if c.status == "accepted"]
    assert any(c.recogniser == "twc" and c.source[1] > 250 for c in accepted)
    assert all(index in held[robot] for c in accepted for robot, index in (c.target, c.source))


@pytest.mark.parametrize("recogniser", ["text", "wifi", "lidar", "fused"])
def test_every_recogniser_works_without_removed_keyframes(recogniser):
    env = before_the_end(2000, **{"slam.place_recognition.recogniser": recogniser})
    graph = env.episode.engine.team._graph
    assert graph.node_count < 0.65 * graph.arrived_count
    late = [
        c for c in graph.closures if c.status == "accepted" and max(c.candidate.target[1], c.candidate.source[1]) > 200
    ]
    assert recogniser in {closure.candidate.recogniser for closure in late}
    assert not env.episode.record.wrong_pairs and error_m(env) < 0.05


@pytest.mark.parametrize("robust", ["plain", "dcs", "gnc"])
def test_maps_of_other_back_ends_are_also_sparsified(robust):
    env = before_the_end(2000, **{"slam.pose_graph.robust": robust})
    graph = env.episode.engine.team._graph
    assert graph.node_count < 0.65 * graph.arrived_count
    assert not env.episode.record.wrong_pairs and error_m(env) < 0.05


def test_signs_are_known_from_the_remaining_keyframes(keyframe):
    memory, sign = PlaceMemory(8.0), SignObservation("EXIT", np.array([1.0, 0.0]), 0.0)
    read = [keyframe(robot=0, index=k, travel_m=0.1 * k, signs=(sign,)) for k in range(9)]
    places = {id(place) for one in read for place in memory.observe(one)}
    other = keyframe(robot=0, index=9, travel_m=30.0, signs=(SignObservation("LIFT", np.array([40.0, 0.0]), 0.0),))
    memory.observe(other)
    assert len(places) == 1 and len(memory.signs[0]) == 2
    seen = [view.index for view, _ in memory.signs[0][0].views]
    unseen = next(k for k in range(9) if k not in seen)
    memory.sparsify(lambda one: one.index == unseen)
    assert [[view.index for view, _ in place.views] for place in memory.signs[0]] == [[unseen]]
    assert memory.place_of((read[unseen], sign)) is memory.signs[0][0] and memory.place_of((read[0], sign)) is None


def test_a_map_with_removed_keyframes_can_be_evaluated():
    env, actions = started(1500)
    for action in actions:
        env.step(action)
    figures = env.result().figures
    assert figures["wrong_merges"] == 0 and figures["team_ate_m"] < 0.1 and figures["wall_iou"] > 0.5


def test_an_episode_with_removed_keyframes_continues_exactly_from_a_snapshot():
    env, actions = started(1600, **{"map": "twin-01"})
    for _ in range(1200):
        env.step(next(actions))
    assert len(env.episode.engine.team.nodes[0]) < len(env.episode.record.true_poses)
    moment, action, ends = env.snapshot(), next(actions), []
    for _ in range(2):
        env.restore(moment)
        for _ in range(300):
            env.step(action)
        ends.append(env.episode.engine.team.nodes[0].tobytes())
    assert ends[0] == ends[1]


def test_peers_get_missing_keyframes_and_remove_keyframes_independently():
    env, actions = started(2500, **{"link.topology": "peer", "link.range_max_m": 6.0})
    for action in actions:
        env.step(action)
    mappers = env.episode.engine.mappers
    assert any(len(m.nodes[0]) < sum(len(m.keyframe_steps(r)) for r in range(3)) for m in mappers)
    for robot, mapper in enumerate(mappers):
        for other in range(3):
            steps = mapper.keyframe_steps(other)
            assert np.array_equal(steps, mappers[other].keyframe_steps(other)[: len(steps)])
            assert other != robot or len(steps) > 100
    assert not env.episode.record.wrong_pairs


def test_mappers_of_large_maps_optimise_in_turns(monkeypatch):
    busy, run = [], MapOptimiser.optimise_dirty

    def noting(self, step):
        if self._graph.arrived_count >= SMALL[0]:
            busy.append((self, step))
        run(self, step)

    monkeypatch.setattr(MapOptimiser, "optimise_dirty", noting)
    env = before_the_end(1600, **{"link.topology": "peer"})
    for home, mapper in enumerate(env.episode.engine.mappers):
        steps = [step for who, step in busy if who is mapper.optimiser]
        assert len(steps) > 2 and {step % 3 for step in steps} == {home}


def test_merges_of_large_maps_are_reviewed_one_per_step():
    env = before_the_end(900)
    review, step = env.episode.engine.team._review, 10000
    review.merges.append(replace(review.merges[0]))
    for due in (1, 0):
        assert review.wrong(step, one_by_one=True) is None
        assert sum(merge.due_step <= step for merge in review.merges) == due and review.due_step <= step
    assert review.wrong(step, one_by_one=True) is None and review.due_step > step


def test_a_merge_can_be_undone_after_keyframes_were_removed():
    env = before_the_end(2500)
    team, truth = env.episode.engine.team, env.episode.record.true_poses
    assert team.groups[0].robots == (0, 1, 2) and len(team.nodes[0]) < 700
    merge = team._review.merges[-1]
    team._review.wrong = lambda *_: (merge, "it is said to be")
    team._retry_merges = lambda: None
    team._undo_wrong_merge()
    assert len(team.groups) == 2
    for group in team.groups:
        for robot in group.robots:
            own, true = team.poses_of(robot), truth[team.keyframe_steps(robot), robot]
            away = between(own[0], own) - between(true[0], true)
            assert np.abs(away[:, :2]).max() < 0.5
        assert (team.grid_of(team.group_index(group.robots[0])).log_odds != 0).sum() > 1000


# --- other data of removed keyframes


def test_keyframes_of_the_firm_closures_of_a_merge_are_kept(keyframe):
    mapper = TeamMapper(EnvConfig(), 2)
    mapper.update(0, [keyframe(robot, k, (k, 0.0, 0.0), float(k)) for robot in (0, 1) for k in range(80)])
    graph, firm = mapper._graph, CLOSURES_KEPT
    for k in range(CLOSURES_KEPT + 2):
        covariance = np.diag([0.01 if k == firm else 4.0, 0.01, 0.01])
        near = LoopCandidate((0, 1 + k), (1, 1 + k), np.zeros(3), "wifi")
        closure = LoopClosure(near, np.zeros(3), covariance, 1.0, "pending")
        graph.add_closure(closure)
        graph.accept(closure)
    may_go = KeyframeSparsification(graph, [])._may_go(graph.nodes_of((0, 1)), graph.node_count)
    assert may_go[graph.node((0, 40))]
    assert not may_go[graph.node((0, 1 + firm))] and not may_go[graph.node((1, 1 + firm))]


def test_old_proposals_are_dropped_and_later_ones_kept(keyframe):
    tried, reach_m = ProposalFilter(), 2.0
    ends = [(keyframe(robot=0, travel_m=a), keyframe(robot=1, travel_m=b)) for a, b in ((5, 5), (50, 5), (5, 50))]
    assert all(tried.is_new(*pair, reach_m) for pair in ends)
    tried.drop_before([40.0, 40.0])
    assert [tried.is_new(*pair, reach_m) for pair in ends] == [True, False, False]


def test_readings_at_removed_keyframes_are_dropped_unless_unique(keyframe):
    readings, poses = SignReadings(1), np.zeros((6, 3))
    texts = ["exit", "exit", "exlt", "lift", "lift", "room"]
    for node, text in enumerate(texts):
        readings.add(
            keyframe(robot=0, index=node, signs=(SignObservation(text, np.array([1.0, 0.0]), 0.0),)), node, poses
        )
    readings.sparsify(np.array([0, 0, 0, 0, 0, 5]), np.array([0, -1, -1, -1, -1, 1]), poses)
    assert readings._readings[: readings._count, 1].tolist() == [0, 0, 1]
    poses = poses[[0, 5]]
    assert sorted(s.text for s in readings.known(poses, [0])) == ["exit", "lift", "room"]
    readings.add(keyframe(robot=0, index=6, signs=(SignObservation("exit", np.array([1.0, 0.0]), 0.0),)), 0, poses)
    assert readings.news == [6], "the exit was known already"
    assert len(readings.known(poses, [0])) == 3


def test_device_offsets_are_kept_without_their_texts():
    devices = DeviceOffsets()
    devices.make_room(2)
    devices.offset_db[0, 1] = 8.0
    devices.keep([])
    assert devices.offset_db[0, 1] == 8.0


def test_removed_keyframes_move_with_their_carriers_even_if_these_change():
    random = np.random.default_rng(2)
    poses = random.normal(0.0, 2.0, (6, 3))
    first, paths = poses.copy(), RemovedKeyframes()
    paths.add(
        (np.zeros(2), np.array([1, 4]), np.array([10, 40])), np.array([1, 4]), np.array([0, 0, 2, 3, 3, 5]), poses
    )
    paths.renumber(np.array([0, -1, 1, 2, -1, 3]))
    poses = poses[[0, 2, 3, 5]]
    paths.add((np.zeros(1), np.array([3]), np.array([30])), np.array([2]), np.array([0, 1, 0, 3]), poses)
    paths.renumber(np.array([0, 1, -1, 2]))
    poses, moved, held = poses[[0, 1, 3]], (3.0, -1.0, 0.7), np.array([0, 2, 5])
    whole = paths.poses_among(0, held, compose(moved, poses), compose(moved, poses))
    assert len(paths) == 3 and np.abs(between(whole, compose(moved, first))).max() < 1e-5
    assert paths.steps_among(0, held, np.array([0, 20, 50])).tolist() == [0, 10, 20, 30, 40, 50]
    assert paths.steps_among(1, held[:0], held[:0]).tolist() == []
