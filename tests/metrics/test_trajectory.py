import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from twc_env.errors import DataError
from twc_env.metrics import trajectory
from twc_env.records import geometry

coordinates = st.floats(-50, 50)
paths = arrays(float, st.tuples(st.integers(2, 20), st.just(3)), elements=coordinates)
poses = st.tuples(coordinates, coordinates, st.floats(-3.1, 3.1)).map(np.array)


def wandering_path(seed: int, steps: int = 60) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.normal(0, [0.3, 0.3, 0.1], (steps, 3)), axis=0)


def test_two_points_one_metre_too_far_apart_have_errors_of_half_a_metre():
    assert trajectory.absolute_trajectory_error_m([[0, 0], [3, 0]], [[0, 0], [2, 0]]) == pytest.approx(0.5)


def test_a_given_alignment_is_used_as_it_is():
    true = np.array([[0.0, 0.0], [2.0, 0.0]])
    assert trajectory.absolute_trajectory_error_m(true + [3, 4], true, np.zeros(3)) == pytest.approx(5)


def test_robots_are_aligned_jointly_so_relative_offsets_count():
    path = wandering_path(1)
    true = np.stack([path, path + [5, 0, 0]], axis=1)  # (t, 2, 3)
    estimated = np.stack([path, path + [7, 0, 0]], axis=1)
    assert trajectory.absolute_trajectory_error_m(estimated[:, 0], true[:, 0]) == pytest.approx(0, abs=1e-9)
    assert 0.8 < trajectory.absolute_trajectory_error_m(estimated, true) <= 1.0


@given(paths, poses, st.integers(0, 100))
def test_the_error_is_invariant_to_rigid_motions_of_the_estimate(true, motion, seed):
    estimated = true + np.random.default_rng(seed).normal(0, 1, true.shape)
    before = trajectory.absolute_trajectory_error_m(estimated, true)
    after = trajectory.absolute_trajectory_error_m(geometry.compose(motion, estimated), true)
    assert after == pytest.approx(before, abs=1e-6)


@given(paths, poses)
def test_alignment_recovers_the_motion_of_the_team(estimated, motion):
    moved = geometry.transform_points(motion, estimated[:, :2])
    found = trajectory.align_team(estimated, moved)
    assert geometry.transform_points(found, estimated[:, :2]) == pytest.approx(moved, abs=1e-6)


def test_the_map_of_a_robot_that_hardly_moved_is_aligned_by_its_heading():
    motion = np.array([7.0, -2.0, 1.2])
    true = np.array([[0.0, 0.0, 0.3], [0.02, 0.0, 0.3]])
    estimated = geometry.compose(geometry.inverse(motion), true) + [[0.0, 0.0, 0.0], [0.0, 0.03, 0.0]]
    assert abs(trajectory.align_team(estimated, true)[2] - motion[2]) > 0.5
    assert trajectory.lay_map(estimated, true) == pytest.approx(motion, abs=0.03)


def test_over_a_long_path_the_alignment_follows_the_positions():
    true = wandering_path(3, 400)
    estimated = true + np.random.default_rng(0).normal(0.0, 0.05, true.shape)
    assert trajectory.lay_map(estimated, true) == pytest.approx(trajectory.align_team(estimated, true), abs=0.01)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")
def test_the_error_equals_that_of_evo(seed):
    from evo.core import metrics
    from evo.core.trajectory import PosePath3D

    def in_space(path):
        xyz = np.column_stack([path[:, :2], np.zeros(len(path))])
        half = path[:, 2] / 2
        return PosePath3D(xyz, np.column_stack([np.cos(half), 0 * half, 0 * half, np.sin(half)]))

    true = wandering_path(seed)
    estimated = geometry.compose(np.array([3.0, -2.0, 0.7]), true + wandering_path(seed + 100) * 0.1)
    reference, aligned = in_space(true), in_space(estimated)
    aligned.align(reference)
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data((reference, aligned))
    expected = error.get_statistic(metrics.StatisticsType.rmse)
    assert trajectory.absolute_trajectory_error_m(estimated, true) == pytest.approx(expected, rel=1e-6)


def test_the_end_point_error_of_a_loop_is_the_gap_of_the_estimate():
    true = np.array([[0.0, 0, 0], [5, 0, 0], [0, 0, 0]])
    estimated = np.array([[1.0, 1, 0], [6, 1, 0], [1.3, 1.4, 0]])
    assert trajectory.end_point_error_m(estimated, true) == pytest.approx(0.5)


@given(paths, poses)
def test_end_point_error_does_not_depend_on_the_map_frame(path, motion):
    assert trajectory.end_point_error_m(geometry.compose(motion, path), path) == pytest.approx(0, abs=1e-6)


def test_a_square_of_two_metres_is_eight_metres_long():
    assert trajectory.path_length_m([[0, 0], [2, 0], [2, 2], [0, 2], [0, 0]]) == pytest.approx(8)


@pytest.mark.parametrize(("speed", "steps", "share"), [(0.0, 100, 1.0), (0.1, 100, 0.0), (0.0, 10, 0.0)])
def test_a_robot_that_does_not_move_for_a_window_is_stuck(speed, steps, share):
    path = np.zeros((steps, 1, 3))
    path[:, 0, 0] = speed * np.arange(steps)
    assert trajectory.stuck_share(path, window=20, radius_m=0.3) == share


@pytest.mark.parametrize(("share", "stuck"), [(1.0, 1.0), (0.6, 1.0), (0.4, 0.0), (0.0, 0.0)])
def test_a_robot_that_waits_is_not_stuck(share, stuck):
    path = np.zeros((101, 1, 2))
    is_commanded = (np.arange(100) % 10 < 10 * share)[:, None]
    assert trajectory.stuck_share(path, 20, 0.3, is_commanded) == stuck
    assert trajectory.stuck_share(path, 20, 0.3) == 1.0


def test_the_robot_that_is_stuck_longest_counts():
    path = np.zeros((101, 2, 3))
    path[:, 0, 0] = np.arange(101)
    path[:, 1, 0] = np.concatenate([np.arange(60), np.full(41, 59)])  # stands still in steps 59..100
    assert trajectory.stuck_share(path, window=20, radius_m=0.3) == pytest.approx(42 / 101)


@pytest.mark.parametrize("shape", [(), (5, 1), (5, 4), (0, 2)])
def test_arrays_that_are_neither_positions_nor_poses_are_rejected(shape):
    for measure in (trajectory.align_team, trajectory.absolute_trajectory_error_m):
        with pytest.raises(DataError, match=r"positions \(..., 2\) or poses"):
            measure(np.zeros(shape), np.zeros(shape))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: trajectory.absolute_trajectory_error_m(np.zeros((3, 2)), np.zeros((4, 2))), r"\(3, 2\) and \(4, 2\)"),
        (lambda: trajectory.absolute_trajectory_error_m([[0, 0]], [[0, 0]], [0, 0]), r"one pose \(3,\)"),
        (lambda: trajectory.lay_map(np.zeros((3, 2)), np.zeros((3, 2))), r"poses \(\.\.\., 3\)"),
        (lambda: trajectory.lay_map(np.zeros((6, 1)), np.zeros((6, 1))), r"poses \(\.\.\., 3\)"),
        (lambda: trajectory.path_length_m([]), "a path has positions"),
        (lambda: trajectory.path_length_m([1.0, 2.0, 3.0]), "a path has positions"),
        (lambda: trajectory.stuck_share(np.zeros((50, 3)), 10, 0.3), "poses of a team have shape"),
        (lambda: trajectory.stuck_share(np.zeros((50, 1, 3)), 10, 0.3, np.ones((50, 1))), "need commands of shape"),
    ],
)
def test_paths_of_unequal_shape_are_rejected(call, message):
    with pytest.raises(DataError, match=message):
        call()
