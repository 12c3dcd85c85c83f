import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twc_env.config import LidarConfig, OdometryFilterConfig, VerificationConfig
from twc_env.records.geometry import between, compose
from twc_env.records.messages import LoopCandidate
from twc_env.slam.matching.loop_verification import LoopVerifier
from twc_env.slam.pose_graph.solver import squared_errors

RANGE_MAX_M = 10.0
EDGE = np.array([[0, 1]])
FIRST = [(-2.5, -1.0, 0.0), (-1.5, -1.0, 0.2), (-0.5, -0.6, 0.6), (0.0, 0.3, 1.2)]
SECOND = [(2.5, 2.0, 3.0), (1.5, 1.8, -2.9), (0.5, 1.2, -2.5), (-0.3, 0.6, -2.2)]
TRUE = between(np.array(FIRST[-1]), np.array(SECOND[-1]))


@pytest.fixture(scope="module")
def paths(office, path_of):
    """Keyframes of two robots in one room; `TRUE` is the relative pose of the last ones."""
    return path_of(0, office, FIRST), path_of(1, office, SECOND)


def verify(target_path, source_path, guess, target=-1, source=-1, recogniser="twc", sign_m=None, **rule):
    verifier = LoopVerifier(VerificationConfig(**rule), OdometryFilterConfig(), LidarConfig(range_max_m=RANGE_MAX_M))
    ends = (0, target % len(target_path)), (1, source % len(source_path))
    candidate = LoopCandidate(*ends, np.asarray(guess, float), recogniser, sign_m)
    return verifier.verify(candidate, target_path, source_path)


@settings(max_examples=25)
@given(st.floats(-0.45, 0.45), st.floats(-0.45, 0.45), st.floats(-0.12, 0.12))
def test_a_true_pair_is_accepted_and_accurate_to_three_centimetres(paths, x, y, turn):
    closure = verify(*paths, compose(TRUE, [x, y, turn]))
    assert (closure.status, closure.reason) == ("accepted", "")
    error = between(TRUE, closure.pose_target_source)
    assert math.hypot(error[0], error[1]) < 0.03
    assert abs(error[2]) < 0.01
    assert closure.overlap > 0.8


def test_two_scans_alone_are_enough_when_they_overlap(paths):
    closure = verify(*paths, TRUE, cloud_reach_m=0.0)
    assert closure.status == "accepted"
    assert np.abs(between(TRUE, closure.pose_target_source))[:2].max() < 0.03


def test_another_room_is_rejected_with_a_reason(office, hall, path_of):
    paths = path_of(0, office, FIRST), path_of(1, hall, [(-3.0, 1.0, 0.0), (-2.0, 1.0, 0.0), (-1.0, 1.2, 0.3)])
    for guess in [(0, 0, 0), (0.5, -0.4, 1.5), (-0.5, 0.5, -3.0)]:
        closure = verify(*paths, guess)
        assert closure.status == "rejected"
        assert "overlap" in closure.reason or "contradiction" in closure.reason


def test_pairs_by_wifi_alone_are_matched_at_any_relative_pose(paths):
    closure = verify(*paths, (0, 0, 0), recogniser="wifi")
    assert closure.status == "accepted"
    assert np.abs(between(TRUE, closure.pose_target_source))[:2].max() < 0.03


def test_scans_without_a_matching_pose_are_rejected(office, path_of):
    random = np.random.default_rng(0)
    noise = [replace(k, ranges_m=random.uniform(0.5, 9.5, 180)) for k in path_of(1, office, FIRST)]
    paths = path_of(0, office, FIRST), noise
    closure = verify(*paths, (0, 0, 0), recogniser="wifi")
    assert closure.status == "rejected"
    assert np.isfinite(closure.covariance).all()


def test_a_true_pair_with_a_wrong_guess_is_not_accepted_there(paths):
    for offset in [(2.5, 1.5, 0.0), (0.0, 0.0, math.pi), (-2.0, 0.5, 1.5)]:
        closure = verify(*paths, compose(TRUE, offset))
        is_right = np.hypot(*between(TRUE, closure.pose_target_source)[:2]) < 0.1
        assert closure.status == "rejected" or is_right


def test_the_reason_states_the_value_and_its_limit(paths):
    closure = verify(*paths, TRUE, overlap_min=1.0)
    assert closure.status == "rejected"
    assert closure.reason.startswith("overlap ")
    assert closure.reason.endswith("< 1")


def test_walls_in_observed_free_space_are_a_contradiction(walls, path_of):
    room = walls((-4, -3), (4, -3), (4, 3), (-4, 3))
    changed = np.concatenate([room, walls((-0.9, 0.9), (0.9, 0.9), (0.9, 1.2), (-0.9, 1.2))])
    poses = [(0.0, 0.0, 0.1), (0.2, -1.0, 0.3)]
    closure = verify(path_of(0, room, poses), path_of(1, changed, poses), (0, 0, 0), overlap_min=0.3)
    assert closure.status == "rejected"
    assert closure.reason.startswith("contradiction ")


def test_identical_rooms_pass_the_geometric_check(office, path_of):
    """A known limit: geometry cannot distinguish a room from its copy; text and radio must."""
    elsewhere = office + np.array([30.0, 0.0])
    moved = [(x + 30.0, y, heading) for x, y, heading in SECOND]
    closure = verify(path_of(0, office, FIRST), path_of(1, elsewhere, moved), TRUE)
    assert closure.status == "accepted"


def test_the_covariance_of_a_corridor_closure_is_large_along_its_axis(walls, path_of):
    corridor = walls((-40, -1.2), (40, -1.2), (40, 1.2), (-40, 1.2))
    paths = path_of(0, corridor, [(0, 0, 0), (1, 0.1, 0)]), path_of(1, corridor, [(3, 0.2, 0), (4, 0.1, 0)])
    closure = verify(*paths, (0.4, 0.0, 0.0), recogniser="proximity")
    along, across = closure.covariance[0, 0], closure.covariance[1, 1]
    assert closure.status == "accepted"
    assert math.sqrt(along) > 10.0, "a hundred guesses that err alike weigh no more than a metre of odometry"
    assert math.sqrt(across) < 0.1


def test_the_uncertain_axis_of_a_closure_is_in_the_frame_of_the_pose_graph(walls, path_of):
    """A robot that faces across the corridor: its position is uncertain along its own y axis."""
    corridor = walls((-40, -1.2), (40, -1.2), (40, 1.2), (-40, 1.2))
    first, second = [(0, 0, 0), (1, 0.1, 0)], [(3, 0.2, math.pi / 2), (4, 0.1, math.pi / 2)]
    guess = between(np.array(first[-1]), np.array(second[-1]))
    closure = verify(path_of(0, corridor, first), path_of(1, corridor, second), guess, recogniser="proximity")
    information = np.linalg.inv(closure.covariance)[None]

    def error(x: float, y: float) -> float:
        moved = closure.pose_target_source + np.array([x, y, 0.0])
        return squared_errors(np.array([np.zeros(3), moved]), EDGE, closure.pose_target_source[None], information)[0]

    assert error(0.5, 0.0) < 1.0 < 10.0 < error(0.0, 0.5)


@pytest.mark.parametrize("signless", ["proximity", "one of my own"])
def test_a_shared_sign_reduces_the_uncertainty_along_the_axis(walls, path_of, signless):
    corridor = walls((-40, -1.2), (40, -1.2), (40, 1.2), (-40, 1.2))
    paths = path_of(0, corridor, [(0, 0, 0), (1, 0.1, 0)]), path_of(1, corridor, [(3, 0.2, 0), (4, 0.1, 0)])
    by_sign = verify(*paths, (0.4, 0.0, 0.0), sign_m=np.ones(2))
    without = verify(*paths, (0.4, 0.0, 0.0), recogniser=signless)
    assert by_sign.covariance[0, 0] < without.covariance[0, 0] / 10
    assert without.is_loose and not by_sign.is_loose


def test_the_covariance_of_a_closure_is_symmetric_and_positive_definite(paths):
    closure = verify(*paths, TRUE)
    assert closure.covariance == pytest.approx(closure.covariance.T)
    assert np.linalg.eigvalsh(closure.covariance).min() > 0
    assert np.sqrt(np.diag(closure.covariance))[:2].max() < 0.1


def test_verification_is_deterministic(paths, hall, path_of):
    verifier = LoopVerifier(VerificationConfig(), OdometryFilterConfig(), LidarConfig(range_max_m=RANGE_MAX_M))
    other = path_of(1, hall, [(-3.0, 1.0, 0.0), (-2.0, 1.0, 0.0)])
    candidate = LoopCandidate((0, 3), (1, 3), TRUE, "twc")
    before = verifier.verify(candidate, *paths)
    verifier.verify(LoopCandidate((0, 3), (1, 1), np.zeros(3), "twc"), paths[0], other)
    after = verifier.verify(candidate, *paths)
    assert before.pose_target_source.tobytes() == after.pose_target_source.tobytes()
    assert before.covariance.tobytes() == after.covariance.tobytes()


def test_scans_without_any_return_are_rejected(keyframe):
    blind = [keyframe(0, 0, ranges_m=np.full(180, RANGE_MAX_M))]
    assert verify(blind, blind, (0, 0, 0)).status == "rejected"
