"""Evaluation of trained teams in held-out buildings, with recording."""

import base64
import io
import json
import math
import pickle
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twc_env.__main__ import main
from twc_env.errors import DataError

pytestmark = pytest.mark.usefixtures("torch")


def test_a_trained_model_is_evaluated_against_random_actions(run, tmp_path, capsys):
    figures = tmp_path / "figures.json"
    assert main(["evaluate", "--model", str(run / "model.zip"), "--seeds", "0-1", "--json", str(figures)]) == 0
    table = capsys.readouterr().out.splitlines()
    written = json.loads(figures.read_text())
    assert set(written) == {"trained", "random", "nearest", "nearest-frontier"}
    assert all(f"{of['means']['coverage']:.3f}" in line for of, line in zip(written.values(), table[1:], strict=True))
    assert [line.split()[0] for line in table] == ["policy", "trained", "random", "nearest", "nearest-frontier"]
    assert all(math.isfinite(float(line.split()[1])) for line in table[1:])


def test_recording_a_trained_team_does_not_affect_the_episode(run, tmp_path):
    pytest.importorskip("PIL", reason="needs the extra 'viz'")
    from twc_env.training.evaluate import evaluate

    plain = evaluate(run, [0, 1], False)  # a run folder instead of a model file
    filmed = evaluate(run / "model.zip", [0, 1], False, tmp_path / "films")
    films = sorted(path.name for path in (tmp_path / "films").iterdir())
    assert len(films) == 2 and films[0].endswith("-seed0.gif") and films[1].endswith("-seed1.gif")
    assert filmed.episodes == plain.episodes


def test_coverage_does_not_depend_on_the_reward_of_training(task):
    from twc_env.training.evaluate import _nearest, _played, _scripted, _team

    team = replace(task, robots=3, max_cycles=60)
    alone = replace(team, overrides={**team.overrides, "reward.sharing": "individual"})
    for play in (lambda task: _played(task, 1, _team(task), _nearest), lambda task: _scripted(task, 1)):
        assert play(alone) == play(team)


def test_the_error_of_a_corrupt_model_or_one_of_another_task_names_it(task, run, tmp_path, capsys):
    from stable_baselines3 import PPO
    from twc_env.training.run_folder import write_settings

    shutil.copy(run / "config.json", tmp_path)
    sound, model = (run / "model.zip").read_bytes(), tmp_path / "model.zip"
    bent = bytearray(sound)
    bent[len(bent) // 2] ^= 255
    with zipfile.ZipFile(tmp_path / "foreign.zip", "w") as file:
        file.writestr("hello", "")
    PPO("MlpPolicy", "CartPole-v1", device="cpu").save(tmp_path / "other.zip")
    foreign = [(tmp_path / name).read_bytes() for name in ("foreign.zip", "other.zip")]
    for content in (sound[:1000], bytes(bent), b"", *foreign):
        model.write_bytes(content)
        assert main(["evaluate", "--model", str(model), "--seeds", "0"]) == 2
        error = capsys.readouterr().err
        assert f"cannot read the model {model}" in error and error.count("\n") == 1
    model.write_bytes(sound)
    write_settings(tmp_path, "ppo", replace(task, overrides={**task.overrides, "observation.sign_slots": 2}), {})
    assert main(["evaluate", "--model", str(model), "--seeds", "0"]) == 2
    assert "was trained with other observations or actions" in capsys.readouterr().err
    model.unlink()
    assert main(["evaluate", "--model", str(model), "--seeds", "0"]) == 2
    assert "there is no model" in capsys.readouterr().err


class Trap:
    """Makes a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def resealed(path, name, content):
    """Replace a part of a model file, whose checksum is right again."""
    from twc_env.records.seal import seal

    with zipfile.ZipFile(path) as archive:
        parts = {part: archive.read(part) for part in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for part, own in {**parts, name: content}.items():
            archive.writestr(part, own)
    seal(path)


def with_pickle(value):
    """As stable-baselines3 writes what is no plain value."""
    return {":type:": "function", ":serialized:": base64.b64encode(pickle.dumps(value)).decode()}


@pytest.mark.parametrize("place", ["lr_schedule", "episodes", "weights", "optimizer", "a model of stable-baselines3"])
@pytest.mark.parametrize("command", ["evaluate", "resume"])
def test_a_crafted_model_runs_no_code(command, place, task, settings, train, run, tmp_path, torch, capsys):
    from stable_baselines3.common.save_util import load_from_zip_file

    shutil.copytree(run, tmp_path / "run")
    model, trap = tmp_path / "run" / "model.zip", tmp_path / "trap"
    numbers = json.loads(zipfile.ZipFile(model).read("data"))
    if place in ("weights", "optimizer"):
        crafted = io.BytesIO()
        torch.save({"weights": Trap(trap)}, crafted)
        resealed(model, "policy.pth" if place == "weights" else "policy.optimizer.pth", crafted.getvalue())
    elif place == "a model of stable-baselines3":
        resealed(model, "data", json.dumps({"lr_schedule": with_pickle(Trap(trap)), "policy_class": {}}))
    else:
        resealed(model, "data", json.dumps({**numbers, place: with_pickle(Trap(trap))}))
    if command == "evaluate":
        assert main(["evaluate", "--model", str(model), "--seeds", "0"]) == 2
        error = capsys.readouterr().err
    else:
        with pytest.raises(DataError) as caught:
            train(task, settings, 192, tmp_path / "run", resume=True)
        error = f"{caught.value}\n"
    assert not trap.exists()
    assert "cannot read the model" in error and error.count("\n") == 1
    if "weights" not in place and place != "optimizer":
        assert "pickled objects" in error and "could run code" in error
        load_from_zip_file(model)  # the trap is a trap: stable-baselines3's own reader falls into it
        assert trap.exists()


def test_a_flipped_byte_of_a_model_is_refused(run, tmp_path):
    from twc_env.records.seal import is_unbroken

    path, sound = tmp_path / "model.zip", (run / "model.zip").read_bytes()
    path.write_bytes(sound)
    assert is_unbroken(path)
    random = np.random.default_rng(0)
    for place in random.integers(len(sound), size=200):
        bent = bytearray(sound)
        bent[place] ^= int(random.integers(1, 256))
        path.write_bytes(bent)
        assert not is_unbroken(path)


def test_one_building_is_printed_without_a_spread():
    from twc_env.training.evaluate import POLICIES, Episode, Evaluation  # needs torch

    one = {name: (Episode(0.9, 0.5, 2, 0),) for name in POLICIES}
    rows = Evaluation((0,), one).table.splitlines()[1:]
    assert [row.split() for row in rows[:2]] == [
        ["trained", "0.900", "0.500", "2.00", "0"], ["random", "0.900", "0.500", "+0.000", "2.00", "0"]
    ]  # fmt: skip
