"""Repeated evaluation of maps with more keyframes than are used."""

import numpy as np
import pytest

from twc_env.exploration.assessment.map_evaluation import KEYFRAMES_MAX, MapEvaluators, lay
from twc_env.maps import load_map
from twc_env.records.geometry import compose
from twc_env.records.messages import GridMap


@pytest.fixture(scope="module")
def cells():
    return load_map("twin-01").cells()


def evaluator_arguments(count, robots=3, seed=0, apart_m=0.0):
    """Arguments of `MapEvaluators.evaluate` for a map of so many keyframes; apart_m: error of the last robot's
    frame."""
    random = np.random.default_rng(seed)
    robot_of, steps = random.integers(0, robots, count), np.sort(random.integers(0, 900, count))
    truth = random.normal(0.0, 5.0, (900, robots, 3))
    poses = compose([1.0, 2.0, 0.5], truth[steps, robot_of]) + random.normal(0.0, 0.01, (count, 3))
    poses[robot_of == robots - 1, 0] += apart_m
    is_own = robot_of == np.arange(robots)[:, None]
    nodes = poses, steps, np.argsort(~is_own, axis=1, kind="stable"), is_own.sum(axis=1)
    log_odds = random.integers(-20, 20, (160, 192)).astype(np.int16)
    grid = GridMap(log_odds, np.array([-4.0, -4.0]), 0.1, touched=np.ones((10, 3), np.int64))
    return tuple(range(robots)), nodes, truth, grid


@pytest.mark.parametrize("count", [500, KEYFRAMES_MAX, KEYFRAMES_MAX + 1, 2 * KEYFRAMES_MAX + 1, 3 * KEYFRAMES_MAX])
@pytest.mark.parametrize("apart_m", [0.0, 5.0])
def test_a_copy_evaluates_a_map_as_the_original_does(cells, count, apart_m):
    evaluators, arguments = MapEvaluators(), evaluator_arguments(count, apart_m=apart_m)
    first, again = (evaluators.evaluate(*arguments, cells) for _ in range(2))
    assert first == again
    assert len(first[1]) == (2 if apart_m else 0)


@pytest.mark.parametrize("apart_m", [0.0, 5.0])
def test_the_memory_of_judging_is_bounded(cells, apart_m):
    evaluators, rows = MapEvaluators(), []
    for count in (KEYFRAMES_MAX // 2, KEYFRAMES_MAX, 3 * KEYFRAMES_MAX, 20 * KEYFRAMES_MAX):
        arguments = evaluator_arguments(count, apart_m=apart_m)
        for _ in range(2):
            evaluators.evaluate(*arguments, cells)
        rows.append(max(map(len, evaluators._room)))
    assert max(rows) == KEYFRAMES_MAX + 3


def test_nothing_is_kept_of_a_map_that_is_gone(cells):
    evaluators, (robots, nodes, truth, grid) = MapEvaluators(), evaluator_arguments(500)
    evaluators.evaluate(robots, nodes, truth, grid, cells)
    assert len(evaluators._held) == 1
    del grid
    assert len(evaluators._held) == 0


def test_a_subset_of_many_keyframes_gives_nearly_the_alignment_of_all(cells):
    robots, nodes, truth, grid = evaluator_arguments(5 * KEYFRAMES_MAX)
    pose, _, _ = MapEvaluators().evaluate(robots, nodes, truth, grid, cells)
    assert pose == pytest.approx(lay(robots, nodes, truth)[0], abs=0.01)
