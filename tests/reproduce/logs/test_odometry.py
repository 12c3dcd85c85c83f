import numpy as np
import pytest

from tests.real_data import needs_data
from twc_env.config import OdometryConfig
from twc_env.datasets.logs.scan_log import Relations
from twc_env.reproduce.logs.odometry import dead_reckoning, figures


def test_dead_reckoning_without_drift_is_the_path():
    path = np.cumsum(np.full((50, 3), [0.3, 0.1, 0.05]), axis=0)
    assert dead_reckoning(path, OdometryConfig(platform="pioneer-intel", drift=0.0), 0) == pytest.approx(path)


def test_errors_are_those_of_the_relative_pose():
    poses = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 2.0, np.pi / 2]])
    measured = np.array([[1.0, 0.5, 0.0], [0.0, 2.0, np.pi / 2 - 0.1]])
    relations = Relations(np.array([0, 1]), np.array([1, 2]), measured, np.zeros(2))
    found = figures(poses, relations, {"all": np.array([True, True]), "late": np.array([False, True])})
    assert found["all: translation_m"] == pytest.approx(0.25)
    assert found["late: rotation_deg"] == pytest.approx(np.degrees(0.1))


@needs_data
def test_the_table_meets_the_real_drift_within_fifteen_percent(written):
    rows = {row["quantity"]: row for row in written("odometry", "--seeds", "0-19")}
    assert rows["all relations: translation_m"]["real"] == pytest.approx(6.5, abs=0.05)
    assert rows["all relations: rotation_deg"]["real"] == pytest.approx(24, abs=0.5)
    for name in ("all relations", "loops over 60 s"):
        for unit in ("translation_m", "rotation_deg"):
            row = rows[f"{name}: {unit}"]
            assert row["simulated"] == pytest.approx(row["real"], rel=0.15)
