"""Checkpoints run no code, are whole or absent, and are refused if a byte has changed."""

import json
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest

from twc_env.__main__ import main
from twc_env.errors import DataError

pytestmark = pytest.mark.usefixtures("torch")

ARRAYS = {
    "a": np.arange(6, dtype=np.float32).reshape(2, 3),
    "b": np.zeros((0, 2), np.int64),
    "c": np.ones(3, bool),
    "d": np.array(2.5),
}
VALUES = {"seed": 3, "open": [[0, 1, 0.1]], "text": "é"}


class Trap:
    """Makes a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_a_checkpoint_gives_back_what_was_saved_and_the_same_content_has_the_same_bytes(tmp_path):
    from twc_env.training.checkpoint import load, save

    for name in ("one", "two"):
        save(tmp_path / name, dict(sorted(ARRAYS.items(), reverse=name == "two")), VALUES)
    arrays, values = load(tmp_path / "one")
    assert values == VALUES and arrays.keys() == ARRAYS.keys()
    assert all(arrays[k].dtype == ARRAYS[k].dtype and np.array_equal(arrays[k], ARRAYS[k]) for k in ARRAYS)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


def test_a_flipped_byte_and_every_cut_off_file_are_refused(tmp_path):
    from twc_env.training.checkpoint import load, save

    path = tmp_path / "model.safetensors"
    save(path, ARRAYS, VALUES)
    sound, random = path.read_bytes(), np.random.default_rng(0)
    for place in range(len(sound)):
        bent = bytearray(sound)
        bent[place] ^= int(random.integers(1, 256))
        path.write_bytes(bent)
        with pytest.raises(DataError, match=r"cannot read the model .*; train anew, or name another"):
            load(path)
    for length in range(0, len(sound), 7):
        path.write_bytes(sound[:length])
        with pytest.raises(DataError, match="cannot read the model"):
            load(path)


def test_a_crash_while_saving_leaves_the_old_file(tmp_path, monkeypatch):
    from twc_env.training.checkpoint import load, save

    path = tmp_path / "model.safetensors"
    save(path, ARRAYS, VALUES)

    def crash(_):
        raise KeyboardInterrupt

    monkeypatch.setattr("os.fsync", crash)
    with pytest.raises(KeyboardInterrupt):
        save(path, {}, {})
    assert load(path)[1] == VALUES and [each.name for each in tmp_path.iterdir()] == ["model.safetensors"]


@pytest.mark.parametrize("kind", ["pickle", "torch", "a model of stable-baselines3", "trap in the header"])
@pytest.mark.parametrize("command", ["evaluate", "resume"])
def test_a_crafted_model_runs_no_code(command, kind, task, settings, train, run, tmp_path, torch, capsys):
    import zipfile

    shutil.copytree(run, tmp_path / "run")
    model, trap = tmp_path / "run" / "model.safetensors", tmp_path / "trap"
    if kind == "pickle":
        model.write_bytes(pickle.dumps(Trap(trap)))
    elif kind == "torch":
        torch.save({"weights": Trap(trap)}, model)
    elif kind == "trap in the header":
        header = json.dumps({"__metadata__": {"twc_env": pickle.dumps(Trap(trap), 0).decode()}}).encode()
        model.write_bytes(len(header).to_bytes(8, "little") + header)
    else:
        with zipfile.ZipFile(model, "w") as archive:
            archive.writestr("data", pickle.dumps(Trap(trap)))
    if command == "evaluate":
        assert main(["evaluate", "--model", str(model), "--seeds", "0"]) == 2
        error = capsys.readouterr().err
    else:
        with pytest.raises(DataError) as caught:
            train(task, settings, 192, tmp_path / "run", resume=True)
        error = f"{caught.value}\n"
    assert not trap.exists()
    assert "cannot read the model" in error and error.count("\n") == 1
    if kind != "trap in the header":
        assert "could run code" in error
    if kind == "torch":  # the trap is a trap: torch's own reader falls into it
        torch.load(shutil.copy(model, tmp_path / "model.pt"), weights_only=False)
        assert trap.exists()
