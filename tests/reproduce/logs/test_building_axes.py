import numpy as np
import pytest

from tests.real_data import needs_data
from twc_env.datasets.logs.scan_log import apart
from twc_env.reproduce.logs.building_axes import figures


def test_share_and_deviation_of_a_made_path_are_found():
    random = np.random.default_rng(0)
    on_axis = 0.4 + np.pi / 2 * random.integers(0, 4, 3000) + np.radians(4.0) * random.normal(size=3000)
    heading = np.where(random.random(3000) < 0.7, on_axis, random.uniform(-np.pi, np.pi, 3000))
    path = np.cumsum(3.0001 * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    found = figures(np.column_stack([path, heading]))
    assert found["ways"] == 2999
    assert found["share"] == pytest.approx(0.7, abs=0.05)
    assert found["std_deg"] == pytest.approx(4.0, abs=0.5)


def test_places_lie_at_least_three_metres_apart():
    assert apart(np.column_stack([np.arange(11.0), np.zeros((11, 2))]), 3.0).tolist() == [0, 3, 6, 9]


@needs_data
def test_the_logs_stray_as_the_engine_takes_them_to(written):
    table = written("building-axes", "--seeds", "0")
    logs = [row["std_deg"] for row in table if row["role"] == "calibrated"]
    assert len(logs) == 5 and np.median(logs) == pytest.approx(5.0, abs=0.2)
    assert all(row["std_deg"] < min(logs) for row in table if row["role"] == "reported")
