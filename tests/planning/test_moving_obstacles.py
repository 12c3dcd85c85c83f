import math
from types import SimpleNamespace

import numpy as np
import pytest

from twc_env.config import DynamicsConfig
from twc_env.planning import MovingObstacles
from twc_env.planning.moving_obstacles import LEG_M, PERSON_M_S, REACTION_S
from twc_env.records.messages import GridMap

BEAMS, NOBODY = 180, np.zeros((0, 2))


def scan_with(places, room_m=3.0, radius_m=0.06, heading=0.0):
    """(beams,) ranges in a round room around the robot with legs at places (x, y), for a robot turned by heading."""
    angles = heading + 2 * math.pi * np.arange(BEAMS) / BEAMS
    ranges = np.full(BEAMS, room_m)
    for x, y in places:
        along, aside = x * np.cos(angles) + y * np.sin(angles), x * np.sin(angles) - y * np.cos(angles)
        hits = (np.abs(aside) < radius_m) & (along > 0)
        ranges[hits] = along[hits] - np.sqrt(radius_m**2 - aside[hits] ** 2)
    return ranges


def limit_m_s(scans, speed_m_s=0.5, teammates_m=NOBODY, headings=None):
    """Greatest speed of the robot at the last of these scans."""
    obstacles = MovingObstacles(DynamicsConfig())
    for k, ranges in enumerate(scans):
        pose = np.array([0.0, 0.0, 0.0 if headings is None else headings[k]])
        found = obstacles.limit_m_s(pose, ranges, speed_m_s, teammates_m)
    return found


def waits(*scans, **others):
    return limit_m_s(*scans, **others) < 0.5


def approaching(sign=1.0):
    return [scan_with([(sign * (1.6 - 0.1 * k), 0.1), (sign * (1.6 - 0.1 * k), -0.1)]) for k in range(8)]


def test_a_robot_waits_for_somebody_who_comes_nearer():
    assert waits(approaching())


def test_the_nearer_somebody_is_the_slower_it_drives_until_it_stands():
    scans = approaching()
    limits = [limit_m_s(scans[:k]) for k in range(1, 9)]  # 1.5 to 0.9 m from the centre
    assert limits[0] == math.inf and 0.3 < limits[-1] < 0.7 and (np.diff(limits[3:]) < 0.0).all()
    assert limit_m_s([scan_with([(1.2 - 0.1 * k, 0.0)]) for k in range(8)]) == 0.0
    scans = [scan_with([(1.6 - 0.1 * k, 0.0)]) for k in range(8)]
    dynamics, limit = DynamicsConfig(), limit_m_s(scans)  # stands when the body has come to the rim, by its own brake
    took_s = REACTION_S + limit / dynamics.acceleration_max_m_s2
    driven_m = limit * REACTION_S + limit**2 / (2.0 * dynamics.acceleration_max_m_s2)
    leg_m = scans[-1].min() - dynamics.robot_radius_m - LEG_M
    assert driven_m + PERSON_M_S * took_s == pytest.approx(leg_m, abs=1e-6)


@pytest.mark.parametrize("place", [(0.8, 0.1), (0.5, -0.4)])
def test_legs_that_stand_are_an_obstacle_like_others(place):
    assert not waits([scan_with([place])] * 8)


def test_a_turning_robot_does_not_take_standing_legs_for_moving_ones():
    headings = [0.15 * k for k in range(8)]
    assert not waits([scan_with([(0.8, 0.1)], heading=h) for h in headings], headings=headings)


def test_who_moves_behind_does_not_matter_until_the_robot_backs_up():
    assert not waits(approaching(-1.0)) and waits(approaching(-1.0), speed_m_s=-0.5)


def test_teammates_do_not_count():
    assert not waits(approaching(), teammates_m=np.array([[0.9, 0.0]]))


def test_wide_things_are_walls_that_come_into_view():
    opened = np.full(BEAMS, 3.0)
    closed = opened.copy()
    closed[:40] = 1.0
    assert not waits([opened] * 4 + [closed] * 4)


def test_a_robot_goes_on_soon_after_they_left():
    assert not waits(approaching() + [scan_with([])] * 10)


def test_a_robot_stands_beside_legs_while_somebody_else_walks_by():
    beside, walks = (0.1, 0.4), [(1.2, 0.6 - 0.15 * k) for k in range(8)]
    assert limit_m_s([scan_with([place]) for place in walks]) > 0.0
    assert limit_m_s([scan_with([place, beside]) for place in walks]) == 0.0
    assert limit_m_s([scan_with([beside])] * 8) == math.inf
    gone = [scan_with([beside])] * 30  # for two seconds after
    found = [limit_m_s([*(scan_with([place, beside]) for place in walks), *gone[:k]]) for k in (10, 19, 30)]
    assert found == [0.0, 0.0, math.inf]


def test_the_frame_of_a_door_is_nobody_beside_the_robot():
    cell = np.zeros((40, 40), np.int16)
    cell[24, 21] = 50  # a wall at (0.1 to 0.2, 0.4 to 0.5)
    limits = []
    for log_odds in (cell, 0 * cell):
        obstacles = MovingObstacles(DynamicsConfig())
        for k in range(8):
            belief = SimpleNamespace(
                pose_odom=np.zeros(3), pose_map_robot=np.zeros(3), teammates={},
                ranges_m=scan_with([(1.2, 0.6 - 0.15 * k), (0.15, 0.43)]),
                grid=GridMap(log_odds, np.array([-2.0, -2.0]), 0.1),
            )  # fmt: skip
            limits.append(obstacles.limited(belief, 0.5))
    assert limits[7] > 0.0 and limits[-1] == 0.0


def test_a_robot_that_people_have_come_close_to_drives_to_where_they_are_not():
    walks = [(-0.1 - 0.02 * k, 0.9 - 0.08 * k) for k in range(8)]  # up to its side, a little behind
    assert limit_m_s([scan_with([place]) for place in walks]) == math.inf
    assert limit_m_s([scan_with([place]) for place in walks], speed_m_s=-0.5) == 0.0


def test_of_a_speed_only_the_share_towards_somebody_is_limited():
    ahead, aside = (
        [scan_with([(far * c, far * s)]) for far in np.linspace(1.6, 0.9, 8)] for c, s in ((1, 0), (0.5, 0.866))
    )
    assert limit_m_s(aside) == pytest.approx(2.0 * limit_m_s(ahead), rel=0.1)


def panes(count, random, share=0.3):
    """Scans of a pane 0.8 m ahead, 0.7 m wide, which returns a share of the beams, in front of walls 3 m away."""
    angles = 2 * math.pi * np.arange(BEAMS) / BEAMS
    x, y = np.cos(angles), np.sin(angles)
    is_pane = (x > 0.0) & (np.abs(0.8 * y / np.where(x > 0.0, x, 1.0)) < 0.35)
    return [
        np.where(is_pane & (random.random(BEAMS) < share), 0.8 / np.where(is_pane, x, 1.0), 3.0) for _ in range(count)
    ]


def test_glass_that_comes_and_goes_in_one_place_is_no_person():
    """It is one for the first seconds, and where nobody expects glass; who comes nearer beside it is one still."""
    scans, pose = panes(80, np.random.default_rng(0)), np.zeros(3)
    expecting, other = MovingObstacles(DynamicsConfig(), has_glass=True), MovingObstacles(DynamicsConfig())
    limits = np.array([[each.limit_m_s(pose, scan, 0.5, NOBODY) for each in (expecting, other)] for scan in scans])
    assert (limits[1:40] < 0.5).all()
    assert (limits[50:, 0] == math.inf).all() and (limits[50:, 1] < 0.5).all()
    for k, scan in enumerate(panes(8, np.random.default_rng(1))):
        limit = expecting.limit_m_s(pose, np.minimum(scan, scan_with([(1.2 - 0.1 * k, 0.6)])), 0.5, NOBODY)
    assert limit < 0.5


def test_people_who_walk_by_one_after_the_other_stay_people():
    obstacles, limits = MovingObstacles(DynamicsConfig(), has_glass=True), []
    for _ in range(3):
        for k in range(30):
            limits.append(obstacles.limit_m_s(np.zeros(3), scan_with([(0.7, 1.5 - 0.13 * k)]), 0.5, NOBODY))
    passing = np.array(limits).reshape(3, 30).min(axis=1)
    assert (passing == passing[0]).all() and passing[0] < 0.5
