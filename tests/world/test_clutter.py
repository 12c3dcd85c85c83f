"""Doors and furniture: where they are, what they stop, and what is seen of them."""

import math

import numpy as np
import pytest

from twc_env.config import EnvConfig, override
from twc_env.maps import load_map
from twc_env.world.clutter.contact import ANGLE, COLUMNS, GOAL, LEFT_S, LENGTH, OPEN_RAD, SIDE, swing
from twc_env.world.clutter.doorways import WIDTH_MAX_M, WIDTH_MIN_M, doorways_of
from twc_env.world.clutter.furniture import PASSAGE_M, legs_of, sides_of
from twc_env.world.world import World

MAP = "gen:office:400:0"
DOORS = {"clutter.door_share": 1.0, "clutter.door_open_mean_s": 3.0, "clutter.door_closed_mean_s": 3.0}
FURNITURE = {"clutter.furniture": 30}
QUIET = {"lidar.range_noise_std_m": 0.0, "odometry.drift": 0.0}


@pytest.fixture
def world_with():
    def make(settings: dict, starts="random", seed: int = 0) -> World:
        config = override(EnvConfig(map=MAP, robots=1), {**QUIET, **settings})
        world = World(config, load_map(MAP))
        world.reset(seed, starts)
        world.sense()
        return world

    return make


def test_each_door_of_a_generated_office_is_found_between_free_floor():
    plan = load_map(MAP)
    doorways = doorways_of(plan)
    widths = np.hypot(*(doorways[:, 2:] - doorways[:, :2]).T)
    assert len(doorways) >= len([room for room in plan.rooms if room.name.split()[0].isdigit()])
    assert (widths >= WIDTH_MIN_M).all() and (widths <= WIDTH_MAX_M).all()
    assert plan.cells().is_free(0.5 * (doorways[:, :2] + doorways[:, 2:])).all()


def test_legs_have_the_width_of_the_table_and_sides_close():
    legs, sides = legs_of((1.2, 0.7), 0.06), sides_of((1.2, 0.7))
    assert np.abs(legs[:, [0, 2]]).max() == pytest.approx(0.6) and np.abs(legs[:, [1, 3]]).max() == pytest.approx(0.35)
    assert np.array_equal(sides[:, 2:], np.roll(sides[:, :2], -1, axis=0))


def test_doors_open_and_close_within_a_second_and_a_half(world_with):
    world = world_with(DOORS)
    doors, seen = world.clutter._doors, []
    for _ in range(400):
        world.tick(np.zeros((1, 2)))
        seen.append(doors[:, ANGLE].copy())
    angles = np.array(seen)
    assert len(doors) >= 5 and (angles.min(axis=0) < 0.01).all() and (angles.max(axis=0) > OPEN_RAD - 0.01).all()
    assert np.abs(np.diff(angles, axis=0)).max() <= OPEN_RAD / 15 + 1e-9


def test_open_doors_do_not_stand_in_a_narrow_corridor():
    plan = load_map("gen:office:400:7")  # its corridor, 1.8 m wide, lies between y = 6.5 and 8.3 m
    world = World(override(EnvConfig(map=plan.name, robots=1), {"clutter.door_share": 1.0}), plan)
    world.reset(0)
    leaves = world.clutter.open_leaves
    assert len(leaves) >= 15 and not ((leaves[:, 3] > 6.6) & (leaves[:, 3] < 8.2)).any()


@pytest.mark.parametrize("number", [0, 505, 520])
def test_open_doors_opposite_each_other_leave_the_way_between_them(number):
    plan = load_map(f"gen:office:400:{number}")
    world = World(override(EnvConfig(map=plan.name, robots=1), {"clutter.door_share": 1.0}), plan)
    world.reset(0)
    leaves = world.clutter.open_leaves
    shares = np.linspace(0.0, 1.0, 50)[:, None, None]
    points = leaves[:, :2] + shares * (leaves[:, 2:] - leaves[:, :2])  # (50, doors, 2)
    for i, (x, y) in enumerate((leaves[:, 2:] - leaves[:, :2]).tolist()):
        beyond = (points - leaves[i, :2]) @ (x, y) > 0.1 * math.hypot(x, y)  # on this side of its wall
        is_opposite = (leaves[:, 2:] - leaves[:, :2]) @ (x, y) < -0.1
        away_m = np.hypot(*np.moveaxis(points[:, None] - points[None, :, [i]], -1, 0)).min(axis=1)
        assert (away_m[beyond & is_opposite] > 0.9).all()
    assert len(leaves) >= 10


def test_furniture_leaves_passages_and_keeps_away_from_robots(world_with):
    world = world_with(FURNITURE, "random")
    clutter = world.clutter
    middles = np.array([poses[0, :2] for poses in clutter._poses])
    assert len(middles) > 10
    apart = np.hypot(*(middles[:, None] - middles[None]).transpose(2, 0, 1)) + 10 * np.eye(len(middles))
    assert apart.min() > PASSAGE_M
    assert np.hypot(*(clutter.rims[:, :2] - world.poses_home[0, :2]).T).min() > 0.5


def test_a_robot_stops_before_a_chair_that_it_may_not_see_and_drives_away(world_with):
    for share in (0.0, 1.0):
        config = {"clutter.furniture": 1, "clutter.hidden_share": share}
        world = world_with(config)
        clutter = world.clutter
        x, y, _ = world.poses_home[0]
        clutter.rims[:] = clutter.rims[:1] + 100.0
        clutter.rims[0] = x + 0.5 * math.cos(world.poses_home[0, 2]), y + 0.5 * math.sin(world.poses_home[0, 2]), 0, 0
        clutter.rims[0, 2:] = clutter.rims[0, :2] + 0.01
        touched = False
        for _ in range(20):
            world.tick(np.array([[1.0, 0.0]]))
            touched |= bool(world.contacts[0])
        gone = math.dist(world.poses_home[0, :2], (x, y))
        assert touched and 0.1 < gone <= 0.31
        for _ in range(5):
            world.tick(np.array([[-1.0, 0.0]]))
        assert math.dist(world.poses_home[0, :2], (x, y)) < gone - 0.1


@pytest.mark.parametrize("scanner", ["ideal", "lms-200", "rplidar-a1"])
def test_scanners_see_furniture_nearer_than_walls_but_none_below_their_plane(world_with, scanner):
    ranges = {}
    for share in (None, 0.0, 1.0):
        settings = {"lidar.preset": scanner, "lidar.dark_share": 0.0, "lidar.range_noise_per_m": 0.0}
        if share is not None:
            settings |= FURNITURE | {"clutter.hidden_share": share}
        world = world_with(settings)
        ranges[share] = np.array([world.tick(np.array([[0.0, 1.5]])).ranges_m[0] for _ in range(40)])
    assert np.array_equal(ranges[1.0], ranges[None])
    assert (ranges[0.0] <= ranges[None] + 1e-9).all() and (ranges[0.0] < ranges[None] - 0.3).sum() >= 2


def test_both_ways_of_casting_beams_see_the_same_furniture(world_with):
    plain = world_with(FURNITURE)
    other = world_with(FURNITURE | {"lidar.mount_yaw_rad": 1e-9})
    assert other._scanners is not None and plain._scanners is None
    assert np.allclose(plain.sense().ranges_m, other.tick(np.zeros((1, 2))).ranges_m, atol=1e-6)


def test_signals_weaken_behind_a_leaf(world_with):
    world = world_with(DOORS)
    leaves = world._bodies[: len(world.clutter._doors)]
    assert (leaves[:, 3] == 3.5).all() and np.isinf(leaves[:, 4]).all()
    assert (
        world._radio.mean_rssi_dbm(world.poses_home[0, :2], leaves).sum()
        <= world._radio.mean_rssi_dbm(world.poses_home[0, :2]).sum()
    )


def test_covered_floor_is_not_scored_and_the_true_map_has_none_of_it(world_with):
    world, bare = world_with(DOORS | FURNITURE), world_with({})
    cells, plain = world.cells, bare.cells
    assert bare.clutter is None and plain is bare.plan.cells()
    assert np.array_equal(cells.wall, plain.wall) and np.array_equal(cells.free | cells.unscored, plain.free)
    assert not cells.is_free(world.clutter.rims[:, :2]).any()
    assert 0.02 < cells.unscored.sum() / plain.free.sum() < 0.3


def test_pieces_are_pushed_at_the_set_rate_and_not_onto_robots(world_with):
    world = world_with(FURNITURE | {"clutter.moves_per_min": 10.0})
    clutter, before, moved = world.clutter, world.clutter.rims.copy(), 0
    for _ in range(300):
        world.tick(np.zeros((1, 2)))
        moved += int((clutter.rims != before).any(axis=1).sum() > 0)
        before = clutter.rims.copy()
    several = sum(len(poses) > 1 for poses in clutter._poses)
    assert several >= 5 and 0.3 * 5 * several < moved
    assert np.hypot(*(clutter.rims[:, :2] - world.poses_home[0, :2]).T).min() > 0.2


def test_what_one_dial_does_changes_no_draw_of_another(world_with):
    alone, both = world_with(FURNITURE), world_with(FURNITURE | {"people.count": 5})
    assert np.array_equal(alone.clutter.rims, both.clutter.rims)
    without, among = world_with({"people.count": 5}), world_with(FURNITURE | {"people.count": 5})
    assert np.array_equal(without.crowd.bodies, among.crowd.bodies)


def test_people_do_not_gather_behind_open_doors():
    plan, settings = load_map("gen:office:400:6"), {"clutter.door_share": 0.8, "people.count": 10}
    world = World(override(EnvConfig(map=plan.name, robots=1), {**settings, "people.walking_share": 1.0}), plan)
    world.reset(7)
    world.sense()
    places = []
    for step in range(2000):
        world.tick(np.zeros((1, 2)))
        if step % 100 == 0:
            places.append(world.crowd.bodies.copy())
    moved_m = np.hypot(*np.diff(places, axis=0).transpose(2, 0, 1))
    assert (moved_m < 0.3).mean() < 0.25  # within 10 s; 0.4 where ways lead through open leaves


@pytest.fixture
def swung_door():
    """When a door opens or closes [s]: it stays closed for 50 s and open for 60 s, then for 5 and 6 s. Somebody walks
    before it from the first to the second time of the visit."""

    def times_s(starts_open: bool, count: int, visit_s: tuple[float, float] = (0.0, 0.0)) -> list[float]:
        doors, times, used = np.zeros((1, COLUMNS)), np.array([[50.0, 60.0, 5.0, 6.0]]), np.zeros(1, np.int64)
        doors[0, LENGTH], doors[0, SIDE] = 0.9, 1.0
        if starts_open:
            doors[0, ANGLE] = doors[0, GOAL] = OPEN_RAD
        doors[0, LEFT_S] = times[0, int(starts_open)]
        nobody, rims, changes, step = np.zeros((0, 2)), np.zeros((1, 4)), [], 0
        while len(changes) < count:
            step += 1
            goal = doors[0, GOAL]
            walkers = np.array([[0.5, 1.0]]) if visit_s[0] < 0.1 * step <= visit_s[1] else nobody
            swing(doors, times, used, walkers, np.zeros((0, 3)), np.zeros(0), 0.1, rims.copy(), rims)
            if doors[0, GOAL] != goal:
                changes.append(0.1 * step)
        return changes

    return times_s


def test_a_door_uses_each_of_its_times_once(swung_door):
    assert np.diff(swung_door(False, 4), prepend=0.0) == pytest.approx([50.0, 60.0, 5.0, 6.0], abs=0.11)
    assert np.diff(swung_door(True, 3), prepend=0.0) == pytest.approx([60.0, 5.0, 6.0], abs=0.11)


def test_a_door_that_somebody_opened_closes_three_seconds_later(swung_door):
    opened, closed, opened_again = swung_door(False, 3, (0.55, 0.65))
    assert (opened, closed) == pytest.approx((0.6, 3.6), abs=0.11)
    assert opened_again - closed == pytest.approx(5.0, abs=0.11)  # the closed time that was cut short is over
    assert swung_door(True, 1, (0.55, 0.65))[0] == pytest.approx(60.0, abs=0.11)  # it was open anyway
    assert swung_door(True, 1, (58.0, 59.0))[0] == pytest.approx(62.0, abs=0.11)
