"""Radio SLAM scan by scan: laps of a synthetic world, with memory for fewer places than are visited."""

import pickle

import numpy as np
import pytest

from tests.slam.radio.test_radio_slam import made_log
from twc_env.config import RadioSlamConfig
from twc_env.errors import DataError
from twc_env.records.geometry import between, compose
from twc_env.records.messages import Fingerprint
from twc_env.slam.odometry.odometry_calibration import Calibration, Motions
from twc_env.slam.radio.radio_trail import RadioTrail

CONFIG = RadioSlamConfig(trail_places_max=60)
LAPS = 10


@pytest.fixture(scope="module")
def run():
    """Poses (scans, 3) relative to the first: estimate, ground truth, odometry; and memory held after each lap."""
    log, truth = made_log(laps=LAPS)
    trail, poses, sizes = RadioTrail(CONFIG), [], []
    motions = np.concatenate([np.zeros((1, 3)), log.motions])
    for k, (motion, heard) in enumerate(zip(motions, log.fingerprints, strict=True)):
        poses.append(trail.add(motion, float(motion[2]), heard))
        if (k + 1) % (len(truth) // LAPS) == 0:
            sizes.append((len(trail), len(pickle.dumps(trail))))
    return np.array(poses), between(truth[0], truth), log.odometry, sizes


def test_the_last_lap_is_as_accurate_as_an_early_one_despite_odometry_drift(run):
    poses, truth, odometry, _ = run
    away = np.linalg.norm(poses[:, :2] - truth[:, :2], axis=1)
    lost = np.linalg.norm(odometry[:, :2] - truth[:, :2], axis=1)
    laps = [lap.mean() for lap in np.array_split(away, LAPS)]
    assert lost[-130:].mean() > 15.0
    assert laps[-1] < 1.3 * max(laps[2:5]) and laps[-1] < 2.0


def test_memory_does_not_grow_once_the_place_is_known(run):
    sizes = run[3]
    assert sizes[-1][0] == CONFIG.trail_places_max
    assert sizes[-1][1] <= 1.01 * sizes[2][1]


def test_two_consecutive_calibrations_compose():
    motions = Motions(np.array([[2.0, 0.0, 0.3]]), np.array([0.3]))
    first, second = Calibration(1.1, 0.02, 0.1), Calibration(0.9, -0.01, 0.2)
    whole, parts = first.then(second).applied(motions), second.applied(first.applied(motions))
    assert whole.motion == pytest.approx(parts.motion)
    assert compose(np.zeros(3), whole.motion[0])[2] == pytest.approx(float(parts.turned_rad[0]))


@pytest.mark.parametrize(
    ("motion", "turned_rad", "level", "message"),
    [
        ([np.nan, 0.0, 0.0], 0.0, -50.0, "motion"),
        ([1.0, 0.0], 0.0, -50.0, "a motion must be a finite pose"),
        ([1.0, 0.0, 0.0], np.inf, -50.0, "turn"),
        ([1.0, 0.0, 0.0], None, -50.0, "a turn must be a finite number"),
        ([1.0, 0.0, 0.0], 0.0, np.nan, "not finite"),
    ],
)
def test_non_finite_values_are_rejected_without_side_effects(motion, turned_rad, level, message):
    trail = RadioTrail(CONFIG)
    trail.add(np.zeros(3), 0.0, Fingerprint(np.array([1]), np.array([-50.0])))
    with pytest.raises(DataError, match=message):
        trail.add(np.array(motion), turned_rad, Fingerprint(np.array([1]), np.array([level])))
    assert trail.pose == pytest.approx(np.zeros(3)) and len(trail) == 1
