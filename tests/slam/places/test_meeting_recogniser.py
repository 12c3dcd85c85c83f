"""Robots without a common map are compared by WiFi fingerprints, more rarely after rejections."""

import numpy as np
import pytest

from twc_env.config import PlaceRecognitionConfig
from twc_env.records.messages import LoopClosure
from twc_env.slam.places.meeting_recogniser import (
    CANDIDATES_MAX,
    REST_M,
    RESTS_MAX,
    SHARED_MIN,
    SILENT_STEP_M,
    MeetingRecogniser,
)

MACS = tuple(range(12))
HERE, ELSEWHERE = np.linspace(-70.0, -40.0, 12), np.linspace(-40.0, -70.0, 12)


@pytest.fixture
def recogniser():
    return MeetingRecogniser(PlaceRecognitionConfig(), robot_count=3)


@pytest.fixture
def place(keyframe):
    """A keyframe with a fingerprint, after `travel_m` metres."""

    def make(robot, travel_m, rssi_dbm=HERE, macs=MACS):
        return keyframe(robot, int(10 * travel_m), travel_m=float(travel_m), macs=macs, rssi_dbm=rssi_dbm)

    return make


def end(candidate, status) -> LoopClosure:
    return LoopClosure(candidate, np.zeros(3), np.eye(3), 0.9, status)


def test_robots_of_two_maps_are_compared_where_fingerprints_are_similar(recogniser, place):
    assert recogniser.propose(place(0, 0.0), (0,)) == []
    assert recogniser.propose(place(1, 0.0, ELSEWHERE), (1,)) == []
    (found,) = recogniser.propose(place(2, 0.0, HERE + 1.0), (2,))
    assert (found.target, found.source, found.recogniser) == ((0, 0), (2, 0), "meeting")


@pytest.mark.parametrize("heard", [SHARED_MIN - 1, SHARED_MIN])
def test_few_shared_access_points_give_no_candidate(recogniser, place, heard):
    recogniser.propose(place(0, 0.0, HERE[:heard], MACS[:heard]), (0,))
    assert len(recogniser.propose(place(1, 0.0, HERE[:heard], MACS[:heard]), (1,))) == (heard >= SHARED_MIN)


def test_robots_of_one_map_are_not_compared_but_stored(recogniser, place):
    recogniser.propose(place(0, 0.0), (0, 1))
    assert recogniser.propose(place(1, 0.0), (0, 1)) == []
    assert len(recogniser.propose(place(2, 0.0), (2,))) == 2
    assert recogniser.propose(place(0, 5.0), (0, 1, 2)) == []


def test_candidates_are_the_most_similar_places_in_order_of_similarity(recogniser, place):
    off_db = {0: 2.0, 1: 0.5, 2: 3.0, 3: 1.0, 4: 2.5}
    for travel_m, off in off_db.items():
        recogniser.propose(place(0, travel_m, HERE + off), (0,))
    found = recogniser.propose(place(1, 0.0), (1,))
    assert [candidate.target[1] // 10 for candidate in found] == sorted(off_db, key=off_db.get)[:CANDIDATES_MAX]


def refuse_next(recogniser, place, from_m: int, rssi_dbm=HERE) -> float:
    """Travel of robot 1 at its next comparison with robot 0, whose match is then rejected."""
    for travel_m in range(from_m, from_m + 200):
        found = recogniser.propose(place(1, travel_m, rssi_dbm), (1,))
        if found:
            assert len(found) == 1, "after a rejection only one place of the robot is proposed"
            recogniser.note(end(found[0], "rejected"))
            return travel_m
    raise AssertionError("never compared again")


def test_the_waiting_distance_of_two_robots_doubles_with_each_rejection(place):
    recogniser = MeetingRecogniser(PlaceRecognitionConfig(), robot_count=2)
    for travel_m in range(3):
        recogniser.propose(place(0, travel_m), (0,))
    recogniser.note(end(recogniser.propose(place(1, 0.0), (1,))[0], "rejected"))
    at = [0.0]
    for _ in range(RESTS_MAX + 1):
        at.append(refuse_next(recogniser, place, int(at[-1]) + 1))
    doubled = [REST_M * 2**k for k in range(RESTS_MAX)]
    assert np.diff(at).tolist() == [*doubled, doubled[-1]]


def test_a_rejection_delays_only_the_two_robots_concerned(recogniser, place):
    for robot in (0, 1):
        recogniser.propose(place(robot, 0.0), (0, 1))
    recogniser.note(end(recogniser.propose(place(2, 0.0), (1, 2))[0], "rejected"))
    (found,) = recogniser.propose(place(2, 1.0), (2,))
    assert found.target == (1, 0)


def test_an_accepted_match_ends_the_wait(recogniser, place):
    for travel_m in range(3):
        recogniser.propose(place(0, travel_m), (0,))
    found = recogniser.propose(place(1, 0.0), (1,))
    for candidate, status in zip(found, ("rejected", "rejected", "accepted"), strict=True):
        recogniser.note(end(candidate, status))
    assert len(recogniser.propose(place(1, 1.0), (1,))) == CANDIDATES_MAX


def test_without_similar_places_comparisons_become_rarer(recogniser, place):
    recogniser.propose(place(0, 0.0), (0,))
    assert recogniser.propose(place(1, 0.0, ELSEWHERE), (1,)) == []
    heard = [bool(recogniser.propose(place(1, travel_m), (1,))) for travel_m in (1.0, 2.0, 3.0, 4.0)]
    assert heard == [travel_m >= SILENT_STEP_M for travel_m in (1.0, 2.0, 3.0, 4.0)]


@pytest.mark.parametrize("compared", [(), (1,)])
def test_removed_places_give_no_candidates(recogniser, place, compared):
    for travel_m in range(3):
        recogniser.propose(place(0, travel_m), (0,))
    for robot in compared:
        recogniser.propose(place(robot, 0.0), (robot,))
    recogniser.propose(place(0, 3.0), (0,))
    recogniser.sparsify(lambda keyframe: keyframe.travel_m >= 2.0)
    found = recogniser.propose(place(2, 0.0), (2,))
    assert sorted(candidate.target for candidate in found) == [(0, 20), (0, 30)]
