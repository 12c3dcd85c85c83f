import numpy as np
import pytest
from scipy import ndimage

from twc_env.config import EnvConfig, override
from twc_env.config.people import PeopleConfig
from twc_env.errors import MapError
from twc_env.maps import load_map
from twc_env.world.clutter.doorways import doorways_of
from twc_env.world.people.crowd import Crowd
from twc_env.world.people.walking import BODY_RADIUS_M, SEAT_RADIUS_M, SITTING, WALKING
from twc_env.world.world import World

RADIUS_M, DT_S = 0.2, 0.1
HOME = load_map("twin-01").home
FAR = np.array([HOME.starts[0]])


def crowd_of(seed=0, robots=FAR, **settings):
    return Crowd(PeopleConfig(**settings), HOME, robots, RADIUS_M, DT_S, seed)


def walked(crowd, robots=FAR, steps=400):
    """(steps, people, 2) positions while robots stand."""
    path = []
    for _ in range(steps):
        crowd.step(robots, np.zeros((len(robots), 2)))
        crowd.meet(robots)
        path.append(crowd.bodies.copy())
    return np.array(path)


@pytest.fixture(scope="module")
def path():
    crowd = crowd_of(count=16, pause_mean_s=3.0)
    return crowd, walked(crowd)


def test_bodies_stay_out_of_walls_and_robots(path):
    _, places = path
    assert HOME.wall_index.distance_m(places.reshape(-1, 2), 1.0).min() > BODY_RADIUS_M - 1e-6
    assert np.hypot(*(places - FAR[0, :2]).reshape(-1, 2).T).min() > BODY_RADIUS_M + RADIUS_M - 0.05


def test_walking_people_cover_ground_at_walking_speed_and_sitting_ones_stay(path):
    crowd, places = path
    stride_m = np.hypot(*np.moveaxis(np.diff(places, axis=0), -1, 0))
    kinds, length_m = crowd._kinds, stride_m.sum(axis=0)
    assert (length_m[kinds == WALKING] > 5.0).all() and (kinds == WALKING).sum() == 8
    assert (length_m[kinds == SITTING] == 0.0).all() and (kinds == SITTING).sum() == 4
    assert np.quantile(stride_m, 0.999) <= 1.3 * (1.29 + 4 * 0.19) * DT_S


def test_walking_people_change_rooms(path):
    crowd, places = path
    away_m = np.hypot(*np.moveaxis(places - places[0], -1, 0)).max(axis=0)
    assert np.median(away_m[crowd._kinds == WALKING]) > 4.0


def test_the_same_seed_gives_the_same_paths_and_another_one_others():
    first, again, other = (walked(crowd_of(seed, count=8), steps=60) for seed in (3, 3, 4))
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_a_robot_that_drives_at_a_sitting_person_is_counted_once_and_stopped_by_its_bumper():
    crowd = crowd_of(count=1, walking_share=0.0, sitting_share=1.0)
    person = crowd.bodies[0].copy()
    pose = np.array([[person[0] - 0.97, person[1], 0.0]])
    stopped = []
    for _ in range(40):
        left = crowd.step(pose, np.array([[0.5, 0.0]]))
        pose = pose + np.array([[left[0, 0] * DT_S, 0.0, 0.0]])
        crowd.meet(pose)
        stopped.append(left[0, 0] == 0.0)
    assert crowd.collisions.tolist() == [1] and crowd.is_touched[0] and stopped[-1] and not stopped[0]
    assert person[0] - pose[0, 0] > BODY_RADIUS_M + RADIUS_M - 0.06


def test_a_robot_may_back_away_from_a_person_it_touches():
    crowd = crowd_of(count=1, walking_share=0.0, sitting_share=1.0)
    pose = np.array([[crowd.bodies[0, 0] - 0.35, crowd.bodies[0, 1], 0.0]])
    assert crowd.step(pose, np.array([[-0.5, 0.2]])).tolist() == [[-0.5, 0.2]]


def test_a_robot_that_stands_is_never_at_fault():
    crowd = crowd_of(count=20, walking_share=1.0, pause_mean_s=0.0)
    walked(crowd, steps=500)
    assert crowd.collisions.tolist() == [0]


def test_too_many_people_are_refused_with_the_setting_to_reduce():
    with pytest.raises(MapError, match=r"no room for 200 people; reduce people\.count"):
        Crowd(PeopleConfig(count=200), load_map("gen:office:100:1").home, FAR, RADIUS_M, DT_S, 0)


def test_nobody_sits_or_stands_in_a_doorway_for_good():
    home = load_map("gen:office:400:24").home
    crowd = Crowd(PeopleConfig(count=30, walking_share=0.0, sitting_share=0.5), home, FAR, RADIUS_M, DT_S, 0)
    doorways = doorways_of(home)
    middles = 0.5 * (doorways[:, :2] + doorways[:, 2:])
    assert np.hypot(*(crowd.bodies[:, None] - middles).transpose(2, 0, 1)).min() >= 0.8


@pytest.mark.parametrize("seed", [1423, 1435])
def test_who_sits_leaves_robots_a_way_past(seed):
    """Two chairs side by side closed the corridors of these offices."""
    world = World(override(EnvConfig(), {"robots": 3, "people.count": 30}), load_map(f"gen:office:400:{seed}"))
    world.reset(seed)
    assert world.crowd is not None
    home, crowd = world.plan.home, world.crowd
    seats, radius_m = crowd.bodies[crowd._kinds == SITTING], world.config.dynamics.robot_radius_m + 0.05
    cells = home.cells()
    places = cells.centre_of(np.argwhere(cells.free))
    floor = cells.free.copy()
    floor[cells.free] = home.wall_index.distance_m(places, 1.0) >= radius_m
    shared = np.bincount(ndimage.label(floor)[0][floor]).max()
    beside = np.hypot(*np.moveaxis(places[:, None] - seats, -1, 0)).min(axis=1) >= radius_m + SEAT_RADIUS_M
    floor[cells.free] &= beside
    assert np.bincount(ndimage.label(floor)[0][floor]).max() > 0.9 * shared
    assert len(seats) == 8


def test_nobody_sits_where_an_open_door_leaves_too_little_of_the_way():
    plan = load_map("gen:office:400:530")
    config = {"clutter.door_share": 0.8, "people.count": 20, "people.walking_share": 0.0, "people.sitting_share": 1.0}
    world = World(override(EnvConfig(map=plan.name, robots=1), config), plan)
    for seed in range(5):
        world.reset(seed)
        leaves, bodies = world.clutter.open_leaves, world.crowd.bodies
        along = np.linspace(0.0, 1.0, 30)[:, None, None] * (leaves[:, 2:] - leaves[:, :2]) + leaves[:, :2]
        assert len(leaves) > 5 and np.hypot(*np.moveaxis(along[:, :, None] - bodies, -1, 0)).min() >= 0.94 + 0.2
