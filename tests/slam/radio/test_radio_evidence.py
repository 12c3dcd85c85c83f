import numpy as np
import pytest

from twc_env.slam.radio.radio_evidence import FieldEvidence

RANDOM = np.random.default_rng(1)
PLACES = RANDOM.uniform(0, 40, (80, 2))
BOXES = RANDOM.uniform(-5, 45, (30, 2))
AWAY_M = np.linalg.norm(PLACES[:, None] - BOXES, axis=2)
HEARD = np.maximum(65 - 30 * np.log10(np.maximum(AWAY_M, 1.0)) + RANDOM.normal(size=AWAY_M.shape), 0.0)


def test_the_true_layout_has_more_evidence_than_a_bent_and_a_random_one():
    evidence = FieldEvidence(HEARD)
    bent = PLACES + np.column_stack([0.01 * PLACES[:, 1] ** 2, np.zeros(80)])
    folded = np.column_stack([np.abs(PLACES[:, 0] - 20.0), PLACES[:, 1]])
    true, bent, folded = (evidence.of(places) for places in (PLACES, bent, folded))
    assert true > bent + 0.5 and bent > folded + 10.0


def test_evidence_is_invariant_to_rigid_motions_of_the_layout():
    evidence = FieldEvidence(HEARD)
    turned = PLACES @ np.array([[0.6, 0.8], [-0.8, 0.6]]) + [100.0, -30.0]
    assert evidence.of(turned) == pytest.approx(evidence.of(PLACES), abs=1e-3)


@pytest.mark.parametrize("travel_m", [None, np.linspace(0.0, 160.0, 80)])
def test_the_gradient_is_that_of_the_evidence(travel_m):
    evidence = FieldEvidence(HEARD, travel_m)
    squared = ((PLACES[:, None] - PLACES) ** 2).sum(axis=2)
    logs = np.log([0.7, 0.2, 12.0, 4.0, 0.1, 0.2, 6.0][: 5 if travel_m is None else 7])
    _, slopes = evidence._cost(logs, squared)
    assert len(slopes) == len(logs)
    for k in range(len(logs)):
        step = 1e-5 * np.eye(len(logs))[k]
        difference = evidence._cost(logs + step, squared)[0] - evidence._cost(logs - step, squared)[0]
        assert slopes[k] == pytest.approx(difference / 2e-5, rel=1e-3, abs=1e-3)


def test_the_gradient_by_positions_is_that_of_the_evidence():
    evidence = FieldEvidence(HEARD)
    logs = np.log([0.7, 0.2, 12.0, 4.0, 0.1])
    slopes, _ = evidence.gradient(PLACES, logs)
    for place, axis in ((3, 0), (40, 1)):
        step = np.zeros_like(PLACES)
        step[place, axis] = 1e-4
        ahead, behind = (evidence.evidence_with(PLACES + sign * step, logs) for sign in (1, -1))
        assert slopes[place, axis] == pytest.approx((ahead - behind) / 2e-4, rel=1e-3)


def test_the_information_is_the_covariance_of_gradients_over_possible_readings():
    logs = np.log([0.7, 0.2, 12.0, 4.0, 0.1])
    places = PLACES[:12]
    squared = ((places[:, None] - places) ** 2).sum(axis=2)
    root = np.linalg.cholesky(FieldEvidence(HEARD[:12])._covariance(logs, squared)[0])
    _, information = FieldEvidence(HEARD[:12]).gradient(places, logs)
    random, slopes = np.random.default_rng(2), []
    for _ in range(3000):
        evidence = FieldEvidence(HEARD[:12])
        heard = root @ random.normal(size=len(root))
        evidence._likeness = np.outer(heard, heard)
        slopes.append(evidence.gradient(places, logs)[0].ravel())
    found, expected = np.cov(np.transpose(slopes)), information.reshape(24, 24)
    assert np.linalg.norm(found - expected) < 0.1 * np.linalg.norm(expected)
