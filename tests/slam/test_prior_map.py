"""A later session in the map of an earlier one: two drives through one hall, from different starts."""

import numpy as np
import pytest

from twc_env.config import EnvConfig, override
from twc_env.datasets.lasting_maps import prior_of, read_lasting_map, write_lasting_map
from twc_env.errors import ConfigError, DataError
from twc_env.maps import load_map
from twc_env.metrics import align_team
from twc_env.records.geometry import compose
from twc_env.records.messages import GridMap
from twc_env.reproduce.routes import RoutePlanner, room_tour, steer
from twc_env.slam.engine import CooperativeSlam
from twc_env.slam.localisation import Localiser
from twc_env.world.world import World


def driven(config: EnvConfig, prior=None, seed: int = 0, backwards: bool = False):
    """The engine after a tour of two rooms of twin-02, and estimated and true poses at its steps (steps, 3) each."""
    plan = load_map("twin-02")
    rooms = sorted(plan.rooms, key=lambda room: room.name)[:3]
    way = RoutePlanner(plan).route([stop for room in rooms for stop in room_tour(room)])
    way = way[::-1] if backwards else way
    world, engine = World(config, plan), CooperativeSlam(config, 1, prior)
    heading = np.arctan2(*(way[5] - way[0])[::-1])
    world.reset(seed, np.array([[*way[0], heading]]))
    at, estimated, true = 0, [], []
    for step in range(3000):
        engine.track(world.sense())
        engine.absorb(step)
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
    with pytest.raises(ConfigError, match="give its content"):
        CooperativeSlam(override(config, {"slam.prior": str(first[0])}), 1)


def test_the_setting_names_the_file(config, first):
    assert prior_of(config) is None
    assert len(prior_of(override(config, {"slam.prior": str(first[0])})).poses) == len(read_lasting_map(first[0]).poses)


def test_a_robot_is_localised_in_a_finished_map_and_says_so(config, first):
    localiser = Localiser(config, read_lasting_map(first[0]))
    plan = load_map("twin-02")
    rooms = sorted(plan.rooms, key=lambda room: room.name)[:3]
    way = RoutePlanner(plan).route([stop for room in rooms for stop in room_tour(room)])[::-1]
    world, at, places, true = World(config, plan), 0, [], []
    world.reset(7, np.array([[*way[0], np.arctan2(*(way[5] - way[0])[::-1])]]))
    while True:
        places.append(localiser.update(world.sense()[0]))
        true.append(world.poses[0].copy())
        command, at = steer(world.poses[0], way, at, config)
        if command is None:
            break
        world.step(np.array([command]))
    is_lost = np.array([place.is_lost for place in places])
    apart = compose(first[1], np.array([place.pose_map_robot for place in places])) - np.array(true)
    assert is_lost[0] and not is_lost[-1]
    assert np.median(np.hypot(*apart[~is_lost, :2].T)) < 0.06


def test_a_robot_in_another_building_says_that_it_is_lost(config, first):
    localiser, world = Localiser(config, read_lasting_map(first[0])), World(config, load_map("twin-01"))
    world.reset(0, "map")
    for _ in range(150):
        place = localiser.update(world.sense()[0])
        world.step(np.array([[0.4, 0.3]]))
    assert place.is_lost


def test_a_map_without_walls_is_refused(config):
    with pytest.raises(DataError, match="has no walls"):
        Localiser(config, GridMap(np.zeros((3, 3), np.int16), np.zeros(2), 0.1))
