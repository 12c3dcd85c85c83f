"""Settings of files name Python classes (FILE.py:CLASS): they are executed only if the user says so."""

import json

import numpy as np
import pytest

from twc_env.__main__ import main
from twc_env.config import EnvConfig, code_named_in, override, to_dict

PLACES, GRAPH = "slam.place_recognition.recogniser", "slam.pose_graph.robust"
TRAP = """
from pathlib import Path

Path(__file__).with_name("sprung").touch()


class Trap:
    name = "lidar"

    def __init__(self, *_):
        pass

    def propose(self, keyframe, skipped_robots=()):
        return []

    def sparsify(self, is_held):
        pass

    def solve(self, poses, edges, measured, information, is_closure, fixed):
        return poses, ~is_closure
"""
SHORT = ("--robots", "1", "--steps", "5", "--set", "lidar.beam_count=60")


@pytest.fixture
def trap(tmp_path):
    """A file that leaves a mark when it is executed; the name of its class."""
    (tmp_path / "trap.py").write_text(TRAP)
    return f"{tmp_path / 'trap.py'}:Trap"


def is_sprung(tmp_path):
    return (tmp_path / "sprung").exists()


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("log")
    assert main(["record", *SHORT, "--out", str(folder)]) == 0
    return folder / "frames.npz"


def naming(log, key, code, path):
    """The log with other settings, as somebody may have sent it."""
    with np.load(log) as arrays:
        held = dict(arrays)
    settings = override(EnvConfig(), {"robots": 1, "max_cycles": 5, "lidar.beam_count": 60, key: code})
    np.savez(path, **{**held, "config": np.array(json.dumps(to_dict(settings)))})
    return str(path)


@pytest.mark.parametrize("key", [PLACES, GRAPH])
def test_a_log_executes_no_file_that_it_names_unless_it_may(key, log, trap, tmp_path, capsys):
    sent = naming(log, key, trap, tmp_path / "sent.npz")
    assert main(["replay", sent]) == 2
    error = capsys.readouterr().err
    assert f"{sent} names code to execute ({key}={trap})" in error
    assert "--allow-code" in error and error.count("\n") == 1
    assert not is_sprung(tmp_path)
    assert main(["replay", sent, "--set", f"{key}={'text' if key == PLACES else 'plain'}"]) == 0
    assert not is_sprung(tmp_path)
    if key == PLACES:  # a back end is executed at the first closure, which five steps do not have
        assert main(["replay", sent, "--allow-code"]) == 0
        assert is_sprung(tmp_path)


def test_the_command_line_itself_may_name_code(log, trap, tmp_path):
    assert main(["replay", str(log), "--set", f"{PLACES}={trap}"]) == 0
    assert is_sprung(tmp_path)


@pytest.mark.parametrize("command", ["explore", "compare", "benchmark"])
def test_a_settings_file_executes_no_file_that_it_names_unless_it_may(command, trap, tmp_path, capsys):
    path = tmp_path / "config.json"
    path.write_text(json.dumps({"slam": {"place_recognition": {"recogniser": trap}}, "lidar": {"beam_count": 60}}))
    call = [command, "--config", str(path), "--steps", "2", "--robots", "1"]
    call += ["--maps", "twin-01"] if command == "benchmark" else []
    call += [] if command == "compare" else ["--no-pictures", "--out", str(tmp_path / "run")]
    assert main(call) == 2
    error = capsys.readouterr().err
    assert f"{path} names code to execute" in error and "--allow-code" in error
    assert not is_sprung(tmp_path)
    if command == "explore":
        assert main([*call, "--allow-code"]) == 0
        assert is_sprung(tmp_path)


def test_a_run_folder_of_training_executes_no_file_that_it_names_unless_it_may(trap, tmp_path, capsys):
    pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")
    from twc_env.training.run_folder import Task, write_settings

    write_settings(tmp_path, "ppo", Task(overrides={PLACES: trap}), {})
    (tmp_path / "model.safetensors").write_bytes(b"")
    assert main(["evaluate", "--model", str(tmp_path), "--seeds", "0"]) == 2
    assert "names code to execute" in capsys.readouterr().err
    assert not is_sprung(tmp_path)
    assert main(["evaluate", "--model", str(tmp_path), "--seeds", "0", "--allow-code"]) == 2
    assert "cannot read the model" in capsys.readouterr().err


def test_every_setting_that_may_name_code_is_found():
    settings = {PLACES: "a.py:A", GRAPH: "b.py:B"}
    assert code_named_in(override(EnvConfig(), settings)) == settings
    assert code_named_in(EnvConfig()) == {}
