import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from twc_env.records import geometry

lengths = st.floats(-100, 100)
poses = st.tuples(lengths, lengths, st.floats(-np.pi, np.pi)).map(np.array)
clouds = arrays(float, st.tuples(st.integers(1, 20), st.just(2)), elements=lengths)


def assert_same_pose(a, b, tolerance=1e-6):
    assert a[:2] == pytest.approx(b[:2], abs=tolerance)
    assert abs(geometry.wrap_angle(a[2] - b[2])) < tolerance


def as_matrix(pose):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0, 0, 1]])


def test_a_step_ahead_after_a_rotation_by_90_degrees_is_along_y():
    assert_same_pose(geometry.compose([1, 0, np.pi / 2], [2, 0, 0]), np.array([1, 2, np.pi / 2]))


@given(st.floats(-1000, 1000))
def test_wrapped_angles_are_in_one_turn_and_equivalent(angle):
    wrapped = geometry.wrap_angle(angle)
    assert -np.pi <= wrapped < np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-9)


@given(poses, poses)
def test_compose_is_the_product_of_the_matrices(a, b):
    assert as_matrix(geometry.compose(a, b)) == pytest.approx(as_matrix(a) @ as_matrix(b), abs=1e-9)


@given(poses)
def test_a_pose_and_its_inverse_cancel(pose):
    assert_same_pose(geometry.compose(pose, geometry.inverse(pose)), np.zeros(3))
    assert_same_pose(geometry.compose(geometry.inverse(pose), pose), np.zeros(3))


@given(poses, poses, poses)
def test_compose_is_associative(a, b, c):
    left, right = geometry.compose(geometry.compose(a, b), c), geometry.compose(a, geometry.compose(b, c))
    assert_same_pose(left, right)


@given(poses, poses)
def test_between_undoes_compose(a, b):
    assert_same_pose(geometry.between(a, geometry.compose(a, b)), b)


@given(poses, poses, clouds)
def test_transforming_points_twice_equals_the_composed_transform(a, b, points):
    twice = geometry.transform_points(a, geometry.transform_points(b, points))
    assert geometry.transform_points(geometry.compose(a, b), points) == pytest.approx(twice, abs=1e-9)


@given(poses, clouds)
def test_rigid_alignment_recovers_the_motion_of_the_points(pose, points):
    moved = geometry.transform_points(pose, points)
    found = geometry.align_rigidly(points, moved)
    assert geometry.transform_points(found, points) == pytest.approx(moved, abs=1e-6)


@given(poses, st.integers(0, 1000))
def test_no_nearby_motion_fits_noisy_points_better_than_the_rigid_alignment(pose, seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 5, (12, 2))
    target = geometry.transform_points(pose, points) + rng.normal(0, 0.5, (12, 2))
    best = geometry.align_rigidly(points, target)

    def cost(candidate):
        return np.sum((geometry.transform_points(candidate, points) - target) ** 2)

    assert all(cost(best) <= cost(best + step) + 1e-9 for step in rng.normal(0, 0.01, (20, 3)))


def test_the_alignment_of_one_point_has_no_rotation():
    assert geometry.align_rigidly([[1, 1]], [[3, 4]]) == pytest.approx([2, 3, 0])


def test_farthest_first_takes_the_point_farthest_from_all_chosen_ones():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [4.0, 0.0], [10.0, 0.0]])
    assert geometry.farthest_first(points, 3) == [0, 3, 2]
    assert geometry.farthest_first(points, 9, first=2) == [2, 3, 0, 1]


@given(poses)
def test_pose_functions_broadcast_over_leading_axes(pose):
    stack = np.stack([pose, pose + 1.0])[:, None]  # (2, 1, 3)
    many = geometry.compose(stack, np.stack([pose, pose, pose]))  # (2, 3, 3)
    assert many.shape == (2, 3, 3)
    assert_same_pose(many[1, 2], geometry.compose(pose + 1.0, pose))


def test_poses_along_motions_compose_the_motions():
    motions = np.random.default_rng(0).normal(0.0, 2.0, (20, 3))
    pose = np.zeros(3)
    for motion, found in zip(motions, geometry.poses_along(motions)[1:], strict=True):
        pose = geometry.compose(pose, motion)
        assert_same_pose(found, pose)
    assert geometry.poses_along(motions[:0]).tolist() == [[0.0, 0.0, 0.0]]


def test_points_along_a_path_are_at_the_given_path_lengths():
    corners = np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 14.0]])
    assert geometry.travelled_m(corners).tolist() == [0.0, 5.0, 15.0]
    assert geometry.points_along(corners, np.array([0.0, 2.5, 10.0, 99.0])).tolist() == [
        [0, 0],
        [1.5, 2],
        [3, 9],
        [3, 14],
    ]
