import numpy as np
import pytest

from twc_env.slam.odometry.odometry_calibration import Calibration, Motions, between_places, calibration

RANDOM = np.random.default_rng(8)
TURNED = RANDOM.choice([0.0, 0.0, 0.0, 0.8, -0.8], 200)
STEPS = Motions(np.column_stack([np.full(200, 0.6), np.zeros(200), TURNED]), TURNED)
PLACES = np.array([0, 5, 9, 40, 41, 120, 200])


@pytest.mark.parametrize("wrong", [Calibration(curl_rad_m=1e-4), Calibration(turn=1e-4)])
def test_constant_errors_of_steps_give_the_expected_error_between_places(wrong):
    right = between_places(STEPS, PLACES)
    straight = between_places(Motions(wrong.applied(STEPS).motion, wrong.applied(STEPS).turned_rad), PLACES)
    bent = wrong.applied(right)
    assert bent.turned_rad == pytest.approx(straight.turned_rad)
    moved, expected = bent.motion - right.motion, straight.motion - right.motion
    assert moved == pytest.approx(expected, abs=0.05 * np.abs(expected).max())
    assert np.abs(expected[:, :2]).max() > 1e-3


def test_a_robot_at_rest_does_not_determine_the_scale():
    still = Motions(np.zeros((4, 3)), np.zeros(4))
    assert calibration(still, np.zeros((5, 3))) == Calibration()
