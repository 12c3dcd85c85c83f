"""Optimisation of large maps with fixed keyframes: bounded cost and equal accuracy."""

import pickle

import numpy as np
import pytest

from twc_env import parallel_env
from twc_env.bench.rates import wander
from twc_env.config import EnvConfig, override
from twc_env.exploration.assessment import map_evaluation
from twc_env.records.geometry import compose
from twc_env.slam.merging.map_optimiser import MapOptimiser
from twc_env.slam.places import sign_readings
from twc_env.slam.pose_graph.fixed_keyframes import GROWN, LARGE_FROM, MOVABLE, FixedKeyframes

TEAM, ODD_TEAM = (0, 1), (0, 2)


def episode(steps, settled=(), **settings):
    """The engine after an episode of a team with a reactive policy."""
    env = parallel_env(config=override(EnvConfig(), {"max_cycles": steps, **settings}))
    env.reset(seed=0)
    for mapper in env.episode.engine.mappers:
        mapper.optimiser.fixed_keyframes = FixedKeyframes(*settled)
    for action in wander(env, 0):
        env.step(action)
    return env.episode.engine


@pytest.fixture(scope="module")
def walked():
    return pickle.dumps(episode(2000).team)


@pytest.fixture
def team(walked):
    """A copy of the mapper of the episode, which tests may modify."""
    return pickle.loads(walked)


def test_small_and_never_optimised_maps_have_no_fixed_keyframes():
    maps = FixedKeyframes()
    assert maps.first_movable(TEAM, 10 * LARGE_FROM) == 0
    maps.record_optimised(TEAM, LARGE_FROM - 2, is_whole=True)
    assert maps.first_movable(TEAM, LARGE_FROM - 1) == 0


def test_large_maps_are_optimised_as_a_whole_each_time_they_have_grown_by_a_share():
    maps, wholes = FixedKeyframes(), 0
    for count in range(LARGE_FROM, 16 * LARGE_FROM):
        first = maps.first_movable(TEAM, count)
        wholes += first == 0
        maps.record_optimised(TEAM, count, is_whole=first == 0)
        assert first == 0 or first == count - 1 - MOVABLE
    assert wholes == 1 + int(np.log(16) / np.log(GROWN))


def test_keyframes_since_the_last_optimisation_are_movable():
    maps = FixedKeyframes()
    maps.record_optimised(TEAM, 8 * LARGE_FROM, is_whole=True)
    assert maps.first_movable(TEAM, 9 * LARGE_FROM) == 8 * LARGE_FROM - MOVABLE


def test_other_groups_and_merged_maps_have_no_fixed_keyframes():
    maps = FixedKeyframes()
    maps.record_optimised(TEAM, LARGE_FROM, is_whole=True)
    assert maps.first_movable(ODD_TEAM, LARGE_FROM + 1) == 0
    maps.reset()
    assert maps.first_movable(TEAM, LARGE_FROM + 1) == 0


def test_redrawing_from_the_first_movable_keyframe_equals_a_full_redraw(team):
    maps, count = team._maps, len(team.nodes[0])
    team._graph.poses[count // 2 :] += (0.1, 0.0, 0.01)
    for first in (count // 3, count // 2):  # the second redraw starts from the result of the first
        maps.redraw(0, first)
    drawn = cells(team.grid_of(0))
    maps.redraw(0)
    assert len(drawn) > 1000 and drawn == cells(team.grid_of(0))
    maps.redraw_if_moved(0)
    version = maps.groups[0].version
    maps.redraw_if_moved(0)
    assert maps.groups[0].version == version


def test_fixed_keyframes_that_have_moved_are_redrawn(team):
    maps, count = team._maps, len(team.nodes[0])
    maps.redraw(0, count // 2)
    team._graph.poses[: count // 2] += (0.3, 0.0, 0.0)
    maps.redraw_if_moved(0, count // 2)
    drawn = cells(team.grid_of(0))
    maps.redraw(0)
    assert drawn == cells(team.grid_of(0))


def cells(grid) -> dict:
    """Log-odds of the known cells by (column, row) relative to the map frame."""
    rows, columns = np.nonzero(grid.log_odds)
    corner = np.round(grid.origin_m / grid.resolution_m).astype(int)
    where = zip((columns + corner[0]).tolist(), (rows + corner[1]).tolist(), strict=True)
    return dict(zip(where, grid.log_odds[rows, columns].tolist(), strict=True))


def test_known_signs_do_not_change_if_repeated_readings_are_dropped(monkeypatch, team):
    monkeypatch.setattr(sign_readings, "ENOUGH", 10**9)
    every = episode(2000).team
    for group, other in zip(team.groups, every.groups, strict=True):
        known, more = (t._graph.signs(group.robots) for t in (team, every))
        assert other.robots == group.robots
        assert [s.text for s in known] == [s.text for s in more]
        assert np.array([s.position_m for s in known]) == pytest.approx(np.array([s.position_m for s in more]))
    assert team._graph._readings._count < every._graph._readings._count


@pytest.mark.parametrize("stride", [1, 2, 5])
def test_a_subset_of_keyframes_gives_the_alignment_of_all(stride):
    random, count = np.random.default_rng(0), 500
    robots, steps = random.integers(0, 3, count), np.sort(random.integers(0, 900, count))
    truth = random.normal(0, 5, (900, 3, 3))
    poses = compose([1.0, 2.0, 0.5], truth[steps, robots]) + random.normal(0, 0.01, (count, 3))
    poses[robots == 2] = compose([3.0, 0.0, 0.0], poses[robots == 2])
    laid, room = np.empty(3), map_evaluation._room_for(count, 3)
    paths, lengths = np.argsort(robots != np.arange(3)[:, None], axis=1, kind="stable"), np.bincount(robots)
    nodes = poses, steps, paths, lengths
    wrong = map_evaluation._lay_paths(np.arange(3), *nodes, truth, stride, room, laid)
    every, pairs = map_evaluation.lay((0, 1, 2), nodes, truth)
    assert laid == pytest.approx(every, abs=0.3 if stride > 1 else 0.0)
    assert wrong == len(pairs) == 2


def test_a_subgraph_has_all_edges_to_later_nodes_and_their_ends(team):
    graph, robots = team._graph, team.groups[0].robots
    first = len(graph.poses) // 2
    everything, edges, whole, used = graph.subgraph(robots)
    nodes, later, part, is_used = graph.subgraph(robots, first)
    ends = everything[whole.edges]
    assert np.array_equal(later, edges[ends.max(axis=1) >= first])
    assert np.array_equal(nodes[part.edges], ends[ends.max(axis=1) >= first])
    assert set(nodes) == set(everything[everything >= first]) | set(nodes[part.edges].ravel())
    assert np.array_equal(is_used, used[ends.max(axis=1) >= first])
    assert part.measured.tobytes() == whole.of(ends.max(axis=1) >= first).measured.tobytes()


@pytest.mark.parametrize("robust", ["ours", "dcs"])
def test_maps_with_fixed_keyframes_are_as_accurate(monkeypatch, robust):
    whole = episode(2500, **{"slam.pose_graph.robust": robust}).team
    tries = []
    optimise_latest = MapOptimiser._optimise_latest
    monkeypatch.setattr(MapOptimiser, "_optimise_latest", lambda *a: tries.append(optimise_latest(*a)) or tries[-1])
    parts = episode(2500, (300, 100, False), **{"slam.pose_graph.robust": robust}).team
    assert (sum(tries) > 5) == (robust == "ours")
    assert [g.robots for g in parts.groups] == [g.robots for g in whole.groups]
    assert np.abs(parts.nodes[0] - whole.nodes[0]).max() < 0.05


def test_mappers_of_several_robots_share_the_memory_of_each_scan():
    engine = episode(300, **{"link.topology": "peer"})
    first, other = (mapper._graph for mapper in engine.mappers[:2])
    heard = [keyframe.index for keyframe in other.keyframes[0]]
    assert len(heard) > 5
    for index in heard:
        scans = [
            graph.rows_of(slice(node, node + 1))[1] for graph in (first, other) for node in [graph.node((0, index))]
        ]
        assert np.shares_memory(*scans)


def test_scans_equal_those_of_the_keyframes(team):
    graph = team._graph
    for robot, path in enumerate(graph.keyframes):
        steps, scans = team.scans_of(robot)
        assert np.array_equal(scans, [keyframe.ranges_m for keyframe in path])
        assert steps.tolist() == [keyframe.step for keyframe in path]
    nodes = np.array([3, 1, 1])
    poses, scans = graph.rows_of(nodes)
    assert np.array_equal(scans[1], scans[2]) and scans.shape == (3, 180)
    assert np.array_equal(poses, graph.poses[nodes]) and graph.rows_of(nodes[:0])[1].shape == (0, 180)
