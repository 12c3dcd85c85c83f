"""Removal of nodes from a pose graph."""

import numpy as np
import pytest

from twc_env.records.geometry import between, compose, poses_along
from twc_env.slam.pose_graph import solver as pose_graph
from twc_env.slam.pose_graph.graph_arrays import ODOMETRY
from twc_env.slam.pose_graph.graph_sparsification import Edges, sparsified


def chain(motions, std):
    """Odometry edges of these motions (k, 3), and the resulting poses."""
    information = np.repeat(np.diag(1 / np.square(std))[None], len(motions), axis=0)
    ends = np.array([(k, k + 1) for k in range(len(motions))])
    edges = Edges(ends, motions, information, np.full(len(motions), ODOMETRY), np.ones(len(motions), bool))
    return edges, poses_along(motions)


def with_closures(edges, closures, std):
    ends = np.array([ends for ends, _ in closures])
    information = np.repeat(np.diag(1 / np.square(std))[None], len(closures), axis=0)
    parts = (
        ends,
        np.array([z for _, z in closures]),
        information,
        np.arange(len(closures)),
        np.ones(len(closures), bool),
    )
    return Edges(*(np.concatenate(pair) for pair in zip(edges.parts, parts, strict=True)))


def fitted(edges, poses):
    graph = pose_graph.Graph(edges.ends, edges.measured, edges.information, edges.closure != ODOMETRY)
    return graph.fit(poses, np.ones(len(edges.ends)))


def without(count, *nodes):
    is_gone = np.zeros(count, bool)
    is_gone[list(nodes)] = True
    return is_gone


def test_odometry_across_removed_nodes_composes_motions_and_covariances():
    random = np.random.default_rng(0)
    motions = random.normal((0.7, 0.0, 0.2), (0.1, 0.1, 0.3), (6, 3))
    edges, poses = chain(motions, (0.02, 0.02, 0.01))
    left = sparsified(edges, without(7, 1, 2, 4, 5))
    assert left.ends.tolist() == [[0, 3], [3, 6]]
    assert left.measured == pytest.approx(between(poses[[0, 3]], poses[[3, 6]]))
    many = np.zeros((20000, 3))
    for motion in motions[:3]:
        many = compose(many, compose(motion, random.normal(0, (0.02, 0.02, 0.01), (20000, 3))))
    spread = np.cov(between(left.measured[0], many).T)
    assert np.linalg.inv(left.information[0]) == pytest.approx(spread, abs=4e-5)


def test_transferred_closures_keep_the_optimum_of_the_other_nodes():
    random = np.random.default_rng(1)
    motions = random.normal((0.7, 0.0, 0.2), (0.02, 0.02, 0.01), (8, 3))
    edges, poses = chain(motions, (0.02, 0.02, 0.01))
    met = compose(between(poses[0], poses[5]), (0.1, -0.05, 0.03))
    whole = with_closures(edges, [((0, 5), met)], (0.01, 0.01, 0.005))
    best = fitted(whole, poses)
    for gone in ((5,), (4, 5), (5, 6), (1, 2, 5)):
        left = sparsified(whole, without(9, *gone))
        handed = left.of(left.closure >= 0)
        assert handed.closure.tolist() == [0] and not np.isin(left.ends, gone).any()
        kept = [k for k in range(9) if k not in gone]
        assert np.abs(fitted(left, poses) - best)[kept, :2].max() < 0.03 < np.abs(poses - best)[kept, :2].max()


def test_nodes_with_enough_closures_take_no_transferred_ones():
    edges, poses = chain(np.tile((0.7, 0.0, 0.0), (20, 1)), (0.02, 0.02, 0.01))
    pairs = [(0, 10), (1, 10), (2, 10), (5, 14), (5, 16), (5, 18), (5, 11)]
    for first, left in ((0, range(6)), (1, range(6))):  # without the first closure, node 10 has two
        graph = with_closures(
            edges, [(pair, between(*poses[list(pair)])) for pair in pairs[first:]], (0.01, 0.01, 0.005)
        )
        assert sparsified(graph, without(21)).closure.tolist() == graph.closure.tolist()
        thin = sparsified(graph, without(21, 11))
        assert sorted(thin.closure[thin.closure >= 0].tolist()) == list(left)


def test_closures_between_the_same_nodes_are_fused():
    edges, poses = chain(np.tile((0.7, 0.0, 0.0), (20, 1)), (0.001, 0.001, 0.001))
    first, second = between(poses[0], poses[10]), between(poses[11], poses[0])
    graph = with_closures(edges, [((0, 10), compose(first, (0.1, 0.0, 0.0))), ((11, 0), second)], (0.1, 0.1, 0.05))
    left = sparsified(graph, without(21, 11))
    assert left.closure[left.closure >= 0].tolist() == [0]
    tie = left.of(left.closure >= 0)
    assert tie.measured[0] == pytest.approx(compose(first, (0.05, 0.0, 0.0)), abs=1e-3)
    assert np.linalg.inv(tie.information[0])[2, 2] < 0.51 * 0.05**2


def test_an_uninformative_closure_is_not_transferred():
    motions = np.tile((0.7, 0.0, 0.0), (8, 1))
    edges, poses = chain(motions, (2.0, 2.0, 0.01))
    graph = with_closures(edges, [((0, 4), between(poses[0], poses[4]))], (0.01, 0.01, 0.005))
    assert sparsified(graph, without(9, 3, 4, 5)).closure.max() == ODOMETRY
