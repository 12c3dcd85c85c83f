"""What recognises places in laser logs, with and without WiFi and signs beside them."""

from twc_env.__main__ import main
from twc_env.commands.replay import SCANS_ALONE
from twc_env.datasets.sample import sample_files
from twc_env.replaying.inputs import Asked, read_input


def test_places_are_recognised_by_the_readings_that_there_are():
    sample = sample_files()
    found = [
        read_input(sample.logs, Asked(wifi=wifi, signs=signs)).config.slam
        for wifi in ((), sample.wifi)
        for signs in ((), sample.signs)
    ]
    assert [each.place_recognition.recogniser for each in found] == ["lidar", "fused", "wifi", "fused"]
    assert [each.merging.wifi_check for each in found] == [False, False, True, True]


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
