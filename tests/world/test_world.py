import dataclasses
import pickle

import numpy as np
import pytest

import twc_env
from twc_env.config import EnvConfig, from_dict
from twc_env.errors import ActionError, ConfigError, MapError, TwcError
from twc_env.maps import load_map
from twc_env.records.geometry import between, compose
from twc_env.world.building.floorplan import AccessPoint, Floorplan
from twc_env.world.motion.starts import START_CLEARANCE_M, START_SPACING_M
from twc_env.world.sensors.lidar import Lidar
from twc_env.world.sensors.odometry import Odometry
from twc_env.world.sensors.radio import RadioModel
from twc_env.world.sensors.reception import WifiReceiver
from twc_env.world.sensors.signs import SignCamera
from twc_env.world.world import World

TINY = Floorplan(
    "tiny", [[[0, 0], [2, 0]], [[2, 0], [2, 2]], [[2, 2], [0, 2]], [[0, 2], [0, 0]]], [5.0] * 4, interior_m=[[1, 1]]
)


def world(plan=None, seed=0, starts="random", **settings) -> World:
    result = World(from_dict(settings), plan or load_map("twin-01"))
    result.reset(seed, starts)
    return result


def commands(step: int, robots: int = 3) -> np.ndarray:
    random = np.random.default_rng(step // 10)
    return np.column_stack([random.uniform(0.2, 1.0, robots), random.uniform(-1.5, 1.5, robots)])


def episode(w: World, steps: int = 200) -> list[tuple]:
    frames = [w.sense()]
    for step in range(steps):
        w.step(commands(step, w.config.robots))
        frames.append(w.sense())
    return frames


def as_bytes(frames) -> bytes:
    return pickle.dumps([[dataclasses.astuple(frame) for frame in step] for step in frames])


def test_one_seed_gives_identical_bytes_and_another_seed_others():
    first, second, other = (as_bytes(episode(world(seed=s))) for s in (7, 7, 8))
    assert first == second
    assert first != other


def test_a_reused_world_equals_a_new_one():
    used = world(seed=1)
    episode(used, 50)
    used.reset(7)
    assert as_bytes(episode(used)) == as_bytes(episode(world(seed=7)))


@pytest.mark.parametrize("name", ["twin-01", "twin-02"])
def test_a_moved_building_gives_the_same_frames(name):
    plan = load_map(name)
    pose = np.array([31.4, -15.9, 2.6])
    here, there = world(plan, seed=3), world(plan.moved(pose), seed=3)
    assert as_bytes(episode(here)) == as_bytes(episode(there))
    assert here.sighted_signs == there.sighted_signs
    assert there.poses == pytest.approx(compose(pose, here.poses), abs=1e-9)
    assert np.array_equal(here.contacts, there.contacts)


def test_measurements_do_not_depend_on_the_origin_of_the_map_file(tmp_path):
    """A translated map file is another building: its shadowing may differ, nothing else."""
    plan = load_map("twin-01")
    pose = np.array([3.0, -2.0, 0.7])
    drawn_elsewhere = dataclasses.replace(plan.moved(pose), pose_building_home=np.zeros(3))
    starts = plan.starts[:3]
    here = world(plan, seed=3, starts=starts)
    there = world(drawn_elsewhere, seed=3, starts=compose(pose, starts))
    for a, b in zip(episode(here, 60), episode(there, 60), strict=True):
        for frame_a, frame_b in zip(a, b, strict=True):
            assert frame_a.ranges_m == pytest.approx(frame_b.ranges_m, abs=1e-9)
            assert frame_a.odometry == pytest.approx(frame_b.odometry, abs=1e-9)
            assert [s.text for s in frame_a.signs] == [s.text for s in frame_b.signs]


def test_the_first_frame_reports_no_motion():
    for frame in world().sense():
        assert frame.step == 0
        assert frame.time_s == 0.0
        assert not frame.odometry.any()
        assert frame.turn_rate_rad_s == 0.0


def test_odometry_without_drift_leads_from_the_start_to_the_true_pose():
    w = world(odometry={"drift": 0.0})
    poses = w.poses.copy()
    for frames in episode(w, 100):
        poses = compose(poses, np.array([frame.odometry for frame in frames]))
    assert between(poses, w.poses) == pytest.approx(np.zeros((3, 3)), abs=1e-9)


def test_robots_start_on_open_floor_clear_of_walls_and_of_each_other():
    plan = load_map("twin-01")
    for seed in range(20):
        w = world(plan, seed=seed, robots=5)
        places = w.poses[:, :2]
        assert plan.cells().is_free(places).all()
        assert plan.wall_index.distance_m(places, 1.0).min() >= START_CLEARANCE_M
        gaps = np.linalg.norm(places[:, None] - places[None], axis=-1) + 9 * np.eye(5)
        assert gaps.min() >= START_SPACING_M


@pytest.mark.parametrize("radius_m", [0.5, 1.0])
def test_large_robots_do_not_start_in_walls_or_in_each_other(radius_m):
    plan = load_map("sfw-e6")
    for seed in range(20):
        w = world(plan, seed=seed, robots=2, dynamics={"robot_radius_m": radius_m})
        assert plan.wall_index.distance_m(w.poses[:, :2], 2.0).min() > radius_m
        assert np.hypot(*(w.poses[0] - w.poses[1])[:2]) > 2 * radius_m
    with pytest.raises(MapError, match=r"no place 1\.02 m clear of walls"):
        world(TINY, robots=1, dynamics={"robot_radius_m": 1.0})


def test_different_seeds_start_in_different_places():
    assert not np.array_equal(world(seed=0).poses, world(seed=1).poses)


def test_the_plans_own_starts_are_used_when_asked_for():
    plan = load_map("twin-01")
    assert between(world(plan, starts="map").poses, plan.starts[:3]) == pytest.approx(np.zeros((3, 3)), abs=1e-9)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"wall_loss_db": np.ones(1)}, "one loss per wall"),
        ({"walls_m": np.zeros((0, 2, 2)), "wall_loss_db": np.zeros(0)}, "has no walls"),
        ({"walls_m": TINY.walls_m * np.nan}, "not finite"),
        ({"interior_m": np.zeros((0, 2))}, "put at least one point of interior_m into open floor"),
        ({"access_points": (AccessPoint("a", np.zeros(2), ()),)}, "no MAC address"),
        ({"access_points": (AccessPoint("a", np.zeros(2), (5, 5)),)}, "every address must be unique"),
    ],
)
def test_a_plan_built_in_memory_is_validated_too(changes, expected):
    plan = dataclasses.replace(TINY, **changes)
    with pytest.raises(MapError, match=expected):
        World(EnvConfig(), plan)
    with pytest.raises(MapError, match=expected):
        twc_env.parallel_env(floorplan=plan)


@pytest.mark.parametrize(
    ("starts", "error", "expected"),
    [
        ("here", ConfigError, "'random', 'entrance', 'map' or poses; got 'here'"),
        (np.zeros((2, 3)), ConfigError, r"starts must be 3 finite poses .* got shape \(2, 3\)"),
        (np.full((3, 3), -50.0), ConfigError, r"starts\[0\] at \(-50, -50\) is not on the free floor"),
        (np.full((3, 3), 1e300), ConfigError, r"starts\[0\] at \(1e\+300, 1e\+300\) is not on the free floor"),
        ([[2, 2, 0], [3, 3, 90], [2, 3, 0]], ConfigError, r"starts\[1\] .* heading .* got 90: .* 1.5708 rad"),
        ([[2, 2, 0], [3, 3, 0], [2, np.nan, 0]], ConfigError, r"finite poses .*; got starts\[2\] = \[2.0, nan, 0.0\]"),
        (
            [[2, 2, 0], [3, 3, 0], [2.1, 2, 0]],
            ConfigError,
            r"starts\[2\] at \(2.1, 2\) is 0.100 m from that of robot 0",
        ),
    ],
)
def test_invalid_starts_are_rejected(starts, error, expected):
    with pytest.raises(error, match=expected):
        world(starts=starts)


@pytest.mark.parametrize(
    ("starts", "radius_m", "expected"),
    [
        ([(1.85, 1.0, 0.0)], 0.2, r"starts\[0\] at \(1\.85, 1\) is 0\.150 m from a wall, .* 0\.2 m; move it at least "
         r"0\.050 m away"),
        ([(0.5, 1.0, 0.0), (0.89, 1.0, 0.0)], 0.2, r"starts\[1\] at \(0\.89, 1\) is 0\.390 m from that of robot 0, .* "
         r"keep them 0\.4 m apart"),
        ([(1.0, 1.0, 0.0)], 1.0, None),
        ([(0.2, 1.8, 0.0), (0.6, 1.8, 0.0)], 0.2, None),
    ],
)  # fmt: skip
def test_starts_in_a_wall_or_in_another_robot_are_rejected(starts, radius_m, expected):
    settings = {"robots": len(starts), "dynamics": {"robot_radius_m": radius_m}}
    own = dataclasses.replace(TINY, starts=np.array(starts))
    for plan, given, error in ((TINY, starts, ConfigError), (own, "map", MapError)):
        if expected is None:
            assert np.array_equal(world(plan, starts=given, **settings).poses, starts)
            continue
        with pytest.raises(error, match=expected):
            world(plan, starts=given, **settings)


@pytest.mark.parametrize("wrong", [np.zeros((2, 2)), np.zeros((5, 2)), np.zeros(2), np.full((3, 2), np.nan), "stop"])
def test_invalid_commands_are_rejected_without_effect(wrong):
    here, untouched = world(seed=1), world(seed=1)
    with pytest.raises(ActionError, match=r"commands must be finite and of shape \(3, 2\)"):
        here.step(wrong)
    assert as_bytes(episode(here, 5)) == as_bytes(episode(untouched, 5))


def test_more_robots_than_fit_are_rejected():
    with pytest.raises(MapError, match="4 starts for 5 robots"):
        world(robots=5, starts="map")
    assert world(TINY, robots=2).poses.shape == (2, 3)
    with pytest.raises(MapError, match="no room for 40 robots; use fewer"):
        world(TINY, robots=40)


def test_sensors_fire_at_their_periods_staggered_over_the_robots():
    w = world(radio={"scan_period_s": 0.3}, signs={"period_s": 0.5})
    heard = np.array([[frame.wifi is not None for frame in step] for step in episode(w, 60)])
    for robot in range(3):
        assert np.array_equal(np.flatnonzero(heard[:, robot]) % 3, np.full(heard[:, robot].sum(), -robot % 3))


def test_true_signs_match_the_readings_one_to_one():
    w = world(signs={"reader": "simple", "fragment_probability": 0.0, "character_error_probability": 0.0})
    seen = 0
    for step in range(300):
        w.step(commands(step))
        for frame, sources in zip(w.sense(), w.sighted_signs, strict=True):
            assert [reading.text for reading in frame.signs] == [w.plan.signs[s].text for s in sources]
            seen += len(sources)
    assert seen > 0


def test_robots_stay_on_open_floor():
    w = world(seed=2)
    for step in range(400):
        w.step(commands(step))
        assert w.plan.cells().is_free(w.poses[:, :2]).all()


def test_settings_of_one_sensor_do_not_change_the_noise_of_the_others():
    plain = episode(world(seed=5), 30)
    other = episode(world(seed=5, radio={"noise_std_db": 9.0}, signs={"range_noise_std_m": 0.5}), 30)
    for a, b in zip(plain, other, strict=True):
        for frame_a, frame_b in zip(a, b, strict=True):
            assert np.array_equal(frame_a.ranges_m, frame_b.ranges_m)
            assert np.array_equal(frame_a.odometry, frame_b.odometry)


@pytest.mark.parametrize(
    "settings",
    [
        {"signs": {"period_s": 0.1}},
        {"lidar": {"dropout_probability": 0.2}, "radio": {"fading_shared": True, "high_band": {"share": 0.5}}},
        {"radio": {"sweep_share": 0.6, "stale_age_max_s": 2.0}, "failure": {"device_offset_db": 4.0}},
    ],
)
def test_the_compiled_step_equals_each_sensor_alone(settings):
    w = world(load_map("twin-02"), seed=5, **settings)
    config, plan, robots = w.config, load_map("twin-02").home, range(3)
    lidar = Lidar(config.lidar, plan.wall_index, config.dynamics.robot_radius_m, 3, 5)
    odometry = Odometry(config.odometry, config.dynamics.time_step_s, 3, 5)
    offsets_db = (0.0, 0.0, config.failure.device_offset_db)
    radios = [WifiReceiver(config.radio, RadioModel(config.radio, plan), r, 5, offsets_db[r]) for r in robots]
    cameras = [SignCamera(config.signs, plan, r, 5, config.dynamics) for r in robots]
    before, texts = w.poses_home, 0
    for step in range(150):
        frames, now = w.sense(), w.poses_home
        motions, turn_rates = odometry.measure(before, now)
        ranges = lidar.scan(now)
        for r, frame in enumerate(frames):
            assert np.array_equal(frame.ranges_m, ranges[r])
            if step:
                assert np.array_equal(frame.odometry, motions[r]) and frame.turn_rate_rad_s == turn_rates[r]
            if frame.wifi is not None:
                alone = radios[r].scan(now[r], frame.time_s)
                assert np.array_equal(frame.wifi.macs, alone.macs)
                assert np.array_equal(frame.wifi.rssi_dbm, alone.rssi_dbm)
            if (step + r) % round(config.signs.period_s / 0.1) == 0:
                assert frame.signs == cameras[r].read(now[r], before[r], now)[0]
                texts += len(frame.signs)
        before = now
        w.step(commands(step))
    assert texts > 0


@pytest.mark.parametrize("settings", [{}, {"lidar": {"dropout_probability": 0.2}, "radio": {"stale_age_max_s": 2.0}}])
def test_a_tick_equals_step_and_sense(settings):
    """Including collisions with walls and between robots."""
    at_once, one_by_one = (world(TINY, seed=3, robots=2, **settings) for _ in range(2))
    assert as_bytes([at_once.sense()]) == as_bytes([one_by_one.sense()])
    touched = 0
    for step in range(120):
        frames = at_once.tick(commands(step, 2))
        one_by_one.step(commands(step, 2))
        assert as_bytes([frames]) == as_bytes([one_by_one.sense()])
        assert np.array_equal(at_once.poses, one_by_one.poses)
        assert np.array_equal(at_once.contacts, one_by_one.contacts)
        touched += at_once.contacts.sum()
    assert touched > 10


@pytest.mark.parametrize("call", [lambda w: w.sense(), lambda w: w.poses, lambda w: w.step(np.zeros((1, 2)))])
def test_a_world_before_its_first_reset_raises_an_error(call):
    with pytest.raises(TwcError, match=r"call reset\(\) first"):
        call(World(EnvConfig(robots=1), load_map("twin-01")))


@pytest.mark.parametrize("seed", [-1, 1.5, "a"])
def test_a_world_takes_whole_seeds_only(seed):
    with pytest.raises(ConfigError, match="seed must be a whole number"):
        World(EnvConfig(robots=1), load_map("twin-01")).reset(seed)
