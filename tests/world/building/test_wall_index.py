import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from twc_env.world.building.wall_index import index_walls


def random_walls(seed: int, count: int, size_m: float = 20.0) -> np.ndarray:
    random = np.random.default_rng(seed)
    begins = random.uniform(0, size_m, (count, 2))
    return np.stack([begins, begins + random.normal(0, 3, (count, 2))], axis=1)


@given(seed=st.integers(0, 10_000), count=st.integers(1, 200))
def test_crossings_agree_with_shapely(seed, count):
    walls = random_walls(seed, count)
    random = np.random.default_rng(seed + 1)
    losses = random.uniform(1, 9, count)
    index = index_walls(walls, losses)
    point, targets = random.uniform(-5, 25, 2), random.uniform(-5, 25, (10, 2))
    counts, summed = index.crossing(point, targets)
    for target, found, loss in zip(targets, counts, summed, strict=True):
        hit = shapely.intersects(shapely.linestrings(walls), shapely.LineString([point, target]))
        assert found == hit.sum()
        assert loss == pytest.approx(losses[hit].sum())


def test_a_line_through_the_common_end_of_two_walls_crosses_once():
    index = index_walls([[[0, -1], [0, 0]], [[0, 0], [0, 1]]], [3.0, 3.0])
    counts, losses = index.crossing(np.array([-1.0, 0.0]), np.array([[1.0, 0.0]]))
    assert counts[0] == 1
    assert losses[0] == 3.0


@given(seed=st.integers(0, 10_000), count=st.integers(1, 100), reach=st.floats(0.05, 5))
def test_distances_agree_with_shapely_up_to_the_reach(seed, count, reach):
    walls = random_walls(seed, count)
    points = np.random.default_rng(seed).uniform(-3, 23, (20, 2))
    expected = [shapely.MultiLineString(list(walls)).distance(shapely.Point(p)) for p in points]
    found = index_walls(walls, np.ones(count)).distance_m(points, reach)
    assert found == pytest.approx(np.minimum(expected, reach), abs=1e-9)
