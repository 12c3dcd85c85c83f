"""What recognises places in laser logs, with and without WiFi and signs beside them."""

import dataclasses

import numpy as np
import pytest

from twc_env.__main__ import main
from twc_env.commands.replay import SCANS_ALONE, _rests_on_readings
from twc_env.datasets.logs.carmen_log import read_any_log
from twc_env.datasets.sample import sample_files
from twc_env.replaying.inputs import Asked, input_of, read_input


def test_places_are_recognised_by_the_readings_that_there_are():
    sample = sample_files()
    found = [
        read_input(sample.logs, Asked(wifi=wifi, signs=signs)).config.slam
        for wifi in ((), sample.wifi)
        for signs in ((), sample.signs)
    ]
    assert [each.place_recognition.recogniser for each in found] == ["lidar", "fused", "wifi", "fused"]
    assert [each.merging.wifi_check for each in found] == [False, False, True, True]


def test_robots_of_logs_of_one_time_are_looked_for_in_each_others_scans():
    logs = [read_any_log(log) for log in sample_files().logs]
    later = dataclasses.replace(logs[1], times_s=logs[1].times_s + 1e4)
    since_begin = [dataclasses.replace(log, times_s=log.times_s - log.times_s[0]) for log in logs]
    found = [input_of(each, [np.zeros(3)] * len(each), Asked()).config.slam for each in
             (logs, [logs[0], later], since_begin, logs[:1])]  # fmt: skip
    assert [slam.keyframe.mask_teammates for slam in found] == [True, False, False, False]
    assert not found[1].merging.mutual_observations_check


def test_a_map_of_several_robots_by_scans_alone_is_told(capsys):
    sample = sample_files()
    logs = [str(log) for log in sample.logs]
    assert main(["replay", *logs]) == 0
    out = capsys.readouterr().out
    assert "map 1: robots 0, 1" in out and SCANS_ALONE in out
    assert main(["replay", *logs, "--wifi", *map(str, sample.wifi)]) == 0
    assert SCANS_ALONE not in capsys.readouterr().out
    assert main(["replay", logs[0]]) == 0
    assert SCANS_ALONE not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("figures", "is_told"),
    [
        ({"groups": [[0], [1]]}, True),
        ({"groups": [[0, 1]]}, False),
        ({"groups": [[0, 1], []], "found_prior": []}, True),
        ({"groups": [[0, 1]], "found_prior": [0, 1]}, False),
        ({"groups": [[0], [1]], "found_prior": [0, 1], "lost_share": [0.1, 0.2]}, False),
        ({"groups": [[0], [1]], "found_prior": [], "lost_share": [0.1, 1.0]}, True),
    ],
)
def test_robots_that_readings_alone_left_apart_may_be_sought_by_scans(figures, is_told):
    """A log found the map of Monday to 2 cm, and not at all with the table of its signs."""
    sample = sample_files()
    logs = [read_any_log(log).at(slice(0, 5)) for log in sample.logs]
    for asked in (Asked(signs=sample.signs), Asked(wifi=sample.wifi)):
        source = input_of(logs, [np.zeros(3)] * 2, asked)
        assert _rests_on_readings(source, source.config, figures) is is_told
    bare = input_of(logs, [np.zeros(3)] * 2, Asked())
    assert not _rests_on_readings(bare, bare.config, figures)
