"""Results are written as strict JSON, to paths that are checked in advance."""

import json
from pathlib import Path

import numpy as np
import pytest

from twc_env.errors import DataError
from twc_env.records.json_values import check_folder, check_writable, plain, write_json


def test_json_never_contains_nan(tmp_path):
    place = tmp_path / "new" / "a.json"
    write_json(place, {"a": np.float64("nan"), "b": [np.int64(2), float("inf")], "c": np.arange(2), 3: (True, "x")})
    assert json.loads(place.read_text()) == {"a": None, "b": [2, None], "c": [0, 1], "3": [True, "x"]}


def test_plain_values_survive_a_round_trip_through_json():
    values = plain({"a": np.eye(2), 1: (np.float64(1.5), None), "b": np.array(np.nan)})
    assert json.loads(json.dumps(values)) == values


def test_without_a_path_nothing_is_written():
    write_json(None, {"a": 1})
    check_writable(None)


def test_a_dash_writes_to_standard_output(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    check_writable(Path("-"))
    write_json(Path("-"), {"a": 1})
    assert json.loads(capsys.readouterr().out) == {"a": 1}
    assert list(tmp_path.iterdir()) == []


def test_an_unwritable_path_is_rejected_in_advance_and_when_writing(tmp_path):
    (tmp_path / "file").write_text("")
    for refuse in (check_writable, lambda path: write_json(path, {})):
        for place in (tmp_path / "file" / "a.json", tmp_path / "file" / "b" / "a.json", tmp_path):
            with pytest.raises(DataError, match="cannot write"):
                refuse(place)


def test_only_folders_that_cannot_be_created_are_rejected(tmp_path):
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "deep"):
        with pytest.raises(DataError, match=r"cannot write to the folder .*file is a file; choose another folder"):
            check_folder(folder)
    for folder in (None, tmp_path, tmp_path / "new" / "deep"):
        check_folder(folder)
    assert not (tmp_path / "new").exists()


def test_checking_a_path_creates_nothing(tmp_path):
    (tmp_path / "old.json").write_text("{}")
    check_writable(tmp_path / "old.json")
    check_writable(tmp_path / "new" / "deep" / "new.json")
    assert [path.name for path in tmp_path.iterdir()] == ["old.json"]


def test_a_device_is_a_valid_path():
    check_writable(Path("/dev/null"))
