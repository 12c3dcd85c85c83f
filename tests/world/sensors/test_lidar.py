import dataclasses

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from twc_env.config import LidarConfig
from twc_env.maps import load_map
from twc_env.world.building.wall_index import index_walls
from twc_env.world.sensors.lidar import Lidar, glass_walls

SQUARE = np.array([[[0, 0], [4, 0]], [[4, 0], [4, 4]], [[4, 4], [0, 4]], [[0, 4], [0, 0]]], float)
FAR_SQUARE = SQUARE + 100.0


EXACT = {"range_noise_std_m": 0.0}


def scanner(walls=SQUARE, robots=1, seed=0, radius_m=0.2, **config) -> Lidar:
    """A scanner, by default without noise."""
    config = LidarConfig(**{**EXACT, **config})
    return Lidar(config, index_walls(walls, np.ones(len(walls))), radius_m, robots, seed)


def square_range(x: float, y: float, angle_rad: float) -> float:
    dx, dy = np.cos(angle_rad), np.sin(angle_rad)
    along_x = ((4 if dx > 0 else 0) - x) / dx if abs(dx) > 1e-12 else np.inf
    along_y = ((4 if dy > 0 else 0) - y) / dy if abs(dy) > 1e-12 else np.inf
    return min(along_x, along_y)


@pytest.mark.parametrize("pose", [(2.0, 2.0, 0.0), (0.7, 3.1, 1.1), (3.9, 0.1, -3.0)])
def test_ranges_in_a_square_room_have_their_closed_form(pose):
    beams = 180
    ranges = scanner(beam_count=beams).scan(np.array([pose]))[0]
    expected = [square_range(pose[0], pose[1], pose[2] + 2 * np.pi * b / beams) for b in range(beams)]
    assert ranges == pytest.approx(np.array(expected), abs=1e-9)


@given(seed=st.integers(0, 10_000), count=st.integers(1, 120))
def test_ranges_agree_with_shapely_on_random_walls(seed, count):
    random = np.random.default_rng(seed)
    begins = random.uniform(0, 15, (count, 2))
    walls = np.stack([begins, begins + random.normal(0, 2, (count, 2))], axis=1)
    walls = np.concatenate([walls, 5.0 * SQUARE - 2.5])
    pose = np.array([*random.uniform(0, 15, 2), random.uniform(-3, 3)])
    config, lines = LidarConfig(beam_count=32, range_max_m=12.0, **EXACT), shapely.MultiLineString(list(walls))
    angles = pose[2] + 2 * np.pi * np.arange(32) / 32
    here = shapely.Point(pose[:2])
    expected = []
    for angle in angles:
        tip = pose[:2] + 12.0 * np.array([np.cos(angle), np.sin(angle)])
        hits = lines.intersection(shapely.LineString([pose[:2], tip]))
        expected.append(12.0 if hits.is_empty else min(12.0, here.distance(hits)))
    index = index_walls(walls, np.ones(len(walls)))
    found = Lidar(config, index, 0.2, 1, 0).scan(pose[None])[0]
    assert found == pytest.approx(np.array(expected), abs=1e-7)


def nearest_hit(walls_m, pose, angle_rad: float, far_m: float = 12.0) -> float:
    """Range of one beam over all walls, by solving position + r direction = begin + t extent."""
    extents, away = walls_m[:, 1] - walls_m[:, 0], walls_m[:, 0] - pose[:2]
    dx, dy = np.cos(angle_rad), np.sin(angle_rad)
    closing = dx * extents[:, 1] - dy * extents[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (away[:, 0] * dy - away[:, 1] * dx) / closing
        distance = (away[:, 0] * extents[:, 1] - away[:, 1] * extents[:, 0]) / closing
    hits = distance[(along >= -1e-9) & (along <= 1 + 1e-9) & (distance >= 0)]
    return min(far_m, hits.min(initial=far_m))


@given(seed=st.integers(0, 10_000), count=st.integers(1, 60), on_grid=st.booleans())
def test_scans_along_a_path_equal_those_with_all_walls(seed, count, on_grid):
    random, beams = np.random.default_rng(seed), 45
    begins, extents = random.uniform(0, 12, (count, 2)), random.normal(0, 3, (count, 2))
    if on_grid:  # walls that end on each other or lie in one line
        begins, extents = np.round(begins), np.round(extents) * np.eye(2)[random.integers(0, 2, count)]
        extents[~extents.any(axis=1)] = 1.0
    walls = np.stack([begins, begins + extents], axis=1)
    config = LidarConfig(beam_count=beams, range_noise_std_m=0.0)
    index, place = index_walls(walls, np.ones(count)), random.uniform(0, 12, 2)
    scan = Lidar(config, index, 0.2, 1, 0).scan
    for _ in range(12):
        pose = np.array([*place, random.uniform(-3, 3)])
        assert np.array_equal(scan(pose[None]), Lidar(config, index, 0.2, 1, 0).scan(pose[None]))
        expected = [nearest_hit(walls, pose, pose[2] + 2 * np.pi * b / beams, 10.0) for b in range(beams)]
        assert scan(pose[None])[0] == pytest.approx(np.array(expected), abs=1e-6)
        place = place + random.uniform(-0.3, 0.3, 2)


@pytest.mark.parametrize("y", [0.0, 1e-18, -1e-18, 1e-13, -1e-13])
def test_a_wall_seen_exactly_edge_on_affects_no_other_beam(y):
    edge_on = np.array([[[-3.0, y], [-1.0, -y]], [[1.0, -y], [2.0, y]]])
    for walls in (edge_on, edge_on[:, ::-1]):
        ranges = scanner(walls, beam_count=180).scan(np.zeros((1, 3)))[0]
        assert (ranges[1:90] == 10.0).all() and (ranges[91:] == 10.0).all()


def test_beams_without_return_read_exactly_the_maximum_range():
    ranges = scanner(FAR_SQUARE, range_max_m=7.5, range_noise_std_m=0.1).scan(np.zeros((1, 3)))
    assert (ranges == 7.5).all()


def test_another_robot_is_seen_as_a_disc():
    poses = np.array([[1.0, 2.0, 0.0], [3.0, 2.0, 0.0]])
    ranges = scanner(robots=2, beam_count=360, radius_m=0.25).scan(poses)
    assert ranges[0, 0] == pytest.approx(1.75)
    assert ranges[1, 180] == pytest.approx(1.75)
    half_width_rad = np.arcsin(0.25 / 2)
    seen = np.flatnonzero(ranges[0] < 2.0)
    seen = seen[(seen < 45) | (seen > 315)]
    assert len(seen) == 2 * int(np.degrees(half_width_rad)) + 1


def test_range_noise_has_the_configured_spread_and_stays_in_range():
    device = scanner(range_noise_std_m=0.05, range_max_m=2.5, beam_count=360)
    pose = np.array([[2.0, 2.0, 0.0]])
    exact = scanner(range_max_m=2.5, beam_count=360).scan(pose)[0]
    scans = np.array([device.scan(pose)[0] for _ in range(300)])
    inner = exact < 2.2
    errors = (scans - exact)[:, inner]
    assert errors.std() == pytest.approx(0.05, rel=0.02)
    assert errors.mean() == pytest.approx(0.0, abs=0.002)
    assert scans.max() <= 2.5
    assert 0.0 < scanner(range_noise_std_m=1.0, beam_count=360).scan(pose).min() < 0.01


def test_a_robot_behind_a_wall_changes_neither_ranges_nor_noise():
    poses = np.array([[1.0, 1.0, 0.0], [3.0, 3.0, 0.0]])
    walls = np.concatenate([SQUARE, [[[2, 0], [2, 4]]]])
    one, two = (scanner(walls, robots=count, seed=4, range_noise_std_m=0.02).scan(poses[:count]) for count in (1, 2))
    assert np.array_equal(one[0], two[0])


PANE = np.array([[[3.0, -20.0], [3.0, 20.0]], [[6.0, -20.0], [6.0, 20.0]]])


def test_beams_drop_out_with_the_configured_probability():
    device = scanner(dropout_probability=0.2, beam_count=360, range_noise_std_m=0.0)
    pose = np.array([[2.0, 2.0, 0.0]])
    scans = np.array([device.scan(pose)[0] for _ in range(200)])
    exact = scanner(beam_count=360).scan(pose)[0]
    lost = scans == 10.0
    assert lost.mean() == pytest.approx(0.2, abs=0.01)
    assert np.array_equal(scans[~lost], np.broadcast_to(exact, scans.shape)[~lost])


def glass_scanner(**config) -> Lidar:
    """A pane 3 m ahead with a wall 3 m behind it."""
    settings = {"beam_count": 360, "range_noise_std_m": 0.0, "range_max_m": 15.0, **config}
    return Lidar(LidarConfig(**settings), index_walls(PANE, np.ones(2)), 0.2, 1, 0, glass=(0,))


def test_glass_is_a_wall_like_any_other_by_default():
    device, pose = glass_scanner(), np.zeros((1, 3))
    assert np.array_equal(device.scan(pose), scanner(PANE, beam_count=360, range_max_m=15.0).scan(pose))
    assert device.scan(pose)[0, 0] == pytest.approx(3.0)


def test_glass_reflects_with_the_probability_of_its_incidence_angle():
    device = glass_scanner(glass_return_probability=0.8, glass_incidence_max_rad=0.6)
    scans = np.array([device.scan(np.zeros((1, 3)))[0] for _ in range(600)])
    for beam in (0, 10, 20, 30, 40, 340):
        angle = np.deg2rad(beam if beam < 180 else 360 - beam)
        pane, wall = 3.0 / np.cos(angle), 6.0 / np.cos(angle)
        seen = np.isclose(scans[:, beam], pane)
        assert (seen | np.isclose(scans[:, beam], wall)).all()
        assert seen.mean() == pytest.approx(max(0.0, 0.8 * (1 - angle / 0.6)), abs=0.06)


def test_glass_that_never_returns_leaves_exactly_the_solid_walls():
    plan = load_map("twin-01")
    panes = tuple(range(0, len(plan.walls_m), 5))
    rest = np.delete(np.arange(len(plan.walls_m)), panes)
    poses = np.array([[15.0, 1.2, 0.3]])
    config = LidarConfig(glass_return_probability=0.0, range_noise_std_m=0.0)
    through = Lidar(config, plan.wall_index, 0.2, 1, 0, glass=panes).scan(poses)
    solid = Lidar(config, index_walls(plan.walls_m[rest], plan.wall_loss_db[rest]), 0.2, 1, 0).scan(poses)
    assert through == pytest.approx(solid, abs=1e-9)


def test_a_building_with_glass_walls_only_can_be_scanned():
    config = LidarConfig(glass_return_probability=0.0)
    device = Lidar(config, index_walls(SQUARE, np.ones(4)), 0.2, 1, 0, glass=(0, 1, 2, 3))
    assert (device.scan(np.array([[2.0, 2.0, 0.0]])) == config.range_max_m).all()


def test_glass_walls_of_a_plan_are_those_of_glassy_material():
    plan = load_map("twin-01")
    names = [
        "glass" if k == 3 else "brick" if k == 4 else "coated-glass" if k == 7 else "" for k in range(len(plan.walls_m))
    ]
    assert glass_walls(plan) == ()
    assert glass_walls(dataclasses.replace(plan, wall_materials=tuple(names))) == (3, 7)
