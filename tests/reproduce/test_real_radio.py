import json
import os

import numpy as np
import pytest

from twc_env.__main__ import main
from twc_env.datasets.fingerprints import RadioSurvey
from twc_env.reproduce.real_radio import drifted

KEYS = ["floor", "method", "traces_joined", "error_mean_m", "error_std_m"]


@pytest.mark.skipif("TWC_DATA" not in os.environ, reason="phone traces: set TWC_DATA to the data folder")
def test_the_command_writes_its_rows(tmp_path):
    path = tmp_path / "rows.json"
    options = ["--floors", "site2_F6,uw_floor", "--traces", "8", "--seeds", "1"]
    main(["reproduce", "real-radio", *options, "--json", str(path), "--cache", str(tmp_path)])
    rows = json.loads(path.read_text())
    assert [list(row) for row in rows] == [KEYS] * 6
    odometry, _, ours = rows[3:]
    assert ours["error_mean_m"] < odometry["error_mean_m"]


def test_drift_leaves_the_scans_alone_and_moves_the_path():
    at = np.arange(60.0)
    position = np.column_stack([at, np.zeros(60)])
    zeros = np.zeros(60, int)
    survey = RadioSurvey("hall", position, zeros, at, zeros, ("a",), np.full((60, 1), -50.0, np.float32))
    log = drifted(survey, 1)
    assert len(log.fingerprints) == 60 and log.fingerprints[3].rssi_dbm.tolist() == [-50.0]
    assert np.linalg.norm(log.odometry[-1, :2] - position[-1]) > 0.5
