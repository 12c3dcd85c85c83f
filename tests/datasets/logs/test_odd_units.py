"""Logs in other units than metres, radians and seconds are refused, or named with the remedy; sound ones are not."""

import json
import logging
import re

import numpy as np
import pytest

from tests.real_data import DATA, needs_data
from twc_env.datasets.logs.carmen_log import read_any_log
from twc_env.datasets.logs.odd_units import name_odd_units
from twc_env.datasets.logs.tum import read_tum, write_tum
from twc_env.datasets.sample import sample_files
from twc_env.errors import DataError

SCANS = 40


def path_of(count: int = SCANS):
    """Times [s] and poses of a robot on a circle, which looks ahead."""
    angles = 0.1 * np.arange(count)
    turned = (angles + np.pi) % (2 * np.pi) - np.pi
    return 1000.0 + np.arange(count), np.column_stack([5 * np.sin(angles), 5 - 5 * np.cos(angles), turned])


def write_log(path, time=1.0, place=1.0, angle=1.0, ranges=None):
    times_s, poses = path_of()
    told = [2.0 + 0.01 * k for k in range(180)] if ranges is None else [ranges] * 180
    scans = {
        f"{t * time:.9f}": {"range": told, "x": x * place, "y": y * place, "theta": h * angle}
        for t, (x, y, h) in zip(times_s.tolist(), poses.tolist(), strict=True)
    }
    path.write_text(json.dumps({"map": scans}))
    return path


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"angle": 57.29578}, r"fit the path as degrees; they must be radians: divide them by 57"),
        ({"place": 1000.0}, r"faster than 499.8 m/s; positions must be metres: divide millimetres by 1000"),
        ({"time": 1e3}, r"1000 s from one pose to the next; .* if they are milliseconds, divide them by 1e\+03"),
        ({"time": 1e6}, r"if they are microseconds, divide them by 1e\+06"),
        ({"time": 1e9}, r"if they are nanoseconds, divide them by 1e\+09"),
        ({"ranges": 1e-3}, r"half of all returns are nearer than 0.001 m; ranges must be metres"),
    ],
)
def test_another_unit_is_named_with_the_remedy(tmp_path, caplog, change, message):
    read_any_log(write_log(tmp_path / "a.json", **change))
    (record,) = caplog.records
    assert re.search(message, record.getMessage())


@pytest.mark.parametrize("ranges", [-1.0, 0.0])
def test_a_log_in_which_no_beam_has_a_return_is_refused(tmp_path, ranges):
    with pytest.raises(DataError, match="no beam has a return, of 7200; ranges must be metres above 0"):
        read_any_log(write_log(tmp_path / "a.json", ranges=ranges))


def test_one_outlier_is_no_other_unit(caplog):
    times_s, poses = path_of()
    poses[20, :2] += 5000.0
    times_s[30:] += 1e5
    name_odd_units(times_s, poses, "a.log")
    assert not caplog.records


def test_headings_that_are_not_wrapped_and_robots_that_drive_backwards_or_sideways_are_sound(caplog):
    times_s, poses = path_of(400)
    for turned in (np.unwrap(poses[:, 2]), poses[:, 2] + np.pi, poses[:, 2] + np.pi / 2):
        name_odd_units(times_s, np.column_stack([poses[:, :2], turned]), "a.log")
    assert not caplog.records


def test_the_units_of_a_trajectory_are_named_too(tmp_path, caplog):
    times_s, poses = path_of()
    write_tum(tmp_path / "a.tum", times_s * 1e3, poses * (1e3, 1e3, 1.0))
    read_tum(tmp_path / "a.tum")
    assert "if they are milliseconds" in caplog.text


def test_the_sample_is_read_without_a_remark(caplog):
    for log in sample_files().logs:
        read_any_log(log)
    assert not caplog.records


@needs_data
def test_real_logs_are_read_without_a_remark(caplog):
    caplog.set_level(logging.WARNING)
    logs = [*DATA.glob("lidar/carmen/*.log.gz"), *DATA.glob("lidar/raw_odometry/*.json.gz")]
    assert len(logs) == 7
    for log in logs:
        read_any_log(log)
    units = [record for record in caplog.records if "must be" in record.getMessage()]
    assert not units


def test_times_that_are_no_clock_are_named(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        read_any_log(write_log(tmp_path / "still.json", time=1e-6))
    assert "is no clock" in caplog.text
