import numpy as np
import pytest

from twc_env.config import PoseGraphConfig
from twc_env.errors import DataError
from twc_env.records.geometry import between, compose, inverse, poses_along
from twc_env.slam.pose_graph import robust_back_end as robust_backend
from twc_env.slam.pose_graph import solver as pose_graph
from twc_env.slam.pose_graph.block_cholesky import BlockCholesky
from twc_env.slam.pose_graph.solver import Graph

MODES = ("plain", "dcs", "cauchy", "gnc", "pcm", "ours")
STD = np.array([0.05, 0.05, 0.01])


def loops(seed: int = 0, laps: int = 4, side: int = 8):
    """A robot that drives around the same block repeatedly: true poses, initial poses, and its graph."""
    random = np.random.default_rng(seed)
    count = 4 * side * laps
    true = np.zeros((count, 3))
    for k in range(1, count):
        true[k] = compose(true[k - 1], [1.0, 0.0, np.pi / 2 if k % side == 0 else 0.0])
    chain = [(k, k + 1) for k in range(count - 1)]
    closures = [(k, k + 4 * side) for k in range(0, count - 4 * side, 5)]
    edges = np.array(chain + closures)
    measured = compose(between(true[edges[:, 0]], true[edges[:, 1]]), random.normal(0, STD, (len(edges), 3)))
    information = np.tile(np.diag(STD**-2), (len(edges), 1, 1))
    graph = Graph(edges, measured, information, np.arange(len(edges)) >= len(chain))
    return true, poses_along(measured[: len(chain)]), graph


def with_false(graph, edges, measured):
    """The graph with further closures."""
    information, are_closures = np.tile(graph.information[-1], (len(edges), 1, 1)), np.ones(len(edges), bool)
    more = np.array(edges), np.array(measured), information, are_closures
    return Graph(*(np.concatenate(pair) for pair in zip(graph.parts, more, strict=True)))


def false_room(true, graph, moved=(3.0, 4.0, 0.4), first=(2, 50), length=20):
    """The graph with twenty consistent false closures between poses from `first[0]` and `first[1]` on."""
    random = np.random.default_rng(1)
    a, b = first[0] + np.arange(length), first[1] + np.arange(length)
    shift = compose(compose(true[first[0]], moved), inverse(true[first[1]]))
    claimed = between(true[a], compose(shift, true[b]))
    return with_false(graph, np.stack([a, b], axis=1), compose(claimed, random.normal(0, STD, (length, 3))))


def solve(mode, start, graph, **settings):
    return robust_backend.solve(start, *graph.parts, PoseGraphConfig(robust=mode, iterations_max=100, **settings))


def worst_m(poses, true) -> float:
    return float(np.hypot(*(between(between(true[0], true), between(poses[0], poses)))[:, :2].T).max())


@pytest.mark.parametrize("mode", MODES)
def test_every_mode_accepts_true_closures_and_corrects_the_drift(mode):
    true, start, graph = loops()
    result = solve(mode, start, graph)
    assert worst_m(start, true) > 0.8
    assert worst_m(result.poses, true) < 0.5
    assert result.accepted[graph.is_closure].mean() > 0.9
    assert result.accepted[~graph.is_closure].all()


@pytest.mark.parametrize("mode", ["gnc", "pcm", "ours", "dcs"])
def test_single_false_closures_are_rejected(mode):
    true, start, graph = loops()
    random = np.random.default_rng(4)
    wrong = [(3, 47), (10, 90), (21, 70), (30, 101), (44, 120)]
    corrupted = with_false(graph, wrong, random.normal(0, (1.0, 1.0, 0.3), (5, 3)))
    result = solve(mode, start, corrupted)
    assert not result.accepted[-5:].any()
    assert worst_m(result.poses, true) < 0.5


def test_a_self_consistent_group_of_false_closures_is_rejected():
    true, start, graph = loops()
    corrupted = false_room(true, graph)
    result = solve("ours", start, corrupted)
    assert not result.accepted[-20:].any()
    assert result.accepted[: len(graph.edges)].all()
    refused = result.rejections[-20:]
    assert all("group of 20 is self-consistent but contradicts the map" in r.reason for r in refused)
    assert worst_m(solve("plain", start, corrupted).poses, true) > 1.0, "believed, it would bend the map"


def test_several_false_groups_are_rejected_even_if_more_numerous():
    true, start, graph = loops()
    corrupted = graph
    for k, first in enumerate([(2, 50), (8, 85), (25, 75), (31, 104)]):
        corrupted = false_room(true, corrupted, moved=(2.0 + k, 5.0 - 2 * k, 0.3 * k - 0.5), first=first)
    assert 2 * graph.is_closure.sum() < 80
    result = solve("ours", start, corrupted)
    assert not result.accepted[len(graph.edges) :].any()
    assert worst_m(result.poses, true) < 0.5


def test_the_only_closures_of_a_short_path_are_accepted():
    _, start, graph = loops(laps=2)
    kept = np.flatnonzero(~graph.is_closure | (np.cumsum(graph.is_closure) <= 3))
    result = solve("ours", start, graph.of(kept))
    assert result.rejections == ()


def test_every_rejection_names_its_edge_and_reason():
    _, start, graph = loops()
    corrupted = with_false(graph, [(3, 47)], [[0.0, 0.0, 0.0]])
    result = solve("ours", start, corrupted)
    (refusal,) = result.rejections
    assert refusal.edge == len(graph.edges)
    assert refusal.reason.startswith("contradicts the map")


@pytest.mark.parametrize("mode", MODES)
def test_every_closure_is_either_accepted_or_rejected(mode):
    true, start, graph = loops()
    result = solve(mode, start, false_room(true, graph))
    assert [r.edge for r in result.rejections] == np.flatnonzero(~result.accepted).tolist()
    assert all(r.reason for r in result.rejections)


@pytest.mark.parametrize("mode", MODES)
def test_the_result_is_deterministic(mode):
    true, start, graph = loops()
    corrupted = false_room(true, graph)
    first, second = solve(mode, start, corrupted), solve(mode, start, corrupted)
    assert first.poses.tobytes() == second.poses.tobytes()
    assert first.rejections == second.rejections


@pytest.mark.parametrize("mode", MODES)
def test_the_fixed_pose_does_not_move(mode):
    _, start, graph = loops()
    poses = robust_backend.solve(start, *graph.parts, PoseGraphConfig(robust=mode), fixed=17).poses
    assert np.array_equal(poses[17], start[17])
    assert not np.array_equal(poses[90], start[90])


@pytest.mark.parametrize("mode", ["plain", "dcs", "cauchy"])
def test_reweighting_modes_equal_those_of_the_pose_graph(mode):
    _, start, graph = loops()
    config = PoseGraphConfig(robust=mode)
    expected = pose_graph.optimise(start, *graph.parts, config)
    assert np.array_equal(robust_backend.solve(start, *graph.parts, config).poses, expected)


@pytest.mark.parametrize("mode", MODES)
def test_two_robots_joined_by_closures_become_one_map(mode):
    true, start, graph = loops()
    half = len(true) // 2
    graph = graph.of(~np.all(graph.edges == (half - 1, half), axis=1))
    start = start.copy()
    start[half:] = compose(true[half], between(start[half], start[half:]))
    assert worst_m(solve(mode, start, graph).poses, true) < 0.5


@pytest.mark.parametrize("mode", MODES)
def test_graphs_without_closures_keep_their_odometry(mode):
    _, start, graph = loops()
    result = solve(mode, start, graph.of(~graph.is_closure))
    assert result.rejections == ()
    assert np.abs(between(start, result.poses)).max() < 1e-6


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("count", [0, 1, 3])
def test_poses_without_edges_do_not_move(mode, count):
    none = np.zeros((0, 2), int), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0, bool)
    poses = np.arange(3.0 * count).reshape(count, 3) * 0.1
    result = solve(mode, poses, Graph(*none))
    assert result.poses == pytest.approx(poses, abs=1e-12)
    assert result.rejections == ()


@pytest.mark.parametrize("mode", ["plain", "ours"])
def test_arguments_are_not_modified(mode):
    true, start, graph = loops()
    arguments = [start, *false_room(true, graph).parts]
    copies = [a.copy() for a in arguments]
    robust_backend.solve(*arguments, PoseGraphConfig(robust=mode))
    assert all(np.array_equal(a, b) for a, b in zip(arguments, copies, strict=True))


@pytest.mark.parametrize(("count", "extra"), [(3, 1), (40, 30), (120, 900)])
def test_block_cholesky_equals_numpy(count, extra):
    random = np.random.default_rng(count)
    pairs = np.concatenate(
        [np.stack([np.arange(count - 1), np.arange(1, count)], 1), random.integers(0, count, (extra, 2))]
    )
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    pairs = np.concatenate([pairs, pairs[:2, ::-1], [[-1, 1]]])
    cholesky = BlockCholesky(pairs, count)
    blocks = np.zeros((cholesky.block_of_pair.max() + 1, 3, 3))
    dense = np.zeros((count, 3, count, 3))
    for (a, b), block in zip(pairs, cholesky.block_of_pair, strict=True):
        if block >= 0 and not blocks[block].any():
            blocks[block] = random.normal(0, 1, (3, 3))
            dense[max(a, b), :, min(a, b)] = blocks[block]
            dense[min(a, b), :, max(a, b)] = blocks[block].T
    diagonal = np.tile(np.eye(3) * (20.0 + 3 * extra), (count, 1, 1))
    for k in range(count):
        dense[k, :, k] = diagonal[k]
    right = random.normal(0, 1, (count, 3))
    expected = np.linalg.solve(dense.reshape(3 * count, -1), right.ravel()).reshape(count, 3)
    assert cholesky.block_of_pair[-1] == -1
    assert cholesky.solve(diagonal, blocks, right) == pytest.approx(expected, abs=1e-12)


def test_block_cholesky_reports_matrices_that_are_not_positive_definite():
    cholesky = BlockCholesky(np.array([[0, 1]]), 2)
    assert cholesky.solve(np.tile(np.eye(3), (2, 1, 1)), 2 * np.eye(3)[None], np.ones((2, 3))) is None


def three_poses() -> list:
    return [np.array([(0, 1), (1, 2)]), np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)), np.array([False, True])]


def indefinite(*values) -> list:
    return [np.diag([1.0, 1.0, 1.0]), np.array(values, float).reshape(3, 3)]


@pytest.mark.parametrize(
    ("changed", "value", "message"),
    [
        (0, [(0, 1), (1, 3)], "edges join poses 0 to 2"),
        (0, [(0, 1), (-1, 2)], "edges join poses 0 to 2"),
        (0, [(0, 1)], "as many measurements"),
        (1, np.full((2, 3), np.nan), "finite"),
        (2, np.full((2, 3, 3), np.inf), "finite"),
        (0, [(0, 1), (1, 1.5)], "edges of a graph must be whole numbers"),
        (1, np.zeros((2, 2)), r"measurements of a graph must have shape \('edges', 3\); got \(2, 2\)"),
        (2, np.zeros((2, 2, 2)), r"information of a graph must have shape \('edges', 3, 3\)"),
        (2, indefinite(1, 0, 0, 0, 1, 0, 0, 0, -1), "edge 1"),
        (2, indefinite(1, 2, 0, 2, 1, 0, 0, 0, 1), "symmetric and positive .*edge 1"),
        (2, indefinite(1, 0.5, 0, 0, 1, 0, 0, 0, 1), "symmetric and positive .*edge 1"),
        (3, np.zeros((2, 1), bool), "is_closure of a graph"),
    ],
)
@pytest.mark.parametrize("mode", MODES)
def test_invalid_graphs_are_rejected_in_one_line(mode, changed, value, message):
    graph = three_poses()
    graph[changed] = np.array(value)
    with pytest.raises(DataError, match=message) as error:
        solve(mode, np.zeros((3, 3)), Graph(*graph))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("mode", MODES)
def test_singular_information_is_accepted_or_rejected_in_one_line(mode):
    graph = three_poses()
    graph[2][1] = np.diag([1.0, 0.0, 0.0])
    if mode in ("pcm", "ours"):
        with pytest.raises(DataError, match="positive definite"):
            solve(mode, np.zeros((3, 3)), Graph(*graph))
    else:
        assert np.isfinite(solve(mode, np.zeros((3, 3)), Graph(*graph)).poses).all()


@pytest.mark.parametrize("held", [-1, 3])
@pytest.mark.parametrize("mode", MODES)
def test_fixing_a_missing_pose_is_rejected(mode, held):
    with pytest.raises(DataError, match=f"one of 0 to 2; got {held}"):
        robust_backend.solve(np.zeros((3, 3)), *three_poses(), PoseGraphConfig(robust=mode), held)


def revise(start, graph, is_used, is_thorough):
    config = PoseGraphConfig(robust="ours")
    return robust_backend.revise(start, graph, is_used, config, 0, is_thorough)


def test_a_rejected_false_closure_stays_rejected_in_a_thorough_revision():
    true, start, graph = loops()
    corrupted = with_false(graph, [(21, 70)], [(1.0, -0.7, 0.4)])
    is_used = np.append(np.ones(len(graph.edges), bool), False)
    quick, thorough = (revise(start, corrupted, is_used, each) for each in (False, True))
    assert np.array_equal(quick.accepted, is_used)
    assert np.array_equal(thorough.accepted, is_used)
    assert worst_m(thorough.poses, true) < 0.5


def test_a_map_does_not_bend_to_one_false_closure_where_odometry_is_assumed_worse_than_it_is():
    true, start, graph = loops()
    information = graph.information * np.where(graph.is_closure, 1.0, 0.02)[:, None, None]
    loose = Graph(graph.edges, graph.measured, information, graph.is_closure)
    corrupted = with_false(loose, [(21, 70)], [(2.0, -1.5, 0.3)])
    is_used = np.append(np.ones(len(graph.edges), bool), False)
    thorough = revise(start, corrupted, is_used, True)
    assert np.array_equal(thorough.accepted, is_used)
    assert worst_m(thorough.poses, true) < 0.5


def test_rejected_true_closures_are_accepted_in_a_thorough_revision():
    true, start, graph = loops(laps=2)
    chain = ~graph.is_closure
    few = graph.of(np.append(np.flatnonzero(chain), np.flatnonzero(~chain)[[2, 5]]))
    quick, thorough = (revise(start, few, np.arange(len(few.edges)) < chain.sum(), each) for each in (False, True))
    assert quick.accepted[-2:].tolist() == [False, False]
    assert thorough.accepted.all()
    assert worst_m(thorough.poses, true) < 0.5 * worst_m(quick.poses, true)


def test_a_solution_with_more_closures_is_not_taken_against_a_veto():
    _, start, graph = loops(laps=2)
    chain = ~graph.is_closure
    few = graph.of(np.append(np.flatnonzero(chain), np.flatnonzero(~chain)[[2, 5]]))
    is_used, asked = np.arange(len(few.edges)) < chain.sum(), []

    def never(before, after):
        asked.append((before.accepted.sum(), after.accepted.sum()))
        return False

    result = robust_backend.revise(start, few, is_used, PoseGraphConfig(robust="ours"), 0, True, never)
    assert np.array_equal(result.accepted, is_used)
    assert asked == [(chain.sum(), chain.sum() + 2)]


@pytest.mark.parametrize("is_thorough", [False, True])
def test_a_revision_fixes_the_given_pose(is_thorough):
    _, start, graph = loops(laps=2)
    is_used = np.append(np.ones(len(graph.edges), bool), False)
    corrupted = with_false(graph, [(6, 40)], [(1.0, -0.7, 0.4)])
    poses = robust_backend.revise(start, corrupted, is_used, PoseGraphConfig(), 20, is_thorough).poses
    assert poses[20] == pytest.approx(start[20], abs=1e-12)
    assert np.abs(poses[0] - start[0]).max() > 1e-3


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("moved", [(4e4, -3e4, 2.0), (5e5, 5e6, -1.0)])
def test_a_graph_in_map_coordinates_is_solved_as_one_at_the_origin(mode, moved):
    _, start, graph = loops()
    random = np.random.default_rng(4)
    wrong = [(3, 47), (10, 90), (21, 70), (30, 101), (44, 120)]
    corrupted = with_false(graph, wrong, random.normal(0, (1.0, 1.0, 0.3), (5, 3)))
    near, far = solve(mode, start, corrupted), solve(mode, compose(moved, start), corrupted)
    assert np.array_equal(far.accepted, near.accepted)
    assert np.array_equal(far.poses[0], compose(moved, start)[0])
    assert np.allclose(between(compose(moved, near.poses), far.poses), 0.0, atol=1e-6)
