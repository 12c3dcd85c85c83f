"""Where others are likely to be, by the access points that both have heard."""

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from twc_env.planning import Whereabouts, whereabouts
from twc_env.records.messages import Fingerprint, RadioTrail

PATH_M = np.array([[x, 0.0] for x in range(8)] + [[7.0, y] for y in range(1, 7)], float)
AHEAD_M = np.array([[14.0 + x, 5.0] for x in range(5)])
"""Twelve metres east of the path's end, in the same frame."""
CORNERS_M = np.array([[7.0, 12.0], [-6.0, 3.0], [3.0, -7.0], [0.0, 9.0]])


def trail(places_m, robots, offset_db=0.0, seed=0):
    """What is heard along a path of twelve transmitters around both paths, by log-distance path loss and 2 dB."""
    random = np.random.default_rng(seed)
    boxes_m = np.random.default_rng(9).uniform((-8.0, -10.0), (25.0, 15.0), (12, 2))
    apart_m = np.hypot(*(places_m[:, None] - boxes_m[None]).transpose(2, 0, 1))
    rssi_dbm = -30.0 - 38.5 * np.log10(np.maximum(apart_m, 1.0)) + random.normal(0.0, 2.0, apart_m.shape) + offset_db
    heard = [Fingerprint(np.flatnonzero(row > -85.0), row[row > -85.0]) for row in rssi_dbm]
    return RadioTrail(robots, places_m, tuple(heard))


def test_a_path_is_expected_where_its_fingerprints_fit():
    found = whereabouts(trail(PATH_M, (0,)), trail(AHEAD_M, (1,), seed=1))
    assert found.share.sum() == pytest.approx(1.0)
    centre_m = found.share @ found.cells_m
    assert np.hypot(*(centre_m - AHEAD_M.mean(axis=0))) < 4.0


def test_the_nearest_of_several_places_is_told():
    found = whereabouts(trail(PATH_M, (0,)), trail(AHEAD_M, (1,), seed=1))
    places_m = np.vstack([CORNERS_M, [[10.0, 6.0]]])
    assert np.argmin(found.distance_m(places_m)) == len(CORNERS_M)


def test_only_strengths_count_and_not_the_frame_of_the_others():
    other = trail(AHEAD_M, (1,), seed=1)
    moved = RadioTrail(other.robots, other.places_m[:, ::-1] + 100.0, other.fingerprints)
    own = trail(PATH_M, (0,))
    assert np.array_equal(whereabouts(own, other).share, whereabouts(own, moved).share)


def test_transmitters_that_the_others_do_not_hear_say_that_they_are_far_from_them():
    own = trail(PATH_M, (0,))
    deaf = RadioTrail((1,), np.zeros((1, 2)), (Fingerprint(np.zeros(0, np.int64), np.zeros(0)),))
    found = whereabouts(own, deaf)
    assert found.distance_m(PATH_M).min() > whereabouts(own, own).distance_m(PATH_M).max()
    anywhere = Whereabouts(found.cells_m, np.full(len(found.share), 1.0 / len(found.share)))
    assert (found.distance_m(PATH_M) > anywhere.distance_m(PATH_M) + 1.0).all()


def test_a_robot_that_heard_nothing_knows_nothing():
    silent = RadioTrail((0,), np.zeros((1, 2)), (Fingerprint(np.zeros(0, np.int64), np.zeros(0)),))
    assert whereabouts(silent, trail(AHEAD_M, (1,))) is None
    unknown = RadioTrail((0,), np.zeros((0, 2)), ())
    assert whereabouts(unknown, trail(AHEAD_M, (1,))) is None
    assert whereabouts(trail(AHEAD_M, (1,)), unknown) is None


def test_the_result_does_not_depend_on_the_threads_of_matrix_libraries():
    random = np.random.default_rng(3)
    macs = np.arange(90)
    told = [
        RadioTrail(
            (k,), 9.0 * random.random((40, 2)), tuple(Fingerprint(macs, -90 * random.random(90)) for _ in range(40))
        )
        for k in range(2)
    ]
    found = []
    for count in (1, 2):
        with threadpool_limits(count, user_api="blas"):
            found.append(whereabouts(*told).share.tobytes())
    assert found[0] == found[1]
