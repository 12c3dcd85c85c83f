import dataclasses

import numpy as np
import pytest

from tests.real_data import needs_data
from twc_env.datasets.surveys.fingerprints import RadioSurvey
from twc_env.datasets.surveys.step_heading import WalkerTrace
from twc_env.records.messages import Fingerprint
from twc_env.reproduce.logs import real_radio_oracle
from twc_env.reproduce.logs.real_radio import drifted

KEYS = ["floor", "method", "traces_joined", "traces", "error_mean_m", "error_std_m"]


@needs_data
def test_the_command_writes_its_rows(written):
    rows = written("real-radio", "--floors", "site2_F6,uw_floor", "--traces", "8", "--draws", "1")
    assert [list(row) for row in rows] == [KEYS] * 9
    malls, (odometry, paper, ours, engine) = rows[:5], rows[5:]
    assert [row["method"] for row in (odometry, paper, ours, engine)] == ["odometry", "paper", "ours", "engine"]
    assert [row["traces_joined"] for row in malls[:3]] == [0, 0, 0] and malls[4]["traces_joined"] <= 8
    assert {row["traces"] for row in malls} == {8} and {row["traces"] for row in rows[5:]} == {1}
    for method in (ours, engine):
        assert method["error_mean_m"] < 0.4 * odometry["error_mean_m"]


def test_drift_leaves_the_scans_alone_and_moves_the_path():
    at = np.arange(60.0)
    position = np.column_stack([at, np.zeros(60)])
    zeros = np.zeros(60, int)
    survey = RadioSurvey("hall", position, zeros, at, zeros, ("a",), np.full((60, 1), -50.0, np.float32))
    log = drifted(survey, 1)
    assert len(log.fingerprints) == 60 and log.fingerprints[3].rssi_dbm.tolist() == [-50.0]
    assert np.linalg.norm(log.odometry[-1, :2] - position[-1]) > 0.5


def _walk(start_m, step_m, turned_rad=0.0):
    """Ten scans on a line in a hall of nine transmitters that fade by half a decibel per metre."""
    true = np.asarray(start_m, float) + np.arange(10.0)[:, None] * step_m
    senders = np.stack(np.meshgrid([0.0, 20.0, 40.0], [0.0, 20.0, 40.0]), axis=-1).reshape(-1, 2)
    away = np.linalg.norm(true[:, None] - senders[None], axis=2)
    prints = tuple(Fingerprint(np.arange(9, dtype=np.int64), -40.0 - 2.0 * row) for row in away)
    c, s = np.cos(turned_rad), np.sin(turned_rad)
    reckoned = np.column_stack([(true - true[0]) @ np.array([[c, s], [-s, c]]), np.zeros(10)])
    return WalkerTrace("walk", np.arange(10.0), reckoned, np.zeros(9), prints, true)


def _hall(turned_rad=0.0):
    """Nine parallel lines, each walked twice; the compass of those on the middle line may be turned."""
    return [_walk((0.0, y), (4.0, 0.0), turned_rad if y == 20 else 0.0) for y in range(0, 41, 5) for _ in range(2)]


@pytest.mark.parametrize("is_shape_known", [True, False])
def test_a_walk_is_found_where_another_heard_the_same(is_shape_known):
    assert (
        real_radio_oracle.localisation_errors_m(_hall(), is_shape_known).max() < 2.5
    )  # nearer to its own line than to the next


def test_a_walk_is_not_found_by_its_own_scans():
    loud = Fingerprint(np.array([100], np.int64), np.array([-40.0]))
    alone = dataclasses.replace(_walk((40.0, 40.0), (1.0, 0.0)), fingerprints=(loud,) * 10)
    walks = [*_hall(), alone]
    assert real_radio_oracle.localisation_errors_m(walks, is_shape_known=True)[-10:].min() > 20.0
    heard = [print_ for walk in walks for print_ in walk.fingerprints]
    told = real_radio_oracle._Others(np.concatenate([walk.surveyed_m for walk in walks]), heard)
    assert not told._similarities(np.arange(len(heard) - 10, len(heard))).any()


def test_a_shape_that_is_told_is_not_taken_from_a_turned_compass():
    known, reckoned = (
        real_radio_oracle.localisation_errors_m(_hall(1.5), is_known)[80:100].max() for is_known in (True, False)
    )
    assert known < 2.5 < reckoned
