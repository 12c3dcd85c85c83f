import math

import numpy as np
import pytest

from twc_env.config import LidarConfig, OdometryFilterConfig, VerificationConfig
from twc_env.errors import DataError
from twc_env.records.geometry import between, compose, inverse, transform_points
from twc_env.records.messages import LoopCandidate
from twc_env.slam.matching.loop_verification import LoopVerifier
from twc_env.slam.matching.point_matching import match_points

POSE = np.array([0.7, -0.4, 0.3])


def cloud(count=400):
    return np.random.default_rng(0).uniform(-5.0, 5.0, (count, 2))


def test_points_seen_from_two_poses_are_aligned_exactly():
    points = cloud()
    match = match_points(points, transform_points(inverse(POSE), points), compose(POSE, [0.05, -0.05, 0.01]))
    assert match.pose == pytest.approx(POSE, abs=1e-9)
    assert match.fitness_m2 == pytest.approx(0.0, abs=1e-12) and match.inlier_ratio == 1.0


def test_in_a_room_a_guess_may_be_wrong_by_a_metre_and_twenty_degrees(walls, scan):
    room = walls((-4, -3), (5, -3), (5, 1), (1, 1), (1, 4), (-4, 4))
    poses, beams = np.array([(0.0, 0.3, 1.2), (-0.6, 0.8, -2.2)]), 600
    angle = np.arange(beams) * 2 * math.pi / beams
    seen = [scan(room, pose, beams)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1) for pose in poses]
    true = between(*poses)
    found = [
        match_points(*seen, compose(true, [math.cos(way), math.sin(way), turn])).pose
        for way in np.arange(6) * math.pi / 3
        for turn in (-0.35, 0.35)
    ]
    off_m = [math.hypot(*between(true, pose)[:2]) for pose in found]
    assert np.median(off_m) < 0.04 and max(off_m) < 0.2


def test_the_fitness_is_the_mean_squared_distance_of_the_pairs():
    wall = np.stack([np.arange(0.0, 40.0, 2.0), np.zeros(20)], axis=1)
    noisy = wall + np.array([0.0, 0.1]) * np.where(np.arange(20) % 2, 1.0, -1.0)[:, None]
    match = match_points(wall, noisy, np.zeros(3))
    assert match.fitness_m2 == pytest.approx(0.01, rel=0.05)


def test_point_clouds_without_overlap_do_not_match():
    for source in (cloud() + 100.0, np.zeros((0, 2))):
        match = match_points(cloud(), source, np.zeros(3))
        assert match.inlier_ratio == 0.0 and math.isnan(match.fitness_m2) and not match.hessian.any()


def test_the_config_selects_point_matching_in_the_verifier(office, path_of):
    first, second = [(-1.0, -1.0, 0.0), (0.0, 0.3, 1.2)], [(0.5, 1.2, -2.5), (-0.3, 0.6, -2.2)]
    true = between(np.array(first[-1]), np.array(second[-1]))
    verifier = LoopVerifier(VerificationConfig(method="point-to-point"), OdometryFilterConfig(), LidarConfig())
    candidate = LoopCandidate((0, 1), (1, 1), compose(true, [0.1, -0.1, 0.05]), "twc")
    closure = verifier.verify(candidate, path_of(0, office, first), path_of(1, office, second))
    assert closure.status == "accepted"
    assert np.abs(between(true, closure.pose_target_source)).max() < 0.1


def test_point_matching_underestimates_the_uncertainty_along_a_corridor_and_line_matching_does_not(walls, path_of):
    corridor = walls((-40, -1.2), (40, -1.2), (40, 1.2), (-40, 1.2))
    paths = path_of(0, corridor, [(0, 0, 0), (1, 0.1, 0)]), path_of(1, corridor, [(3, 0.2, 0), (4, 0.1, 0)])
    candidate = LoopCandidate((0, 1), (1, 1), np.array([0.4, 0.0, 0.0]), "proximity")
    along_m = {
        method: math.sqrt(
            LoopVerifier(VerificationConfig(method=method), OdometryFilterConfig(), LidarConfig())
            .verify(candidate, *paths)
            .covariance[0, 0]
        )
        for method in ("point-to-line", "point-to-point")
    }
    assert along_m["point-to-point"] < 0.1 < 1.0 < along_m["point-to-line"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"target": np.full((9, 2), np.nan)}, "target points must be finite; row 0"),
        ({"source": np.zeros((9, 3))}, "source points must have shape"),
        ({"guess": [0.0, 0.0, np.nan]}, "guess must be a finite pose"),
    ],
)
def test_invalid_points_and_guesses_are_rejected(changes, message):
    with pytest.raises(DataError, match=message):
        match_points(**{"target": cloud(9), "source": cloud(9), "guess": np.zeros(3), **changes})


def test_lists_of_points_are_accepted():
    assert match_points(cloud().tolist(), cloud().tolist(), [0, 0, 0]).pose == pytest.approx(np.zeros(3), abs=1e-9)
