"""Finished parts are reused, but never those of other settings or other code."""

import math

import pytest

from twc_env import maps
from twc_env.errors import DataError
from twc_env.running.finished_parts import FinishedParts, code_digest


@pytest.fixture
def package(tmp_path, monkeypatch):
    """The folder of a package that can be imported; its digest is not cached."""
    folder = tmp_path / "toy_package"
    (folder / "sub").mkdir(parents=True)
    (folder / "__init__.py").write_text("")
    (folder / "sub" / "table.json").write_text("[1]")
    monkeypatch.syspath_prepend(tmp_path)
    code_digest.cache_clear()
    yield folder
    code_digest.cache_clear()


def refuse():
    raise AssertionError("was run again")


def test_a_part_is_computed_once_and_read_back_equal(tmp_path):
    first = FinishedParts(tmp_path, "table", {"a": 1}).once("x", lambda: {"n": (1, math.nan)})
    assert first == FinishedParts(tmp_path, "table", {"a": 1}).once("x", refuse) == {"n": [1, None]}


def test_other_settings_and_keys_are_computed_separately(tmp_path):
    FinishedParts(tmp_path, "table", {"a": 1}).once("x", lambda: 1)
    assert FinishedParts(tmp_path, "table", {"a": 2}).once("x", lambda: 2) == 2
    assert FinishedParts(tmp_path, "table", {"a": 1}).once("y", lambda: 3) == 3


def test_an_incomplete_part_is_computed_again(tmp_path):
    parts = FinishedParts(tmp_path, "table", {})
    parts.once("x", lambda: 1)
    (torn,) = parts.folder.iterdir()
    torn.write_text("[1, ")
    assert parts.once("x", lambda: 2) == 2
    assert parts.once("x", refuse) == 2


@pytest.mark.parametrize("change", [("0.25", "0.75"), ("ate_m", "ate_n"), ("{", "["), ("result", "results")])
def test_a_part_that_is_not_as_it_was_written_is_computed_again(tmp_path, change):
    parts = FinishedParts(tmp_path, "table", {})
    parts.once("x", lambda: {"ate_m": 0.25})
    (changed,) = parts.folder.iterdir()
    changed.write_text(changed.read_text().replace(*change))
    assert parts.once("x", lambda: {"ate_m": 0.5}) == {"ate_m": 0.5}
    for other in ("null", "{}", "[1]", "3"):
        changed.write_text(other)
        assert parts.find("x") is None


@pytest.mark.parametrize("changed", ["__init__.py", "sub/table.json", "sub/new.py"])
def test_parts_of_other_code_are_not_reused_and_reported(tmp_path, package, changed):
    old = FinishedParts(tmp_path / "out", "table", {}, ("toy_package",))
    old.once("x", lambda: 1)
    assert old.remark is None
    (package / changed).write_text("2")
    code_digest.cache_clear()
    new = FinishedParts(tmp_path / "out", "table", {}, ("toy_package",))
    assert "1 finished parts were computed by other code" in new.remark
    assert new.once("x", lambda: 2) == 2


def test_other_files_than_python_do_not_change_the_digest(package):
    before = code_digest("toy_package")
    (package / "notes.txt").write_text("x")
    code_digest.cache_clear()
    assert code_digest("toy_package") == before != code_digest()


def test_the_lock_of_an_editor_is_no_code(package):
    before = code_digest(package.name)
    (package / ".#code.py").symlink_to("somebody@a-machine.1234:1700000000")
    code_digest.cache_clear()
    assert code_digest(package.name) == before


def test_the_digest_of_the_code_includes_bundled_maps(tmp_path, package, monkeypatch):
    before = code_digest()
    (tmp_path / "maps").mkdir()
    monkeypatch.setattr(maps, "bundled_folder", lambda: tmp_path / "maps")
    code_digest.cache_clear()
    assert code_digest() != before


def test_the_error_of_an_unwritable_folder_names_it(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot write to the folder"):
        FinishedParts(tmp_path / "file", "table", {}).once("x", lambda: 1)


def test_the_error_of_a_missing_package_names_it():
    with pytest.raises(DataError, match="no package 'twc_envy'"):
        code_digest("twc_envy")
