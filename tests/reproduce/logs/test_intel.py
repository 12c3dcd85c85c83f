import numpy as np
import pytest

from tests.real_data import needs_data
from twc_env.datasets.logs.scan_log import Relations, read_scan_log
from twc_env.reproduce.logs import intel
from twc_env.reproduce.runner import Runner


def test_relations_between_robots_that_share_no_map_are_not_compared():
    poses = np.array([[0.0, 0, 0], [1.0, 0, 0], [5.0, 5.0, 1.0], [6.0, 5.0, 1.0]])
    measured = np.array([[1.0, 0.2, 0.1], [3.0, 0.0, 0.0]])
    relations = Relations(np.array([0, 1]), np.array([1, 3]), measured, np.zeros(2))
    row = intel.row("engine", poses, np.array([0, 0, 1, 1]), relations, 2)
    assert row["relations"] == 1 and row["robots_in_one_map"] == 1
    assert row["translation_error_m"] == pytest.approx(0.2)
    assert row["rotation_error_deg"] == pytest.approx(np.degrees(0.1))


def test_relations_of_scans_that_were_left_out_are_not_among_the_exact_ones():
    poses = np.array([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]])
    measured = np.array([[1.0, 0.01, 0.0], [1.0, 0.0, 0.4]])
    relations = Relations(np.array([0, 1]), np.array([1, 2]), measured, np.array([0.0, 0.001]))
    row = intel.row("engine", poses, np.zeros(3, int), relations, 1)
    assert (row["relations"], row["relations_exact"]) == (2, 1)
    assert row["rotation_error_deg"] == pytest.approx(np.degrees(0.2))
    assert row["rotation_exact_deg"] == 0 and row["translation_exact_m"] == pytest.approx(0.01)


@needs_data
def test_what_the_corrected_log_misses_belongs_to_scans_that_were_left_out():
    _, relations = intel.read_log(910)
    corrected = read_scan_log(intel.log_folder() / "intel_corrected_log.json.gz").poses
    rotation_deg = relations.errors(corrected)[1]
    is_exact = relations.away_s < intel.SAME_SCAN_S
    assert (len(is_exact), is_exact.sum()) == (119, 90)
    assert rotation_deg[is_exact].mean() < 0.45 and rotation_deg[~is_exact].mean() > 3.0


@needs_data
def test_the_engine_betters_the_odometry_of_the_first_scans(parsed, tmp_path):
    options = parsed(intel, "--scans", "120", "--robots", "1", "--particles", "4", "--seeds", "0")
    runner = Runner("intel", tmp_path, {})
    table = {row["method"]: row for row in intel.rows(options, runner)}
    assert table["engine"]["relations"] == table["odometry"]["relations"] >= 10
    assert table["engine"]["translation_median_m"] < 0.6 * table["odometry"]["translation_median_m"]
    assert table["particle filter, seed 0"]["rotation_median_deg"] < 0.6 * table["odometry"]["rotation_median_deg"]
    assert [path.stat().st_size > 10_000 for path in intel.draw(options, runner, tmp_path)] == [True]
