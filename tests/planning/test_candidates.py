"""Views that a robot may choose, on maps that can be checked by hand."""

import numpy as np

from twc_env.config import DynamicsConfig
from twc_env.planning import PathFinder, Terrain, ViewGain, can_tell_places, find_views
from twc_env.planning.candidates import APART_M, DECAY_PER_M, SPENT_M
from twc_env.planning.drivers import Drivers
from twc_env.records.messages import Belief, GridMap

CELL_M, RANGE_M = 0.1, 3.0
NONE = np.zeros((0, 2))


def corridor(known_m: float = 6.0) -> GridMap:
    """A corridor of 12 x 2 m between walls, of which the first metres are known, with an unknown room of 3 x 3 m beside
    a door at 2 m."""
    log_odds = np.zeros((70, 120), np.int16)
    log_odds[20:40, : round(known_m / CELL_M)] = -50
    log_odds[18:20, : round(known_m / CELL_M)] = log_odds[40:42, : round(known_m / CELL_M)] = 50
    log_odds[20:40, 0] = 50
    log_odds[40:42, 15:25] = -50
    return GridMap(log_odds, np.zeros(2), CELL_M)


def belief_of(grid: GridMap, pose=(1.0, 3.0, 0.0), robot=0, teammates=None, version=0, **more) -> Belief:
    return Belief(
        robot, 0, np.array(pose), grid, teammates or {}, ranges_m=np.full(36, 3.0), map_version=version, **more
    )


def views_of(belief: Belief, claimed_m=NONE, spent_m=NONE, slots=8):
    return find_views(belief, Terrain.of(belief, 0.2), PathFinder(), slots, RANGE_M, claimed_m, spent_m)


def test_the_best_view_comes_first_and_views_lie_apart():
    belief = belief_of(corridor())
    found = views_of(belief)
    worth = found.gains_m2 * np.exp(-DECAY_PER_M * found.lengths_m)
    assert found.are_views and len(worth) >= 2 and np.all(np.diff(worth) <= 0.0)
    away = np.hypot(*(found.frontiers_m[:, None] - found.frontiers_m[None]).transpose(2, 0, 1))
    assert away[~np.eye(len(away), dtype=bool)].min() >= APART_M
    assert np.allclose(
        found.gains_m2, ViewGain(Terrain.of(belief, 0.2), RANGE_M, closes_walls=True).area_m2(found.frontiers_m)
    )
    assert np.hypot(*(found.frontiers_m[0] - (2.0, 4.0))) < 1.5  # the door of the room is near, the end of the way far
    assert views_of(belief_of(corridor(), (5.0, 3.0, 0.0))).frontiers_m[0, 0] > 4.5


def test_what_others_go_to_see_and_what_was_seen_is_not_offered():
    belief = belief_of(corridor())
    best = views_of(belief).frontiers_m[0]
    claimed = views_of(belief, claimed_m=best[None])
    assert claimed.frontiers_m[0, 0] > 4.0
    spent = views_of(belief, spent_m=best[None])
    assert np.hypot(*(spent.frontiers_m - best).T).min() >= SPENT_M


def test_without_a_view_worth_its_way_the_frontiers_are_left():
    belief = belief_of(corridor())
    everything = np.stack(np.meshgrid(np.arange(0.0, 12.0, 0.4), np.arange(0.0, 7.0, 0.4)), -1).reshape(-1, 2)
    found = views_of(belief, claimed_m=everything)
    assert len(found.lengths_m) >= 2 and np.all(found.sizes_m > 0.0) and np.all(np.diff(found.lengths_m) >= 0.0)
    known = GridMap(np.where(corridor().log_odds < 0, -50, 50).astype(np.int16), np.zeros(2), CELL_M)
    assert len(views_of(belief_of(known)).frontiers_m) == 0


def test_a_goal_is_known_in_the_map_in_which_it_was_set():
    drivers, goal_m = Drivers([DynamicsConfig()], PathFinder()), np.array([5.5, 3.0])
    drivers.start(0, goal_m, belief_of(corridor()))
    assert np.array_equal(drivers.goals_m, goal_m[None]) and drivers.is_of(0, belief_of(corridor()))
    assert not drivers.is_of(0, belief_of(corridor(), version=1))


def test_robots_tell_places_in_contact_and_in_the_same_frame():
    grid, here = corridor(), np.zeros(3)
    mine = belief_of(grid, robot=1, teammates={2: here}, contact_steps={2: 0})
    assert can_tell_places(belief_of(grid, robot=2, teammates={1: here}), mine)
    assert not can_tell_places(belief_of(grid, robot=2, teammates={0: here, 1: here}), mine)  # begins with robot 0
    assert not can_tell_places(belief_of(grid, robot=3), mine)
    silent = belief_of(grid, robot=1, teammates={2: here}, contact_steps={2: -5})
    assert not can_tell_places(belief_of(grid, robot=2, teammates={1: here}), silent)
