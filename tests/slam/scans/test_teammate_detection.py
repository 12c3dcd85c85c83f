import numpy as np
import pytest

from twc_env.records.geometry import beam_directions
from twc_env.slam.scans.teammate_detection import DISCS_MAX, MEMORY, mark_teammates, unmark, without_narrow

RANGE_MAX_M, RADIUS_M = 10.0, 0.2


def marked(ranges: np.ndarray, radius_m: float = RADIUS_M) -> np.ndarray:
    out = np.empty_like(ranges)
    room = np.empty(len(ranges), bool), np.empty(len(ranges) + 1, np.int64)
    mark_teammates(
        ranges, RANGE_MAX_M, np.array([radius_m]), beam_directions(len(ranges)), *room, out, np.zeros((DISCS_MAX, 4))
    )
    return out


def disc(scan: np.ndarray, centre, radius_m: float = RADIUS_M, pose=(0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """The scan with a disc in view, and which beams hit the disc."""
    angles = pose[2] + np.arange(len(scan)) * 2 * np.pi / len(scan)
    away = np.asarray(centre, float) - pose[:2]
    along = away @ np.array([np.cos(angles), np.sin(angles)])
    inside = radius_m**2 - (away @ away - along**2)
    with np.errstate(invalid="ignore"):
        distance = np.where((inside > 0) & (along > 0), along - np.sqrt(inside), np.inf)
    return np.minimum(scan, distance), distance < scan


@pytest.fixture
def room(walls, scan):
    return scan(walls((-4, -3), (5, -3), (5, 3), (-4, 3)), (0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    "centre", [(1.5, 0.4), (2.0, 0.0), (2.0, -0.02), (-1.2, 1.0), (0.6, -0.5), (3.0, 1.5), (-3.2, -2)]
)
def test_only_the_beams_on_a_teammate_are_marked(room, centre):
    ranges, is_teammate = disc(room, centre)
    scan = marked(ranges)
    assert is_teammate.sum() >= 2
    assert np.abs(scan) == pytest.approx(ranges)
    assert np.array_equal(scan < 0, is_teammate)


def test_large_teammates_are_recognised_although_their_edges_are_steep(walls, scan):
    """Two beams near the edge of a disc of 0.6 m differ by a quarter of a metre: most of its scans fell apart."""
    hall = scan(walls((-9, -9), (9, -9), (9, 9), (-9, 9)), (0.0, 0.0, 0.0))
    random, recognised = np.random.default_rng(0), []
    for _ in range(300):
        way_m, bearing = random.uniform(1.2, 6.0), random.uniform(-np.pi, np.pi)
        ranges, is_teammate = disc(hall, way_m * np.array([np.cos(bearing), np.sin(bearing)]), 0.6)
        recognised.append((marked(ranges, 0.6)[is_teammate] < 0.0).all())
    assert np.mean(recognised) > 0.6


def test_two_teammates_are_both_marked(room):
    ranges, first = disc(room, (1.5, 0.4))
    ranges, second = disc(ranges, (-1.0, -1.2))
    assert np.array_equal(marked(ranges) < 0, first | second)


def test_an_empty_room_has_no_teammates(room, office, scan):
    assert np.all(marked(room) >= 0)
    assert np.all(marked(np.full(180, RANGE_MAX_M)) >= 0)
    assert np.all(marked(np.full(180, 1.0)) >= 0)


def test_a_pillar_of_another_size_stays_a_wall(room):
    ranges, _ = disc(room, (1.5, 0.4), radius_m=0.5)
    assert np.all(marked(ranges) >= 0)


def test_a_square_pillar_stays_a_wall(walls, scan):
    both = np.concatenate(
        [walls((-4, -3), (5, -3), (5, 3), (-4, 3)), walls((0.8, -0.35), (1.5, -0.35), (1.5, 0.35), (0.8, 0.35))]
    )
    assert np.all(marked(scan(both, (0.0, 0.0, 0.0))) >= 0)


def test_with_a_radius_of_zero_nothing_is_marked(room):
    ranges, _ = disc(room, (1.5, 0.4))
    assert np.array_equal(marked(ranges, 0.0), ranges)


def test_marking_does_not_modify_the_scan(room):
    ranges, _ = disc(room, (1.5, 0.4))
    before = ranges.copy()
    marked(ranges)
    assert np.array_equal(ranges, before)


def test_a_stationary_disc_becomes_a_wall_again_and_a_moving_one_does_not():
    def seen_again(shift_m):
        seen, following = np.full((MEMORY, 4), np.inf), 0
        for k in range(4):
            disc = np.array([[3.0 - 0.6 * k + shift_m * k, 0.0, 178.0, 5.0]])
            scan = np.full(180, -1.0)
            pose, travel_m, time_s = np.array([0.6 * k, 0.0, 0.0]), 0.8 * k, 2.0 * k
            following = unmark(scan, disc, pose, seen, following, travel_m, time_s)
        return np.flatnonzero(scan > 0)

    assert seen_again(0.0).tolist() == [0, 1, 2, 178, 179]
    assert seen_again(0.5).tolist() == []


@pytest.mark.parametrize("centre", [(1.5, 0.4), (0.45, 0.1), (-0.6, -0.5), (3.0, 1.5), (1.5, 0.0)])
@pytest.mark.parametrize("far_m", [3.5, np.inf])
def test_objects_as_narrow_as_a_teammate_are_ignored(room, centre, far_m):
    ranges, is_teammate = disc(np.where(room > 3.5, far_m, room), centre)
    ranges[is_teammate] += np.random.default_rng(0).normal(0, 0.02, is_teammate.sum())
    scan = without_narrow(ranges, 2 * RADIUS_M + 0.1)
    assert np.array_equal(scan < 0, is_teammate)
    assert not (without_narrow(ranges, 0.5 * RADIUS_M) < 0).any()


def test_walls_and_the_ends_of_corridors_are_not_narrow(room, walls, scan):
    end = scan(walls((-40, -0.6), (5, -0.6), (5, 0.6), (-40, 0.6)), (0.0, 0.0, 0.0))
    for ranges in (room, end):
        assert np.array_equal(without_narrow(ranges, 2 * RADIUS_M + 0.1), ranges)
