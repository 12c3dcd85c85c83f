"""Scanners with limits and errors of real ones, against closed forms and a second implementation."""

import math

import numpy as np
import pytest
from scipy.stats import kstest, norm

from tests.world.sensors.test_lidar import nearest_hit
from twc_env.config import LIDAR_PRESETS, EnvConfig, LidarConfig, lidar_preset, override
from twc_env.errors import ConfigError
from twc_env.maps import load_map
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.sensors.scanner_errors import is_dark
from twc_env.world.sensors.scanners import Scanners, needs_scanners
from twc_env.world.world import World

ROOM = np.array([[[0, 0], [8, 0]], [[8, 0], [8, 6]], [[8, 6], [0, 6]], [[0, 6], [0, 0]]], float)
BESIDE = np.array([[3.0, 2.0, 0.4]])


def plan_of(walls_m, materials=()) -> Floorplan:
    return Floorplan("walls", np.asarray(walls_m, float), np.zeros(len(walls_m)), wall_materials=tuple(materials))


def scanners(walls_m=ROOM, robots=1, seed=0, materials=(), **settings) -> Scanners:
    """Scanners of the generic kind, by default without noise and with returns of everything in range."""
    lidar = {"lidar.range_noise_std_m": 0.0, "lidar.range_max_m": 12.0, "lidar.range_min_m": 1e-9}
    config = override(EnvConfig(robots=robots), lidar | {f"lidar.{key}": value for key, value in settings.items()})
    return Scanners(config, plan_of(walls_m, materials), seed)


def expected(walls_m, pose, config: LidarConfig) -> list[float]:
    """Ranges of a scanner on a robot that stands, by its documented geometry."""
    x, y, heading = pose
    place = np.array([
        x + math.cos(heading) * config.mount_x_m - math.sin(heading) * config.mount_y_m,
        y + math.sin(heading) * config.mount_x_m + math.cos(heading) * config.mount_y_m,
    ])  # fmt: skip
    side, fov, beams = (-1 if config.is_clockwise else 1), config.field_of_view_rad, config.beam_count
    if fov >= 2 * math.pi:
        angles = side * 2 * np.pi * np.arange(beams) / beams
    else:
        angles = side * np.linspace(-fov / 2, fov / 2, beams)
    return [nearest_hit(walls_m, place, heading + config.mount_yaw_rad + angle) for angle in angles]


def test_the_default_scanner_needs_none_of_it():
    assert LidarConfig().scanner is None and not needs_scanners(LidarConfig())
    assert LidarConfig().circle_beam_count == LidarConfig().beam_count
    assert lidar_preset("ideal") == LidarConfig()


@pytest.mark.parametrize(
    "settings",
    [
        {}, {"is_clockwise": True}, {"field_of_view_rad": math.pi}, {"field_of_view_rad": 4.7, "is_clockwise": True},
        {"mount_x_m": 0.2, "mount_y_m": -0.1, "mount_yaw_rad": 0.7}, {"beam_count": 1081, "field_of_view_rad": 4.7},
        {"mount_yaw_rad": math.pi, "field_of_view_rad": 2.0, "beam_count": 8},
    ],
)  # fmt: skip
def test_field_of_view_order_and_mounting_are_as_documented(settings):
    device = scanners(**settings)
    found, has_scan = device.scan(0, BESIDE)
    assert has_scan is None
    assert found[0] == pytest.approx(np.array(expected(ROOM, BESIDE[0], device._config)), abs=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_beams_of_a_rolling_scan_are_measured_from_where_the_robot_was(seed):
    random = np.random.default_rng(seed)
    begins = random.uniform(0, 8, (30, 2))
    walls = np.concatenate([ROOM, np.stack([begins, begins + random.normal(0, 1, (30, 2))], axis=1)])
    device = scanners(walls, beam_count=90, is_rolling=True, rate_hz=5.0, mount_x_m=0.15, is_clockwise=seed % 2 == 1)
    path = [np.array([*random.uniform(2, 5, 2), random.uniform(-3, 3)])]
    for _ in range(4):
        path.append(path[-1] + np.array([*random.uniform(-0.1, 0.1, 2), random.uniform(-0.5, 0.5)]))
    for step, pose in enumerate(path):
        found, has_scan = device.scan(step, pose[None])
        assert has_scan.all() == (step % 2 == 0)
    side, wanted = (-1 if seed % 2 else 1), []
    for beam in range(90):
        back = 2.0 * (89 / 90) * (1 - beam / 89)  # time steps before the end of the scan
        k, share = int(back), back - int(back)
        x, y, heading = path[-1 - k] + share * (path[max(-2 - k, -5)] - path[-1 - k])
        place = np.array([x + 0.15 * math.cos(heading), y + 0.15 * math.sin(heading)])
        wanted.append(max(nearest_hit(walls, place, heading + side * 2 * np.pi * beam / 90), 0.001))
    assert found[0] == pytest.approx(np.array(wanted), abs=1e-7)


def test_a_scan_is_repeated_until_the_next_one_is_complete():
    device = scanners(rate_hz=2.5, range_noise_std_m=0.01)
    scans = [device.scan(step, BESIDE + 0.01 * step) for step in range(9)]
    assert [bool(new.all()) for _, new in scans] == [True, False, False, False] * 2 + [True]
    for step, (ranges_m, _) in enumerate(scans):
        assert np.array_equal(ranges_m, scans[step - step % 4][0])


def test_nothing_nearer_than_the_minimum_range_gives_a_return():
    exact = scanners(beam_count=360).scan(0, BESIDE)[0][0]
    near = scanners(beam_count=360, range_min_m=3.0).scan(0, BESIDE)[0][0]
    assert (near[exact < 3.0] == 12.0).all() and np.array_equal(near[exact >= 3.0], exact[exact >= 3.0])


def test_noise_has_a_constant_part_and_one_that_grows_with_range():
    device = scanners(beam_count=360, range_noise_std_m=0.01, range_noise_per_m=0.02)
    exact = scanners(beam_count=360).scan(0, BESIDE)[0][0]
    errors = np.array([device.scan(k, BESIDE)[0][0] - exact for k in range(400)])
    assert errors.std(axis=0) / np.hypot(0.01, 0.02 * exact) == pytest.approx(1.0, abs=0.15)
    numbers = errors / np.hypot(0.01, 0.02 * exact)
    assert numbers.std() == pytest.approx(1.0, rel=0.01)
    assert kstest(numbers.ravel(), norm.cdf).pvalue > 0.01
    for lag in (1, 360):  # the next beam, and the next scan
        assert np.corrcoef(numbers.ravel()[lag:], numbers.ravel()[:-lag])[0, 1] == pytest.approx(0.0, abs=0.011)


def test_robots_have_noise_of_their_own_that_repeats_with_the_seed():
    poses = np.repeat(BESIDE, 2, axis=0) + [[0.0, 0.0, 0.0], [4.0, 3.0, math.pi]]
    one, two, other = (
        scanners(robots=2, seed=seed, range_noise_std_m=0.01, is_rolling=True, rate_hz=10.0).scan(0, poses)[0]
        for seed in (1, 1, 2)
    )
    exact = scanners(robots=2, is_rolling=True, rate_hz=10.0).scan(0, poses)[0]
    assert np.array_equal(one, two)
    assert abs(np.corrcoef((one - exact)[:, :170])[0, 1]) < 0.3 and not np.array_equal(one, other)


@pytest.mark.parametrize("detection_m", [3.0, 5.0, 9.0])
def test_returns_are_lost_beyond_the_detection_range_of_the_surface(detection_m):
    wall = [[[4.0, -300.0], [4.0, 300.0]]]
    device = scanners(wall, beam_count=720, detection_range_m=detection_m)
    angles = 2 * np.pi * np.arange(720) / 720
    returned = np.mean([device.scan(k, np.zeros((1, 3)))[0][0] < 12.0 for k in range(200)], axis=0)
    hits = np.cos(angles) > 4.0 / 11.9
    cos = np.cos(angles[hits])
    limit_m, range_m = detection_m * np.sqrt(0.5 / 0.9 * cos), 4.0 / cos  # ordinary wall, lidar equation
    wanted = np.clip((1.2 - range_m / limit_m) / 0.4, 0.0, 1.0)
    assert returned[hits] == pytest.approx(wanted, abs=0.15)
    assert (returned[~hits] == 0.0).all()


def test_dark_surfaces_have_their_share_and_stay_where_they_are():
    points = np.random.default_rng(0).uniform(-50, 50, (20_000, 2))
    dark = np.array([is_dark(x, y, 12345, 0.3) for x, y in points])
    assert dark.mean() == pytest.approx(0.3, abs=0.02)
    square = np.floor(points)
    for corner in np.unique(square, axis=0)[:50]:
        assert len(set(dark[(square == corner).all(axis=1)])) == 1
    lost = [
        scanners(detection_range_m=12.0, dark_share=0.5, seed=seed).scan(0, BESIDE)[0][0] == 12.0 for seed in (0, 1)
    ]
    assert 0.1 < lost[0].mean() < 0.9 and (lost[0] == lost[1]).mean() > 0.9, "they belong to the building"


def test_mixed_pixels_lie_between_the_surfaces_of_an_edge():
    walls = [*ROOM, [[5.0, 2.0], [5.0, 3.0]]]
    settings = {"walls_m": walls, "beam_count": 180}
    step_rad = 2 * np.pi / 180
    exact = scanners(**settings).scan(0, BESIDE)[0][0]
    device = scanners(**settings, beam_divergence_rad=0.5 * step_rad)
    scans = np.array([device.scan(k, BESIDE)[0][0] for k in range(400)])
    changed = scans != exact
    edges = np.flatnonzero(np.abs(np.diff(np.r_[exact, exact[0]])) > 0.5)
    assert len(edges) == 2
    at_edges = np.unique(np.r_[edges, edges + 1])
    assert not np.delete(changed, at_edges, axis=1).any()
    assert changed[:, at_edges].sum() / 400 == pytest.approx(2 * 0.5, abs=0.1), "an edge is in a cone half of the time"
    for edge in edges:
        low, high = sorted(exact[[edge, edge + 1]])
        assert ((scans[:, [edge, edge + 1]] >= low) & (scans[:, [edge, edge + 1]] <= high)).all()


@pytest.mark.parametrize("probability", [0.0, 0.4, 1.0])
def test_a_mirror_shows_the_room_behind_the_robot_at_the_length_of_the_path(probability):
    device = scanners(materials=("", "mirror", "", ""), mirror_probability=probability, beam_count=8)
    pose = np.array([[5.0, 3.0, 0.0]])
    ahead = np.array([device.scan(k, pose)[0][0, 0] for k in range(300)])
    assert set(np.round(ahead, 9)) <= {3.0, 11.0}  # 3 m to the mirror, 8 m from there to the wall behind
    assert (ahead > 5.0).mean() == pytest.approx(probability, abs=0.1)


def test_glass_returns_beams_near_its_normal_only():
    device = scanners(materials=("", "glass", "", ""), glass_return_probability=0.6, beam_count=360)
    scans = np.array([device.scan(k, BESIDE - [0, 0, 0.4])[0][0] for k in range(400)])
    assert (scans[:, 0] == 5.0).mean() == pytest.approx(0.6, abs=0.08)
    assert (scans[:, 17] < 12.0).mean() == pytest.approx(0.6 * (1 - np.radians(17) / 0.6), abs=0.08)
    assert (scans[:, 40 - 5] == 12.0).all() or np.radians(35) < 0.6


def test_other_robots_are_seen_where_they_were_when_a_beam_passed():
    device = scanners(robots=2, beam_count=360, is_rolling=True, rate_hz=5.0)
    for step in range(3):
        ranges_m, _ = device.scan(step, np.array([[2.0, 3.0, 0.0], [5.0, 3.0 + 0.2 * step, 0.0]]))
    seen = np.flatnonzero(ranges_m[0] < 3.2)
    seen = seen[(seen < 90) | (seen > 270)]
    assert seen.min() < 5 and ranges_m[0, 0] == pytest.approx(2.8, abs=1e-3), "the first beam is of two steps ago"
    assert ranges_m[0, 355:].min() > 3.2, "the last ones, of now, pass the robot's old place"


def test_one_error_does_not_change_the_draws_of_another():
    plain = scanners(range_noise_std_m=0.02).scan(0, BESIDE)[0]
    more = scanners(range_noise_std_m=0.02, detection_range_m=30.0, beam_divergence_rad=0.01).scan(0, BESIDE)[0]
    assert (plain == more).mean() > 0.7


@pytest.mark.parametrize("name", LIDAR_PRESETS)
def test_every_preset_scans_a_building(name):
    config = override(EnvConfig(), {"lidar.preset": name})
    world = World(config, load_map("twin-01"))
    world.reset(0)
    ranges_m = world.sense().ranges_m
    assert ranges_m.shape == (config.robots, config.lidar.beam_count)
    assert (ranges_m < config.lidar.range_max_m).mean() > 0.3
    assert config.lidar.circle_beam_count in (180, 360)


def test_a_rolling_scan_needs_a_rate():
    with pytest.raises(ConfigError, match=r"lidar\.is_rolling is true and lidar\.rate_hz 0: set the scans per second"):
        LidarConfig(is_rolling=True)
