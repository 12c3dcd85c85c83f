"""Selection and verification of loop candidates."""

import numpy as np
import pytest

from twc_env.config import EnvConfig
from twc_env.records.messages import LoopCandidate, LoopClosure, SignObservation
from twc_env.slam.team import TeamMapper

MACS, LEVELS_DBM = (1, 2, 3, 4), np.full(4, -50.0)
LOOSE, FIRM = np.diag([4.0, 0.001, 0.001]), np.diag([0.001, 0.001, 0.001])


@pytest.mark.parametrize(("covariance", "is_compared"), [(LOOSE, True), (FIRM, False)])
def test_signs_are_compared_in_a_corridor_although_its_walls_were_matched(
    keyframe, scan, walls, covariance, is_compared
):
    corridor, mapper = walls((-40.0, -1.0), (40.0, -1.0), (40.0, 1.0), (-40.0, 1.0)), TeamMapper(EnvConfig(), 2)

    def made(robot, index, x, is_by_sign):
        signs = [SignObservation("LIBRARY", np.array([1.0 - x, 1.0]), -np.pi / 2)] if is_by_sign else []
        return keyframe(robot, index, (x, 0.0, 0.0), x, scan(corridor, (x, 0.0, 0.0)), signs, MACS, LEVELS_DBM)

    mapper.give_starts(np.zeros((2, 3)))
    mapper.update(0, [made(0, 0, 0.0, True), made(1, 0, 0.0, False)])
    near = LoopCandidate((0, 0), (1, 0), np.zeros(3), "proximity")
    mapper._search.note_accepted(LoopClosure(near, np.zeros(3), covariance, 1.0, "accepted"))
    mapper.update(1, [made(1, 1, 1.0, True)])
    assert [closure.candidate.recogniser for closure in mapper.closures] == ["twc"] * is_compared


def looked_at(scan_m, keyframe, recogniser, is_one_map=False) -> LoopClosure:
    """The closure that results from a candidate between two robots with equal scans."""
    mapper = TeamMapper(EnvConfig(), 2)
    mapper.update(0, [keyframe(robot, 0, (0.0, 0.0, 0.0), 0.0, scan_m) for robot in (0, 1)])
    if is_one_map:
        mapper._maps.merge(0, 1, np.zeros(3))
    mapper._search._waiting[recogniser].append(LoopCandidate((0, 0), (1, 0), np.array([0.1, 0.0, 0.0]), recogniser))
    mapper._search.waiting_count = 1
    mapper.update(1, [keyframe(0, 1, (0.0, 0.0, 0.0), 0.0, scan_m)])
    (closure,) = mapper.closures
    assert closure.pose_target_source == pytest.approx(0.0, abs=0.05) and not closure.is_loose
    return closure


@pytest.mark.parametrize(("recogniser", "status"), [("wifi", "pending"), ("proximity", "accepted")])
@pytest.mark.parametrize("is_end_seen", [False, True])
def test_robots_do_not_constrain_the_position_along_a_corridor(keyframe, scan, walls, is_end_seen, status, recogniser):
    corridor = walls((-40.0, -0.6), (3.0 if is_end_seen else 40.0, -0.6), (3.0, 0.6), (-40.0, 0.6))
    teammate = np.concatenate([corridor, walls((-0.8, -0.15), (-0.5, -0.15), (-0.5, 0.15), (-0.8, 0.15))])
    closure = looked_at(scan(teammate, (0.0, 0.0, 0.0)), keyframe, recogniser, is_one_map=recogniser == "proximity")
    assert closure.status == (status if is_end_seen else "rejected")
    assert ("robots" in closure.reason) is not is_end_seen


def test_scans_that_show_only_robots_are_rejected(keyframe, scan, walls):
    others = [walls((x, y), (x + 0.3, y), (x + 0.3, y + 0.3), (x, y + 0.3)) for x, y in ((0.5, 0.4), (-0.6, 0.5))]
    closure = looked_at(scan(np.concatenate(others), (0.0, 0.0, 0.0)), keyframe, "wifi")
    assert closure.status == "rejected" and "robots" in closure.reason


@pytest.mark.parametrize(("waiting", "verified"), [(10, 2), (63, 2), (320, 10)])
def test_the_number_of_candidates_verified_per_step_grows_with_the_queue(keyframe, scan, walls, waiting, verified):
    mapper, room = TeamMapper(EnvConfig(), 2), scan(walls((-3, -2), (3, -2), (3, 2), (-3, 2)), (0.0, 0.0, 0.0))
    mapper.update(0, [keyframe(robot, 0, (0.0, 0.0, 0.0), 0.0, room) for robot in (0, 1)])
    mapper._search._waiting["wifi"].extend([LoopCandidate((0, 0), (1, 0), np.zeros(3), "wifi")] * waiting)
    mapper._search.waiting_count = waiting
    mapper.update(1, [keyframe(0, 1, (0.0, 0.0, 0.0), 0.0, room)])
    assert len(mapper.closures) == verified


@pytest.mark.parametrize(("ahead_m", "tried"), [(0.5, 1), (5.0, 4)])
def test_candidates_close_to_an_earlier_one_are_not_verified(keyframe, scan, walls, ahead_m, tried):
    """Both robots read the same sign again, `ahead_m` further on."""
    room, mapper = walls((-10.0, -9.0), (10.0, -9.0), (10.0, 9.0), (-10.0, 9.0)), TeamMapper(EnvConfig(), 2)
    for k, x in enumerate((0.0, ahead_m)):
        sign = [SignObservation("LIBRARY", np.array([1.0 - x, 1.0]), -np.pi / 2)]
        seen = [keyframe(r, k, (x, 0.0, 0.0), x, scan(room, (x, 0.0, 0.0)), sign, MACS, LEVELS_DBM) for r in (0, 1)]
        mapper.update(k, seen)
    for step in range(2, 20):
        mapper.update(step, [])
    assert len([c for c in mapper.closures if c.candidate.recogniser == "twc"]) == tried
