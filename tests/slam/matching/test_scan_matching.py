import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twc_env.errors import ConfigError, DataError
from twc_env.records.geometry import between, transform_points
from twc_env.slam.matching.line_matching import weakest_direction
from twc_env.slam.matching.scan_matching import LineField, scan_points

RANGE_MAX_M = 10.0


def field_of(walls, scan, *poses, size_m: float = 26.0):
    field = LineField(size_m, 0.1, RANGE_MAX_M)
    poses = np.array(poses, float)
    field.add(poses, np.array([scan(walls, pose) for pose in poses]))
    return field


def points_at(walls, scan, pose):
    return scan_points(scan(walls, pose), RANGE_MAX_M)


def refine(field, points, guess, iterations=20, distance_m=0.5, share=0.04):
    return field.refine(points, np.asarray(guess, float), distance_m, iterations, share)


@pytest.fixture(scope="module")
def corridor(walls):
    return walls((-40, -1.2), (40, -1.2), (40, 1.2), (-40, 1.2))


def test_scan_points_are_the_beam_ends_without_beams_that_had_no_return():
    ranges = np.array([2.0, RANGE_MAX_M, 3.0, 1.0])
    assert scan_points(ranges, RANGE_MAX_M) == pytest.approx(np.array([[2, 0], [-3, 0], [0, -1]]), abs=1e-12)
    assert scan_points(np.full(8, RANGE_MAX_M), RANGE_MAX_M).shape == (0, 2)


def test_scan_points_lie_on_the_walls(office, scan):
    pose = np.array([0.5, 0.6, 0.7])
    points = transform_points(pose, points_at(office, scan, pose))
    a, b = office[:, 0], office[:, 1]
    along = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
    offsets = points[:, None] - a
    across = np.abs(offsets[..., 0] * along[:, 1] - offsets[..., 1] * along[:, 0])
    assert across.min(axis=1).max() < 1e-9


@settings(max_examples=40)
@given(st.integers(0, 10_000))
def test_refinement_recovers_a_known_offset_to_half_a_centimetre(office, scan, seed):
    random = np.random.default_rng(seed)
    true = np.array([*random.uniform((-1.5, -0.3), (0.5, 0.8)), random.uniform(-3, 3)])
    field = field_of(office, scan, (0.0, 0.5, 0.0), (-1.0, 0.0, 1.0), (-1.5, -1.0, 2.0), (2.5, 1.5, 3.0))
    guess = true + random.uniform(-1, 1, 3) * (0.15, 0.15, 0.08)
    match = refine(field, points_at(office, scan, true), guess)
    assert np.abs(between(true, match.pose)) == pytest.approx(np.zeros(3), abs=0.005)
    assert not match.is_degenerate


def test_refinement_from_the_true_pose_stays_there(office, scan):
    pose = np.array([0.4, -0.4, 0.3])
    match = refine(field_of(office, scan, pose), points_at(office, scan, pose), pose)
    assert match.pose == pytest.approx(pose, abs=1.5e-3)  # a piece of wall may bend by 2 cm at a corner


def test_nothing_is_matched_where_there_are_no_walls(office, scan):
    field = LineField(20.0, 0.1, RANGE_MAX_M)
    guess = np.array([0.1, 0.2, 0.3])
    match = refine(field, points_at(office, scan, np.zeros(3)), guess)
    assert match.weight < 5
    assert match.pose == pytest.approx(guess)
    assert refine(field, np.zeros((0, 2)), guess).weight < 5


@pytest.mark.parametrize("heading", [0.0, 0.6, -2.5])
def test_a_corridor_match_keeps_the_odometry_along_the_axis(corridor, scan, heading):
    field = field_of(corridor, scan, (0.0, 0.1, 0.0), (1.0, -0.2, 0.5), (2.0, 0.0, 0.0))
    true, guess = np.array([1.0, 0.1, heading]), np.array([1.3, 0.0, heading + 0.05])
    match = refine(field, points_at(corridor, scan, true), guess)
    assert match.is_degenerate
    assert abs(weakest_direction(match.sums)[0]) == pytest.approx(1.0, abs=1e-3)
    assert match.pose[0] == pytest.approx(guess[0], abs=2e-3)
    assert match.pose[1:] == pytest.approx(true[1:], abs=5e-3)


def test_a_corridor_match_carries_no_information_along_the_axis(corridor, scan):
    field = field_of(corridor, scan, (0.0, 0.1, 0.0))
    match = refine(field, points_at(corridor, scan, np.zeros(3)), np.array([0.2, 0.05, 0.02]))
    information = match.information(0.04, 8.0)
    assert abs(information[0]).max() < 1e-3 * information[1, 1]
    assert information[1, 1] > 100
    assert information[2, 2] > 100


def test_two_beams_on_a_pillar_do_not_constrain_the_axis(corridor, walls, scan):
    pillar = walls((2.0, -1.2), (2.2, -1.2), (2.2, -0.9), (2.0, -0.9))
    both = np.concatenate([corridor, pillar])
    field = field_of(both, scan, np.zeros(3))
    match = refine(field, points_at(both, scan, np.zeros(3)), np.array([0.2, 0.05, 0.02]))
    axis, information = np.array(weakest_direction(match.sums)), match.information(0.04, 8.0)
    assert match.is_degenerate
    assert match.sums[0] > 0.5, "the pillar was not seen at all"
    assert abs(axis @ (match.pose[:2] - [0.2, 0.05])) < 2e-3
    assert abs(information @ [*axis, 0.0]).max() < 1e-6 * information[1, 1]
    fixed = refine(field, points_at(both, scan, np.zeros(3)), np.array([0.2, 0.05, 0.02]), share=0.0)
    assert not fixed.is_degenerate
    assert abs(fixed.pose[0]) < 0.05


def test_the_free_direction_rotates_with_the_corridor(corridor, scan):
    angle = 0.7
    c, s = math.cos(angle), math.sin(angle)
    turned = corridor @ np.array([[c, s], [-s, c]])
    match = refine(field_of(turned, scan, np.zeros(3)), points_at(turned, scan, np.zeros(3)), np.zeros(3))
    assert match.is_degenerate
    assert abs(np.dot(weakest_direction(match.sums), [c, s])) == pytest.approx(1.0, abs=1e-3)


def test_a_room_constrains_all_three_directions(office, scan):
    match = refine(field_of(office, scan, np.zeros(3)), points_at(office, scan, np.zeros(3)), np.zeros(3))
    information = match.information(0.04, 8.0)
    assert np.allclose(information, information.T)
    assert np.linalg.eigvalsh(information).min() > 100


def test_information_falls_with_noise_and_correlation(office, scan):
    match = refine(field_of(office, scan, np.zeros(3)), points_at(office, scan, np.zeros(3)), np.zeros(3))
    base = match.information(0.04, 8.0)
    assert match.information(0.08, 8.0) == pytest.approx(base / 4)
    assert match.information(0.04, 16.0) == pytest.approx(base / 2)


@pytest.mark.parametrize("offset", [(1.4, -1.1, 0.45), (-1.5, 0.9, -0.5), (0.0, 1.45, 0.45)])
def test_the_search_finds_an_offset_too_large_for_refinement(office, scan, offset):
    true = np.array([-0.5, 0.2, 0.4])
    field = field_of(office, scan, (0.0, 0.5, 0.0), (-1.5, -1.0, 2.0), (2.5, 1.5, 3.0))
    points = points_at(office, scan, true)
    guess = true + offset
    assert np.hypot(*between(true, refine(field, points, guess).pose)[:2]) > 0.1
    coarse, score = field.correlate(points, guess, (1.6, 0.6), (0.1, 0.05))
    error = np.abs(between(true, coarse))
    assert error[:2].max() <= 0.1
    assert error[2] <= 0.05
    assert 0.6 < score <= 1.0
    assert refine(field, points, coarse).pose == pytest.approx(true, abs=5e-3)


def test_a_subset_of_the_points_is_enough_for_the_search(office, scan):
    true = np.array([-0.5, 0.2, 0.4])
    field, points = field_of(office, scan, (0.0, 0.5, 0.0), (-1.5, -1.0, 2.0)), points_at(office, scan, true)
    every, _ = field.correlate(points, true + 0.3, (0.6, 0.4), (0.1, 0.05))
    fourth, _ = field.correlate(points, true + 0.3, (0.6, 0.4), (0.1, 0.05), stride=4)
    assert np.abs(between(every, fourth)).max() < 0.11


def test_the_share_near_walls_is_one_in_place_and_falls_away_from_it(office, scan):
    pose = np.array([-0.5, 0.2, 0.4])
    field, points = field_of(office, scan, pose), points_at(office, scan, pose)
    assert field.share_near(points, pose, 0.15) > 0.97
    assert field.share_near(points, pose + [0.4, 0.4, 0.3], 0.15) < 0.5
    assert field.share_near(points, pose + [500.0, 0.0, 0.0], 0.15) == 0.0
    assert field.share_near(np.zeros((0, 2)), pose, 0.15) == 0.0


def test_the_facing_of_a_wall_points_to_the_observer(walls, scan):
    room = walls((-3, -2), (3, -2), (3, 2), (-3, 2))
    field = field_of(room, scan, np.zeros(3))
    seen_from = np.array([0.3, 0.2])
    for position, facing in [((3, 0), math.pi), ((-3, 0), 0.0), ((0, 2), -math.pi / 2), ((0, -2), math.pi / 2)]:
        for found in (field.facing_at(position, seen_from), field.facing_around(position, seen_from)):
            assert abs(math.remainder(found - facing, 2 * math.pi)) < 0.02
    for nowhere in (np.zeros(2), np.array([400.0, -400.0])):
        assert math.isnan(field.facing_at(nowhere, seen_from)) and math.isnan(field.facing_around(nowhere, seen_from))


def test_a_short_askew_piece_of_wall_does_not_turn_the_facing_of_the_walls_around(walls, scan):
    frame = (0.4, -2), (0.4, -1.9), (0.5, -1.9), (0.5, -2)
    room, random, askew = walls((-3, -2), *frame, (3, -2), (3, 2), (-3, 2)), np.random.default_rng(0), []
    for _ in range(60):
        field, pose = LineField(26.0, 0.1, RANGE_MAX_M), np.array([random.uniform(-2, 2), random.uniform(-1, 1), 0.0])
        ranges_m = scan(room, pose)
        field.add(pose[None], (ranges_m + random.normal(0.0, 0.01, len(ranges_m)))[None])
        for x in (-2.7, -1.0, 0.25, 0.65, 2.7):
            found = field.facing_at((x, -2.0), pose[:2]), field.facing_around((x, -2.0), pose[:2])
            askew.append(np.abs(np.array(found) - math.pi / 2) > 0.2)
    alone, around = np.mean(askew, axis=0)
    assert around < alone / 2 and alone > 0.05


def test_moving_the_field_clears_the_walls_and_matches_at_the_new_position(office, scan):
    field = field_of(office, scan, np.zeros(3))
    shift = np.array([300.0, -200.0])
    field.reset(shift)
    pose = np.array([*shift, 0.0])
    points = points_at(office, scan, np.zeros(3))
    assert field.share_near(points, pose, 0.15) == 0.0
    field.add(pose[None], scan(office, np.zeros(3))[None])
    match = refine(field, points, pose + [0.1, -0.1, 0.05])
    assert match.pose == pytest.approx(pose, abs=5e-3)


ROOM_M = 3.0 / np.maximum(*np.abs([np.cos(np.arange(60) * np.pi / 30), np.sin(np.arange(60) * np.pi / 30)]))


def room_field():
    field = LineField(24.0, 0.1, RANGE_MAX_M)
    field.add(np.zeros((1, 3)), ROOM_M[None])
    return field


@pytest.mark.parametrize(
    ("poses", "scans"),
    [
        (np.zeros((2, 3)), ROOM_M[None]),
        (np.zeros((1, 2)), ROOM_M[None]),
        (np.zeros((1, 3)), np.stack([ROOM_M, ROOM_M])),
        (np.zeros(3), ROOM_M),
        (np.zeros((1, 3)), np.zeros((1, 0))),
    ],
)
def test_scans_and_poses_of_unequal_number_are_rejected(poses, scans):
    with pytest.raises(DataError, match="one pose"):
        LineField(24.0, 0.1, RANGE_MAX_M).add(poses, scans)


def calls_of(field, points, guess):
    """Functions that take points and a pose from users."""
    return (
        lambda: field.refine(points, guess, 0.5, 20, 0.04),
        lambda: field.correlate(points, guess, (0.5, 0.3), (0.1, 0.05)),
        lambda: field.share_near(points, guess, 0.1),
    )


NO_POINTS = [np.zeros((5, 1)), np.zeros((5, 3)), np.zeros(10), np.full((5, 2), np.nan), "here"]
NO_POSES = [np.zeros(2), np.full(3, np.nan), np.zeros((1, 3)), "here"]


@pytest.mark.parametrize(
    ("points", "guess", "message"),
    [(points, np.zeros(3), "points must") for points in NO_POINTS]
    + [(scan_points(ROOM_M, RANGE_MAX_M), guess, "must be a finite pose") for guess in NO_POSES],
)
def test_invalid_points_and_poses_are_rejected(points, guess, message):
    for call in calls_of(room_field(), points, guess):
        with pytest.raises(DataError, match=message):
            call()


def test_a_search_without_steps_is_rejected():
    with pytest.raises(DataError, match="steps above 0"):
        room_field().correlate(np.ones((4, 2)), np.zeros(3), (0.5, 0.3), (0.0, 0.05))


@pytest.mark.parametrize(
    "sizes", [(0, 0.1, 10), (24, 0, 10), (24, -0.1, 10), (math.nan, 0.1, 10), (24, 0.1, -1), (1e6, 0.1, 10)]
)
def test_invalid_field_sizes_are_rejected(sizes):
    with pytest.raises(ConfigError, match="a field needs"):
        LineField(*sizes)


def test_lists_are_accepted():
    field, points = LineField(24.0, 0.1, RANGE_MAX_M), scan_points(ROOM_M.tolist(), RANGE_MAX_M)
    guess = [0.05, 0.02, 0.01]
    field.add([[0.0, 0.0, 0.0]], [ROOM_M.tolist()])
    match = field.refine(points.tolist(), guess, 0.5, 20, 0.04)
    same = room_field().refine(points, np.array(guess), 0.5, 20, 0.04)
    assert match.pose.tobytes() == same.pose.tobytes() and field.share_near(points.tolist(), [0, 0, 0], 0.1) == 1.0
    assert scan_points([], RANGE_MAX_M).shape == (0, 2)
    with pytest.raises(DataError, match="ranges_m must have shape"):
        scan_points(ROOM_M[None], RANGE_MAX_M)
