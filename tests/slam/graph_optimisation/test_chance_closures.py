import numpy as np
import pytest

from twc_env.records.geometry import between
from twc_env.slam.graph_optimisation.chance_closures import aligned_distance_m, chance_closures
from twc_env.slam.pose_graph.solver import Graph

COUNT = 60
LAST = [10, 55]


def graph_with(error_m, rejected):
    """A walk to and fro along a corridor; closures tie its first half, and one, wrong by error_m, its dead end alone.

    Then `rejected` closures that say that places far apart are one.
    """
    steps = np.arange(COUNT)
    truth = np.column_stack([10.0 - np.abs(steps % 20 - 10.0), 0.1 * steps, np.zeros(COUNT)])
    odometry = np.column_stack([steps[:-1], steps[1:]])
    tied = np.array([[k, k + 20] for k in range(0, 20, 2)] + [LAST] + [[0, 30 + k] for k in range(rejected)])
    edges = np.concatenate([odometry, tied])
    measured = between(truth[edges[:, 0]], truth[edges[:, 1]])
    last = COUNT - 1 + 10
    measured[last, 1] += error_m
    measured[last + 1 :] = 0.0
    is_closure = np.arange(len(edges)) >= COUNT - 1
    information = np.tile(np.diag([400.0, 400.0, 1e3]), (len(edges), 1, 1))
    graph = Graph(edges, measured, information, is_closure)
    accepted = is_closure & (np.arange(len(edges)) <= last)
    return graph, graph.fit(truth, (accepted | ~is_closure).astype(float)), accepted, last


def test_a_closure_that_alone_bends_a_dead_end_is_found_among_many_rejected_ones():
    graph, poses, accepted, last = graph_with(6.0, 25)
    (found,) = chance_closures(graph, poses, accepted, 0.3)
    assert found[0] == last and found[1] > 0.3


@pytest.mark.parametrize(("error_m", "rejected"), [(0.2, 25), (6.0, 0)])
def test_closures_that_the_map_predicts_and_those_of_a_graph_without_rejected_ones_stand(error_m, rejected):
    graph, poses, accepted, _ = graph_with(error_m, rejected)
    assert chance_closures(graph, poses, accepted, 0.3) == []


def test_the_distance_after_alignment_knows_no_frame():
    random = np.random.default_rng(0)
    places, angle = random.normal(size=(20, 2)), 0.7
    turned = places @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) + 3.0
    assert aligned_distance_m(turned, places) == pytest.approx(0.0, abs=1e-6)
