import gzip

import numpy as np
import pytest

from tests.real_data import needs_data
from twc_env.datasets.surveys.ble_drive import read_ble_drive
from twc_env.errors import DataError
from twc_env.records.messages import UNSEEN_M
from twc_env.reproduce.logs import ble_lidar
from twc_env.reproduce.runner import Runner


def write_drive(folder, scans):
    """Two seconds ahead, a quarter turn to the left, and a scan at each of the given seconds."""
    table = ["ts,x,heading,y," + ",".join(f"rssi_{a}" for a in (3, 4, 5, 8, 10, 11))]
    table += [f"{t}e9,{0.1 * t},0,0,-50,-60,,-70,,-80" for t in range(100, 110)]
    texts = {
        "df.csv": "\n".join(table),
        "motion.txt": "101.0,forward,0.15\n103.0,stop,0.15\n104.0,left,0.15\n105.2,stop,0.15\n",
        "scan.txt": "".join(f"{s:.2f}\n[0 90000 180000]\n[100 200\n 9]\n" for s in scans),
    }
    for name, text in texts.items():
        (folder / f"calib3_{name}.gz").write_bytes(gzip.compress(text.encode()))


def test_a_drive_is_scans_with_commanded_motion_and_strengths(tmp_path):
    write_drive(tmp_path, [100.76, 103.76, 104.7, 106.26])
    drive = read_ble_drive(tmp_path, "calib3", 4, 10.0)
    assert len(drive.frames) == 3, "the scan during the turn is left out"
    assert drive.frames[1].odometry == pytest.approx([0.56, 0.0, 0.0])
    assert drive.frames[2].odometry == pytest.approx([0.0, 0.0, np.pi / 2])
    assert drive.frames[0].ranges_m.tolist() == [1.0, 2.0, UNSEEN_M, UNSEEN_M]
    assert drive.frames[1].wifi.macs.tolist() == [1, 2, 4, 6]
    assert np.linalg.norm(drive.tracked_m[1] - drive.tracked_m[0]) == pytest.approx(0.3)


def test_a_drive_that_is_cut_off_is_a_data_error(tmp_path):
    write_drive(tmp_path, [100.76])
    (tmp_path / "calib3_scan.txt.gz").write_bytes(gzip.compress(b"100.76\n[0 90000]\n"))
    with pytest.raises(DataError):
        read_ble_drive(tmp_path, "calib3", 4, 10.0)


@needs_data
def test_the_table_has_a_row_for_each_method_and_a_picture(parsed, tmp_path):
    options, runner = parsed(ble_lidar, "--runs", "calib4", "--frames", "150"), Runner("ble-lidar", tmp_path, {})
    table = {row["method"]: row for row in ble_lidar.rows(options, runner)}
    assert list(table) == ["commands", "scan odometry", "lidar", "radio+lidar"]
    assert table["lidar"]["error_mean_m"] < 0.5 and table["lidar"]["map_iou"] > 0.1
    assert [path.stat().st_size > 10_000 for path in ble_lidar.draw(options, runner, tmp_path)] == [True]
