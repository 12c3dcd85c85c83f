"""`twc-env replay LOG --list`: what is in logs that are no bags."""

import json

import numpy as np
import pytest

from twc_env.__main__ import main
from twc_env.config import from_dict
from twc_env.datasets.logs.frame_log import write_frame_log
from twc_env.records.messages import SensorFrame, SignReading, WifiScan
from twc_env.replaying.log_contents import list_robots


def test_scans_beams_time_and_odometry_of_a_carmen_log_are_listed(tmp_path, capsys):
    lines = [f"FLASER 4 2 2 2 2 {0.5 * k} 0 0 {0.5 * k} 0 0 {100 + 0.25 * k} host 0" for k in range(9)]
    (tmp_path / "a.log").write_text("\n".join(lines))
    row = {"robot": 0, "scans": 9, "beams": 4, "begin [s]": 100.0, "span [s]": 2.0, "rate [Hz]": 4.0}
    assert list_robots(tmp_path / "a.log") == [row | {"odometry [m]": 4.0}]
    assert main(["replay", str(tmp_path / "a.log"), "--list"]) == 0
    assert "begin [s]  span [s]  rate [Hz]  odometry [m]" in capsys.readouterr().out


def test_both_robots_of_the_sample_are_listed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["replay", "sample", "--list", "--json", "list.json"]) == 0
    rows = json.loads((tmp_path / "list.json").read_text())["sample"]
    assert [row["robot"] for row in rows] == [0, 1]
    assert all(row["scans"] > 10 and row["beams"] > 100 and row["odometry [m]"] > 5.0 for row in rows)


def test_a_frame_log_lists_its_wifi_and_signs_too(tmp_path):
    config = from_dict({"robots": 2, "lidar": {"beam_count": 16}})
    wifi, sign = WifiScan(np.array([5]), np.array([-40.0])), SignReading("A", 0.0, 1.0)
    frames = [
        SensorFrame(0, k, 0.5 * k, np.array([0.3, 0.4, 0.0]), 0.0, np.ones(16), wifi if k else None, (sign, sign))
        for k in range(3)
    ]
    write_frame_log(tmp_path / "frames.npz", config, [[frame] for frame in frames])
    row = {"robot": 0, "scans": 3, "beams": 16, "begin [s]": 0.0, "span [s]": 1.0, "rate [Hz]": 2.0}
    none = {"robot": 1, "scans": 0, "beams": 0, "begin [s]": None, "span [s]": 0.0, "rate [Hz]": None}
    for place in (tmp_path, tmp_path / "frames.npz"):
        assert list_robots(place) == [
            row | {"odometry [m]": 1.5, "WiFi scans": 2, "signs read": 6},
            none | {"odometry [m]": 0.0, "WiFi scans": 0, "signs read": 0},
        ]


@pytest.mark.parametrize(("name", "text"), [("a.log", "no log"), ("wifi.csv", "time,bssid,rssi\n")])
def test_what_is_no_log_is_not_listed(tmp_path, refusal, name, text):
    (tmp_path / name).write_text(text)
    told = refusal(main, ["replay", str(tmp_path / name), "--list"])
    assert ("--wifi" if name == "wifi.csv" else "is not a CARMEN log") in told
