import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from twc_env.maps import load_map
from twc_env.world.building import crossing_table
from twc_env.world.building.crossing_table import CrossingTable, crossed_at
from twc_env.world.building.wall_index import index_walls


def crossed(table, place, count, bands=1):
    counts, losses = np.empty(count, np.int64), np.empty((bands, count))
    table.crossed(*place, counts, losses)
    return counts, losses


@given(seed=st.integers(0, 10_000), walls=st.integers(1, 80), on_grid=st.booleans())
@example(seed=4864, walls=4, on_grid=True)  # a line of sight along the border of two buckets
def test_the_table_counts_what_the_wall_index_counts(seed, walls, on_grid):
    random = np.random.default_rng(seed)
    begins = random.uniform(-3, 12, (walls, 2))
    ends = begins + random.normal(0, 3, (walls, 2))
    points, places = random.uniform(-4, 13, (6, 2)), random.uniform(-4, 13, (25, 2))
    if on_grid:  # walls that continue each other, places on the lines of walls and on the borders of squares
        begins, ends, points, places = (np.round(2 * values) / 2 for values in (begins, ends, points, places))
        ends[(begins == ends).all(axis=1), 0] += 1.0
    loss_db = random.uniform(1, 9, walls)
    index = index_walls(np.stack([begins, ends], axis=1), loss_db)
    table = CrossingTable(index, points, loss_db[None])
    for place in places:
        counts, losses = crossed(table, place, len(points))
        expected, summed = index.crossing(place, points)
        if not on_grid:
            assert counts.tolist() == expected.tolist()
            assert losses[0] == pytest.approx(summed)
        assert counts.tolist() == plain_count(begins, ends, place, points)


def plain_count(begins, ends, place, points) -> list[int]:
    """All walls against all lines; the common end of two walls counts once."""
    found = []
    for q in points:
        d, a, b = q - place, begins - place, ends - place
        sides = [d[0] * v[:, 1] - d[1] * v[:, 0] >= 0 for v in (a, b)]
        e = ends - begins
        own = [e[:, 0] * (v - begins)[:, 1] - e[:, 1] * (v - begins)[:, 0] >= 0 for v in (place, q)]
        found.append(int(((sides[0] != sides[1]) & (own[0] != own[1])).sum()))
    return found


@pytest.mark.parametrize("tests_max", [crossing_table._TESTS_MAX, 0])
def test_all_bands_and_all_of_a_building_agree_with_the_wall_index(tests_max, monkeypatch):
    monkeypatch.setattr(crossing_table, "_TESTS_MAX", tests_max)
    plan = load_map("twin-02")
    points = np.array([a.position_m for a in plan.access_points])
    table = CrossingTable(plan.wall_index, points, np.stack([plan.wall_loss_db, 2.5 * plan.wall_loss_db]))
    low, high = plan.bounds_m[:2], plan.bounds_m[2:]
    for place in np.random.default_rng(0).uniform(low, high, (400, 2)):
        counts, losses = crossed(table, place, len(points), 2)
        expected, summed = plan.wall_index.crossing(place, points)
        assert counts.tolist() == expected.tolist()
        assert losses == pytest.approx(np.stack([summed, 2.5 * summed]))


def test_a_square_is_identical_whatever_was_cached_before(monkeypatch):
    plan = load_map("twin-01")
    points = np.array([a.position_m for a in plan.access_points])
    places = np.random.default_rng(1).uniform(plan.bounds_m[:2], plan.bounds_m[2:], (60, 2))
    kept = CrossingTable(plan.wall_index, points, plan.wall_loss_db[None])
    first = [crossed(kept, place, len(points))[1].tobytes() for place in places]
    monkeypatch.setattr(crossing_table, "_ENTRIES_MAX", 3 * len(points))
    small = CrossingTable(plan.wall_index, points, plan.wall_loss_db[None])
    for k in np.random.default_rng(2).permutation(60):
        assert crossed(small, places[k], len(points))[1].tobytes() == first[k]
        assert np.count_nonzero(small.arrays[3] >= 0) <= 3


def test_arrays_from_before_an_enlargement_are_not_read_beyond_their_end():
    plan = load_map("twin-01")
    points = np.array([a.position_m for a in plan.access_points])
    table = CrossingTable(plan.wall_index, points, plan.wall_loss_db[None])
    old, place = table.arrays, np.array([15.0, 1.2])
    for x in np.arange(3.0, 16.0, 0.5):
        table.prepare(x, 1.2)
    counts, losses = np.empty(len(points), np.int64), np.empty((1, len(points)))
    crossed_at(*place, *plan.wall_index.buckets(), *old, counts, losses)
    assert counts.tolist() == plan.wall_index.crossing(place, points)[0].tolist()
