"""Scans of a rectangular room, in closed form."""

import math

import numpy as np
import pytest

from twc_env.records.geometry import beam_directions, between
from twc_env.records.messages import UNSEEN_M
from twc_env.slam.scans.scan_continuity import AGREEMENT_MIN, BUMPED_MIN, agreement, continues, is_explained

RANGE_MAX_M = 10.0
ROOM, OTHER_ROOM = (6.0, 4.0), (9.0, 2.5)


def scan_of(room, pose, beams=180):
    """(beams,) ranges from a pose in a room (width, height) whose corner is the origin."""
    angles = pose[2] + 2 * math.pi * np.arange(beams) / beams
    c, s = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        along_x = np.where(c > 0, (room[0] - pose[0]) / c, -pose[0] / c)
        along_y = np.where(s > 0, (room[1] - pose[1]) / s, -pose[1] / s)
    return np.minimum(np.minimum(along_x, along_y), RANGE_MAX_M)


def compared(before, now, motion):
    directions = beam_directions(len(now))
    return (
        continues(before, now, np.array(motion), RANGE_MAX_M, directions),
        agreement(before, now, np.array(motion), RANGE_MAX_M, directions),
    )


@pytest.mark.parametrize("beams", [72, 180, 720])
@pytest.mark.parametrize("motion", [(0.0, 0.0, 0.0), (0.1, 0.0, 0.15), (-0.1, 0.02, -0.3)])
def test_a_scan_continues_the_one_before_by_the_motion_between_them(motion, beams):
    first = np.array([2.0, 1.5, 0.4])
    c, s = math.cos(first[2]), math.sin(first[2])
    second = first + [c * motion[0] - s * motion[1], s * motion[0] + c * motion[1], motion[2]]
    assert between(first, second) == pytest.approx(motion)
    assert compared(scan_of(ROOM, first, beams), scan_of(ROOM, second, beams), motion) == (True, pytest.approx(1.0))


def test_a_scan_of_another_room_does_not():
    is_one, share = compared(scan_of(ROOM, (2.0, 1.5, 0.4)), scan_of(OTHER_ROOM, (7.0, 0.5, 2.0)), (0.05, 0.0, 0.0))
    assert not is_one and share < AGREEMENT_MIN


def test_people_who_come_into_view_do_not_break_it():
    before, now = scan_of(ROOM, (2.0, 1.5, 0.4)), scan_of(ROOM, (2.0, 1.5, 0.4))
    now[10:50] = 0.8
    assert compared(before, now, (0.0, 0.0, 0.0))[0]


def test_a_bump_is_explained_by_the_true_motion_but_not_by_odometry():
    before, now = scan_of(ROOM, (2.0, 1.5, 0.4)), scan_of(ROOM, (2.0, 1.5, 0.9))
    assert not compared(before, now, (0.0, 0.0, 0.0))[0]
    assert compared(before, now, (0.0, 0.0, 0.5))[1] > BUMPED_MIN


def test_after_great_motions_nothing_is_said():
    assert compared(scan_of(ROOM, (2.0, 1.5, 0.4)), scan_of(OTHER_ROOM, (7.0, 0.5, 2.0)), (0.65, 0.0, 0.0))[0]


def test_beams_without_information_do_not_count():
    before, now = scan_of(ROOM, (2.0, 1.5, 0.4)), scan_of(ROOM, (2.0, 1.5, 0.4))
    before[:90] = UNSEEN_M
    assert compared(before, now, (0.0, 0.0, 0.0))[1] == 1.0


def explained(before, now, motion, std_m, std_rad):
    found = np.zeros(3)
    said = is_explained(
        before, now, np.array(motion), std_m, std_rad, RANGE_MAX_M, beam_directions(len(now)), found
    )  # fmt: skip
    return said, found


def test_odometry_that_may_err_by_it_explains_a_turn_that_it_misread():
    before, now = scan_of(ROOM, (2.0, 1.5, 0.4)), scan_of(ROOM, (2.3, 1.5, 0.7))
    read = (0.25, -0.15, 0.05)
    assert not compared(before, now, read)[0]
    said, found = explained(before, now, read, 0.1, 0.1)
    assert said and found[2] == pytest.approx(0.3, abs=0.05)
    assert not explained(before, now, read, 0.01, 0.01)[0]


def test_no_error_of_odometry_explains_another_room():
    before, now = scan_of(ROOM, (2.0, 1.5, 0.4)), scan_of(OTHER_ROOM, (7.0, 0.5, 2.0))
    assert not explained(before, now, (0.05, 0.0, 0.0), 0.1, 0.1)[0]


def test_a_scan_in_a_doorway_continues_the_one_before_it_and_one_of_another_room_does_not():
    """Half of what a scanner that looks ahead sees there was hidden behind the door's walls half a metre before."""
    half = np.arange(360) * math.pi / 180 % (2 * math.pi)
    is_behind = (half > math.pi / 2) & (half < 3 * math.pi / 2)
    before, now = (np.where(is_behind, UNSEEN_M, two_rooms(x, half)) for x in (1.4, 1.9))
    motion = (0.5, 0.0, 0.0)
    is_one, share = compared(before, now, motion)
    assert is_one and share < AGREEMENT_MIN
    other = np.where(is_behind, UNSEEN_M, scan_of((7.0, 1.2), (1.0, 0.6, 0.0), 360))
    assert not compared(before, other, motion)[0]
    assert not compared(before, now, (0.1, 0.0, 0.0))[0]  # so little is new after a tenth of a second


def two_rooms(x, angles):
    """(beams,) ranges from the middle between the walls, 2 m ahead a wall of no thickness with a door of 0.9 m."""
    c, s = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        at_wall = np.where(c > 1e-9, (2.0 - x) / c, np.inf)
        passes = np.abs(at_wall * s) < 0.45
        ends = np.minimum(np.where(c > 0, (6.0 - x) / c, -x / c), 4.0 / np.abs(s))
    return np.minimum(np.where((c > 1e-9) & ~passes, np.minimum(at_wall, ends), ends), RANGE_MAX_M)
