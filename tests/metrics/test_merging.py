import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twc_env.errors import DataError
from twc_env.metrics import implied_frames, wrong_pairs
from twc_env.records import geometry

ROBOT_OF = np.repeat([0, 1, 2], [50, 20, 30])


def team(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    starts = rng.normal(0, 10, (3, 3))
    return np.concatenate(
        [start + np.cumsum(rng.normal(0, 0.3, (n, 3)), axis=0) for start, n in zip(starts, (50, 20, 30), strict=True)]
    )


@given(st.integers(0, 1000), st.floats(-30, 30), st.floats(-30, 30), st.floats(-3, 3))
def test_a_perfect_merge_has_one_frame_and_no_wrong_pair(seed, x, y, heading):
    estimated, frame = team(seed), np.array([x, y, heading])
    frames = implied_frames(estimated, geometry.compose(frame, estimated), ROBOT_OF)
    assert geometry.between(frame, frames) == pytest.approx(np.zeros((3, 3)), abs=1e-6)
    assert wrong_pairs(frames) == []


def test_a_robot_without_poses_has_no_frame_and_forms_no_wrong_pair():
    estimated = team(1)
    frames = implied_frames(estimated, geometry.compose([30.0, 40.0, 0.5], estimated), ROBOT_OF * 2)
    assert np.isnan(frames[[1, 3]]).all() and np.isfinite(frames[[0, 2, 4]]).all()
    assert wrong_pairs(frames) == []


def test_a_robot_offset_by_two_metres_forms_wrong_pairs_with_all_others():
    estimated = team(1)
    true = estimated.copy()
    true[ROBOT_OF == 1, :2] += [2.0, 0.0]
    assert wrong_pairs(implied_frames(estimated, true, ROBOT_OF)) == [(0, 1), (1, 2)]


def test_a_robot_rotated_by_90_degrees_is_wrong_even_at_the_correct_position():
    assert wrong_pairs([[0, 0, 0], [0, 0, np.pi / 2]]) == [(0, 1)]


def test_a_small_rotation_is_evaluated_at_the_centre_of_the_paths():
    centre = np.array([60.0, 0.0])
    turned = geometry.compose(np.array([*centre, 0.05]), np.array([*-centre, 0.0]))
    frames = np.stack([np.zeros(3), turned])
    assert wrong_pairs(frames) == [(0, 1)]
    assert wrong_pairs(frames, centre) == []


@pytest.mark.parametrize("frames", [np.zeros((3, 2)), [[np.nan, 0.0, 0.0], [0.0, 0.0, 0.0]], []])
def test_invalid_frames_are_rejected(frames):
    with pytest.raises(DataError, match="finite poses"):
        wrong_pairs(frames)


@pytest.mark.parametrize(
    ("true", "robot_of", "message"),
    [
        (np.zeros((5, 3)), [0, 0, 1, 1], "equal shape"),
        (np.zeros((4, 3)), [0, 0], "one for each pose"),
        (np.zeros((4, 3)), [0.0, 0.0, 1.0, 1.0], "one for each pose"),
        (np.zeros((4, 3)), [0, 0, 1, -1], "from 0, one for each pose"),
    ],
)
def test_poses_of_unequal_shape_are_rejected(true, robot_of, message):
    with pytest.raises(DataError, match=message):
        implied_frames(np.zeros((4, 3)), true, robot_of)
