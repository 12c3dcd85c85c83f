"""A later session in the map of an earlier one: two drives through one hall, from different starts."""

from types import SimpleNamespace

import numpy as np
import pytest

from twc_env.config import EnvConfig, override
from twc_env.datasets.buildings.ros_map import write_ros_map
from twc_env.datasets.lasting_maps import prior_of, read_lasting_map, write_lasting_map
from twc_env.errors import ConfigError, DataError
from twc_env.exploration.environment import ExplorationEnv
from twc_env.maps import load_map
from twc_env.metrics import align_team
from twc_env.records.geometry import compose, inverse
from twc_env.records.lasting_map import LastingMap
from twc_env.records.messages import GridMap
from twc_env.reproduce.routes import RoutePlanner, room_tour, steer
from twc_env.slam.engine import CooperativeSlam
from twc_env.slam.localisation import GAIN, RECENT, Localiser, Walls
from twc_env.slam.map_localisation import MapLocalisation
from twc_env.slam.merging import map_merging
from twc_env.slam.modes import make_engine
from twc_env.world.world import World


def driven(
    config: EnvConfig,
    prior=None,
    seed: int = 0,
    backwards: bool = False,
    kind=CooperativeSlam,
    note=lambda engine: None,
):
    """The engine after a tour of two rooms of twin-02, and estimated and true poses at its steps (steps, 3) each."""
    plan = load_map("twin-02")
    rooms = sorted(plan.rooms, key=lambda room: room.name)[:3]
    way = RoutePlanner(plan).route([stop for room in rooms for stop in room_tour(room)])
    way = way[::-1] if backwards else way
    world, engine = World(config, plan), kind(config, 1, prior)
    heading = np.arctan2(*(way[5] - way[0])[::-1])
    world.reset(seed, np.array([[*way[0], heading]]))
    at, estimated, true = 0, [], []
    for step in range(3000):
        engine.track(world.sense())
        engine.absorb(step)
        note(engine)
        estimated.append(engine.pose_map_robot(0).copy())
        true.append(world.poses[0].copy())
        command, at = steer(world.poses[0], way, at, config)
        if command is None:
            break
        world.step(np.array([command]))
    engine.finish()
    return engine, np.array(estimated), np.array(true)


@pytest.fixture(scope="module")
def config():
    return override(EnvConfig(), {"map": "twin-02", "robots": 1, "lidar.beam_count": 120})


@pytest.fixture(scope="module")
def first(config, tmp_path_factory):
    """File of the first session's map, and alignment of its frame with the building."""
    engine, estimated, true = driven(config)
    path = tmp_path_factory.mktemp("maps") / "first.npz"
    write_lasting_map(path, engine.lasting_map())
    return path, align_team(estimated, true)


@pytest.fixture(scope="module")
def second(config, first):
    return driven(config, read_lasting_map(first[0]), seed=7, backwards=True)


def test_a_later_session_finds_itself_in_the_frame_of_the_first(first, second):
    engine, estimated, true = second
    assert engine.found_prior(0)
    apart = compose(first[1], estimated[-1]) - true[-1]
    assert np.hypot(*apart[:2]) < 0.1


@pytest.mark.parametrize(("share", "is_found"), [(0.15, True), (0.25, False)])
def test_an_old_map_may_contradict_walls_as_much_as_an_existing_merge(config, first, monkeypatch, share, is_found):
    """Doors were shut and furniture was moved since; a map of the same day may contradict a tenth of the walls."""
    monkeypatch.setattr(map_merging, "wall_contradiction", lambda *_: share)
    engine, *_ = driven(config, read_lasting_map(first[0]), seed=7, backwards=True)
    assert engine.found_prior(0) == is_found


def test_the_poses_of_the_first_session_do_not_change(first, second):
    prior, team = read_lasting_map(first[0]), second[0].team
    assert np.array_equal(team.segment_path(team.prior)[0], prior.poses)


def test_the_map_of_both_sessions_is_of_the_newest_keyframes_and_bounded(first, second):
    prior, both = read_lasting_map(first[0]), second[0].lasting_map()
    arrived = len(prior.poses) + len(second[0].team.keyframes[0])
    assert both.sessions == 2 and np.mean(both.sessions_of == 1) > 0.5
    assert len(both.poses) < 1.3 * len(prior.poses) < arrived
    assert both.edge_ends.max() < len(both.poses)


def test_a_robot_that_has_not_found_the_map_saves_it_as_it_was(config, first):
    prior = read_lasting_map(first[0])
    engine = CooperativeSlam(config, 1, prior)
    assert engine.lasting_map() is prior and not engine.found_prior(0)
    assert engine.belief(0).grid.log_odds.size == 0


def test_an_engine_names_what_it_cannot_begin_with(config, first):
    prior = read_lasting_map(first[0])
    for changes, message in [
        ({"slam.oracle": "starts"}, "slam.oracle is 'starts'"),
        ({"slam.cues.lidar": False}, "slam.cues.lidar is off"),
        ({"lidar.beam_count": 90}, "120 beams of up to 10 m, this scanner has 90"),
    ]:
        with pytest.raises(ConfigError, match=message):
            CooperativeSlam(override(config, changes), 1, prior)
    with pytest.raises(ConfigError, match=r"prior=datasets\.lasting_maps\.read_lasting_map\(FILE\)"):
        CooperativeSlam(override(config, {"slam.prior": str(first[0])}), 1)


def test_the_setting_names_the_file(config, first):
    assert prior_of(config) is None
    assert len(prior_of(override(config, {"slam.prior": str(first[0])})).poses) == len(read_lasting_map(first[0]).poses)


@pytest.fixture(scope="module")
def localised(config, first):
    """An engine that localises a robot on a way back through the building; whether it was lost after each step, and its
    errors in the frame of the map."""
    known, is_lost = read_lasting_map(first[0]), []
    engine, estimated, true = driven(
        config, known, 7, True, MapLocalisation, lambda engine: is_lost.append(engine.localisers[0].is_lost)
    )
    return engine, known, np.array(is_lost), compose(first[1], estimated) - true


def test_a_robot_is_localised_in_a_finished_map_and_says_so(localised):
    engine, _, is_lost, apart = localised
    assert is_lost[0] and not is_lost[-1] and engine.found_prior(0) and engine.lacked() == []
    assert np.median(np.hypot(*apart[~is_lost, :2].T)) < 0.06


def test_the_finished_map_does_not_change_and_is_that_of_the_robot(localised):
    engine, known, *_ = localised
    grid = engine.belief(0).grid
    assert np.array_equal(grid.log_odds > 0, known.grid.log_odds > 0)
    assert np.array_equal(grid.log_odds < 0, known.grid.log_odds < 0)
    assert engine.bytes_sent == {} or not any(engine.bytes_sent.values())
    with pytest.raises(DataError, match="the map does not change"):
        engine.lasting_map()


def test_a_robot_in_another_building_says_that_it_is_lost(config, first):
    engine, world = MapLocalisation(config, 1, read_lasting_map(first[0])), World(config, load_map("twin-01"))
    world.reset(0, "map")
    for _ in range(150):
        engine.update(world.sense())
        world.step(np.array([[0.4, 0.3]]))
    assert engine.localisers[0].is_lost and engine.lacked() == ["robot 0 is lost in the map"]
    assert not engine.found_prior(0)


@pytest.mark.parametrize(
    ("turned", "is_lost", "left"), [(0.15, False, 1.0), (0.06, False, 1.0 - GAIN), (0.15, True, 0.0)]
)
def test_a_match_far_from_odometry_is_believed_by_a_lost_robot_alone(config, turned, is_lost, left):
    """`left`: what is left of a heading that is `turned` too far after a scan."""
    localiser = in_a_room(config)
    localiser.pose_map_odom, localiser.is_lost = np.array([3.0, 2.0, turned]), is_lost
    localiser._streak = (0, 0.0) if is_lost else (5, 0.0)
    localiser.update(np.zeros(3), scan_in_room(3.0), [], 0.0)
    assert localiser.pose_map_odom[2] == pytest.approx(left * turned, abs=0.01)


def test_a_robot_that_is_lost_again_searches_from_every_keyframe_and_does_not_doubt_the_size_of_the_map(config):
    """It has searched for long before it was found, and some searches fitted a map of half the size."""
    localiser, searches = in_a_room(config), []
    localiser._searches, localiser._scales = 200, [0.5, 0.5]
    assert localiser.map_scale == 0.5
    localiser.pose_map_odom = np.array([2.0, 2.0, 0.0])
    for step in range(20):
        localiser.update(np.array([0.2 * step, 0.0, 0.0]), scan_in_room(2.0 + 0.2 * step), [], 0.1 * step)
    assert not localiser.is_lost
    seen = SimpleNamespace(signs=(), fingerprint=SimpleNamespace(macs=()), pose_odom=np.zeros(3))
    seen.ranges_m = scan_in_room(3.0)
    localiser._begin()
    localiser._recent, localiser._match = [seen] * RECENT, lambda *_: searches.append(None)
    for _ in range(20):
        localiser._searched(seen)
    assert len(searches) == 20 and localiser.map_scale == 1.0


@pytest.mark.parametrize(("length_m", "is_lost"), [(8.0, False), (40.0, True)])
def test_a_lost_robot_is_not_found_by_walls_that_do_not_tell_how_far_along_them_it_is(config, length_m, is_lost):
    """It is taken to be 0.5 m too far: in a room the ends of the walls mend that, in a corridor all scans fit there."""
    localiser = in_a_room(config, length_m)
    localiser.pose_map_odom = np.array([0.5 * length_m - 1.5, 2.0, 0.0])
    for step in range(20):
        x_m = 0.2 * step
        ranges_m = scan_in_room(0.5 * length_m - 2.0 + x_m, length_m)
        localiser.update(np.array([x_m, 0.0, 0.0]), ranges_m, [], 0.1 * step)
    assert localiser.is_lost == is_lost and localiser.fit > 0.9


def in_a_room(config, length_m=8.0):
    """A localiser in an empty room, 5 m wide."""
    level = np.full((51, round(10.0 * length_m) + 1), -50, np.int16)
    level[[0, -1]] = level[:, [0, -1]] = 50
    return Localiser(config, Walls.of(LastingMap.of_grid(GridMap(level, np.array([-0.05, -0.05]), 0.1), 120, 10.0)))


def scan_in_room(x_m, length_m=8.0):
    """Ranges at (x_m, 2) of that room; 10 m where nothing is nearer."""
    angles = 2 * np.pi * np.arange(120) / 120 + 1e-9
    along_m = [
        np.where(np.cos(angles) > 0, length_m - x_m, -x_m) / np.cos(angles),
        np.where(np.sin(angles) > 0, 3.0, -2.0),
    ]
    return np.minimum(np.minimum(along_m[0], along_m[1] / np.sin(angles)), 10.0)


def test_a_map_without_walls_is_refused(config):
    with pytest.raises(DataError, match="has no walls"):
        MapLocalisation(config, 1, LastingMap.of_grid(GridMap(np.zeros((3, 3), np.int16), np.zeros(2), 0.1), 120, 10.0))


def test_a_map_too_large_to_search_is_refused_at_once(config):
    level = np.zeros((2, 11_000), np.int16)
    level[:, ::1000] = 50
    with pytest.raises(DataError, match=r"is 1000 m long.*check its resolution"):
        MapLocalisation(config, 1, LastingMap.of_grid(GridMap(level, np.zeros(2), 0.1), 120, 10.0))


def test_localisation_without_a_map_and_a_plain_map_without_localisation_are_refused(config, first, tmp_path):
    with pytest.raises(ConfigError, match=r"slam\.mode is 'localisation': name the map"):
        make_engine(override(config, {"slam.mode": "localisation"}), 1)
    write_ros_map(read_lasting_map(first[0]).grid, tmp_path, "plain")
    plain = override(config, {"slam.prior": str(tmp_path / "plain.yaml")})
    with pytest.raises(ConfigError, match=r"a plain map without places.*slam\.mode=localisation"):
        make_engine(plain, 1, prior_of(plain))


def test_a_ros_map_of_other_cells_is_the_map_of_an_episode_in_localisation_mode(tmp_path):
    office = {"map": "gen:office:300:7", "robots": 1, "max_cycles": 500, "action.kind": "frontier"}
    first = explored(office, seed=0)
    grid = first.engine.belief(0).grid
    fine = GridMap(np.kron(grid.log_odds, np.ones((2, 2), np.int16)), grid.origin_m, 0.5 * grid.resolution_m)
    write_ros_map(fine, tmp_path, "fine")
    env = explored({**office, "slam.mode": "localisation", "slam.prior": str(tmp_path / "fine.yaml")}, seed=3)
    assert env.engine.found_prior(0) and not env.engine.localisers[0].is_lost
    known = env.engine.belief(0).grid
    assert (known.level_at(grid.centre_of(np.argwhere(grid.log_odds > 0))) > 0).all()
    assert known.resolution_m == grid.resolution_m
    frame = compose(env.result().pose_building_map[0], inverse(first.result().pose_building_map[0]))
    assert np.abs(frame).max() < 0.15, "both sessions have one frame"


def test_a_ros_map_of_the_wrong_size_is_not_found_and_told(tmp_path):
    office = {"map": "gen:office:300:7", "robots": 1, "max_cycles": 500, "action.kind": "frontier"}
    grid = explored(office, seed=0).engine.belief(0).grid
    write_ros_map(GridMap(grid.log_odds, 2.0 * grid.origin_m, 2.0 * grid.resolution_m), tmp_path, "large")
    engine = explored({**office, "slam.mode": "localisation", "slam.prior": str(tmp_path / "large.yaml")}, 3).engine
    assert engine.lacked() == [
        "robot 0 is lost in the map; at 0.49 times its size its scans would fit: check its resolution"
    ]


def explored(settings, seed):
    """An environment after an episode in which the robot goes to the first of its frontiers."""
    env = ExplorationEnv(config=settings)
    env.reset(seed=seed)
    while env.agents:
        env.step({"robot_0": 0})
    return env
