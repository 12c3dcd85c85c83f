"""Odometry that begins anew in the middle of a log is joined, and said; of other logs nothing changes."""

import dataclasses

import numpy as np
import pytest

from tests.datasets.logs.test_odd_units import path_of
from tests.real_data import DATA, needs_data
from twc_env.datasets.logs.carmen_log import read_any_log
from twc_env.datasets.logs.odometry_restarts import rejoined, restarts_of
from twc_env.datasets.logs.scan_log import log_of
from twc_env.datasets.sample import sample_files
from twc_env.records.geometry import between
from twc_env.replaying.inputs import Asked, input_of

AT = 20
FAR = np.array([12.0, -9.0, 2.0])


def log_with(times_s, poses):
    return log_of(times_s, poses, np.full((len(times_s), 180), 4.0))


def test_the_robot_moves_on_as_before_where_its_odometry_begins_anew():
    times_s, poses = path_of()
    begun_anew = np.vstack([poses[:AT], between(FAR, poses[AT:])])
    log = log_with(times_s, begun_anew)
    assert restarts_of(log).tolist() == [AT]
    motions = between(rejoined(log, restarts_of(log)).poses[:-1], rejoined(log, restarts_of(log)).poses[1:])
    assert np.allclose(motions, between(poses[:-1], poses[1:]), atol=1e-9)  # a circle: each motion is that before


def test_a_single_outlier_is_left_out_of_the_path():
    times_s, poses = path_of()
    away = poses.copy()
    away[AT, :2] += 50.0
    log = log_with(times_s, away)
    assert restarts_of(log).tolist() == [AT, AT + 1]
    assert np.allclose(rejoined(log, restarts_of(log)).poses, poses, atol=1e-9)


def test_a_jump_at_once_is_no_motion():
    times_s, poses = path_of()
    log = log_with(times_s, np.vstack([FAR, poses[1:]]))
    assert np.allclose(between(*rejoined(log, restarts_of(log)).poses[:2]), 0.0)


@pytest.mark.parametrize(
    ("time", "place"), [(1.0, 1.0), (1e-3, 10.0), (1.0, 1000.0)], ids=["sound", "no clock", "millimetres"]
)
def test_nothing_is_taken_out_of_other_logs(time, place):
    times_s, poses = path_of()
    assert not len(restarts_of(log_with(times_s * time, poses * (place, place, 1.0))))


def test_a_gap_between_scans_is_no_jump():
    times_s, poses = path_of()
    times_s[AT:] += 60.0
    poses[AT:, :2] += 30.0
    assert not len(restarts_of(log_with(times_s, poses)))


@needs_data
def test_no_real_log_has_a_jump():
    for path in (path for path in sorted(DATA.glob("lidar/*/*.gz")) if "relations" not in path.name):
        assert not len(restarts_of(read_any_log(path))), path


def test_a_replay_says_that_odometry_begins_anew_and_drives_on():
    log = read_any_log(sample_files().logs[0])
    poses = log.poses.copy()
    poses[100:] = between(FAR, poses[100:])
    broken = dataclasses.replace(log, poses=poses)
    source = input_of([broken], [np.zeros(3)], Asked())
    (note,) = [note for note in source.notes if "jumps" in note]
    assert "100.0 s after the log begins: it is taken to begin anew there" in note
    assert max(np.hypot(*frame.odometry[:2]) for step in source.steps for frame in step) < 2.0
