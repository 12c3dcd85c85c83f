import json
import re
from hashlib import sha256

import numpy as np
import pytest

from twc_env.__main__ import main
from twc_env.config import EnvConfig, override
from twc_env.datasets.buildings.ros_map import write_ros_map
from twc_env.datasets.lasting_maps import prior_digest
from twc_env.datasets.logs.tum import read_tum
from twc_env.records.messages import GridMap
from twc_env.replaying import odometry_errors


def test_a_saved_map_is_the_prior_of_a_later_session_and_of_a_replay(tmp_path, capsys, refusal):
    common = ["explore", "--map", "twin-02", "--robots", "1", "--no-pictures", "--steps", "300"]
    first, second = tmp_path / "first.npz", tmp_path / "second.npz"
    assert main([*common, "--save", str(first), "--out", str(tmp_path / "a")]) == 0
    assert f"map saved: {first} (" in capsys.readouterr().out
    later = ["--prior", str(first), "--save", str(second)]
    assert main([*common, "--seed", "1", *later, "--out", str(tmp_path / "b")]) == 0
    assert main(["replay", str(tmp_path / "a"), *later, "--json", str(tmp_path / "replay.json")]) == 0
    figures = json.loads((tmp_path / "replay.json").read_text())
    assert figures["found_prior"] in ([], [0]) and str(second) in figures["saved"]
    first.write_bytes(first.read_bytes()[:-9])
    message = refusal(main, [*common, *later, "--out", str(tmp_path / "c")])
    assert "first.npz" in message and "save the map again" in message


def test_a_run_tells_which_saved_map_it_began_with_and_another_one_is_another_run(tmp_path, capsys):
    prior, log = tmp_path / "map.npz", tmp_path / "run" / "report.json"
    common = ["--map", "sfw-e1", "--robots", "1", "--no-pictures", "--out"]
    explore = ["explore", *common, str(tmp_path / "run"), "--save", str(prior), "--steps"]
    assert main([*explore, "3"]) == 0
    assert "prior_digest" not in json.loads(log.read_text())
    again = ["benchmark", "--maps", "sfw-e1", "--seeds", "0", "--steps", "3", "--set", f"slam.prior={prior}"]
    again += [*common[2:], str(tmp_path / "all")]
    assert main(again) == 0 and main(again) == 0
    assert capsys.readouterr().err.count("(reused)") == 1
    (report,) = (tmp_path / "all").glob("*/*/report.json")
    assert json.loads(report.read_text())["prior_digest"] == sha256(prior.read_bytes()).hexdigest()[:8]
    assert main([*explore, "40"]) == 0
    assert main(again) == 0
    assert "(reused)" not in capsys.readouterr().err


def test_a_ros_map_that_a_run_begins_with_is_told_by_its_picture(tmp_path):
    grid = GridMap(np.full((9, 9), -100, np.int16), np.zeros(2), 0.1)
    config = override(EnvConfig(), {"slam.prior": str(write_ros_map(grid, tmp_path, "map"))})
    first = prior_digest(config)
    grid.log_odds[4, 4] = 100
    write_ros_map(grid, tmp_path, "map")
    assert len(first) == 8 and prior_digest(config) != first
    assert prior_digest(EnvConfig()) == prior_digest(override(config, {"slam.prior": "earlier-session:9"})) == ""


def test_a_saved_map_names_the_robots_that_are_not_in_it(tmp_path, capsys):
    common = ["explore", "--map", "twin-02", "--robots", "2", "--no-pictures", "--steps", "20"]
    assert main([*common, "--save", str(tmp_path / "map.npz")]) == 0
    assert re.search(r"sign texts\); without the map of robot [01]$", capsys.readouterr().out, re.MULTILINE)
    assert main([*common, "--set", "slam.oracle=starts", "--save", str(tmp_path / "map.npz")]) == 0
    assert "without the map" not in capsys.readouterr().out


@pytest.mark.parametrize("place", ["here", "file/map.npz"])
def test_a_map_that_cannot_be_saved_is_refused_before_the_run(tmp_path, refusal, place):
    (tmp_path / "here").mkdir()
    (tmp_path / "file").write_text("")
    arguments = ["explore", "--steps", "5", "--no-pictures", "--save", str(tmp_path / place)]
    assert "cannot write" in refusal(main, arguments)


def test_a_replay_is_localised_in_a_saved_map_and_in_a_ros_map(tmp_path, capsys, refusal):
    common = ["explore", "--map", "twin-02", "--robots", "1", "--no-pictures", "--steps", "300"]
    assert main([*common, "--save", str(tmp_path / "map.npz"), "--out", str(tmp_path / "a")]) == 0
    assert main(["replay", str(tmp_path / "a"), "--out", str(tmp_path / "b"), "--no-pictures"]) == 0
    for prior in (tmp_path / "map.npz", tmp_path / "b" / "map.yaml"):
        out = ["--json", str(tmp_path / "c.json"), "--out", str(tmp_path / "c"), "--no-pictures"]
        assert main(["replay", str(tmp_path / "a"), "--prior", str(prior), "--localise", *out]) == 0
        figures = json.loads((tmp_path / "c.json").read_text())
        assert figures["found_prior"] == [0] and figures["lost_share"][0] < 0.9
        assert (figures["groups"], figures["maps"]) == ([[0]], ["robot 0"])  # the prior map is no robot
        assert re.search(r"^lost +robot 0 \d+% of the scans$", capsys.readouterr().out, re.MULTILINE)
        told = len(read_tum(tmp_path / "c" / "trajectories" / "robot_0_estimated.tum")[0])
        scans = len(read_tum(tmp_path / "c" / "trajectories" / "robot_0_odometry.tum")[0])
        assert told == round((1.0 - figures["lost_share"][0]) * scans) < scans  # none while it was lost
    again = ["replay", str(tmp_path / "a"), "--prior", str(tmp_path / "map.npz"), "--localise", "--save", "d.npz"]
    assert "--localise changes none" in refusal(main, again)
    assert "name the map" in refusal(main, ["replay", str(tmp_path / "a"), "--localise"])


def test_a_prior_that_is_none_is_refused_before_the_log_is_looked_at_for_long(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(odometry_errors, "with_errors_of_log", lambda _: pytest.fail("the log was looked at"))
    (tmp_path / "a.npz").write_bytes(b"no map")
    assert main(["replay", "sample", "--prior", str(tmp_path / "a.npz")]) == 2
    assert "is not a saved map" in capsys.readouterr().err
