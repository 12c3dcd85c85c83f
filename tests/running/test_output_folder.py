"""One command at a time writes to a folder; a lock is free again once its holder has released it."""

import sys

import pytest

from twc_env.errors import DataError
from twc_env.processes.file_lock import FileLock
from twc_env.running.output_folder import alone_in, make_folder

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no file locks there")


def test_a_second_command_in_a_folder_is_refused_in_one_line_until_the_first_has_ended(tmp_path):
    folder = tmp_path / "runs" / "first"
    with alone_in(folder):
        refused = pytest.raises(DataError, match=r"another command writes to .*first: wait for its end")
        with refused as told, alone_in(folder, patience_s=0.05):
            pass
        assert "\n" not in str(told.value)
    with alone_in(folder, patience_s=0.05):
        pass
    assert not list(folder.iterdir()), "the lock file is gone"


def test_the_lock_is_free_after_an_error_in_the_block(tmp_path):
    with pytest.raises(KeyError), alone_in(tmp_path):
        raise KeyError
    assert FileLock(tmp_path / ".lock").take()


def test_a_file_where_the_folder_should_be_is_named(tmp_path):
    (tmp_path / "taken").write_text("", encoding="utf-8")
    with pytest.raises(DataError, match=r"cannot make the folder .*taken: .*; choose another with --out"):
        make_folder(tmp_path / "taken")


def test_a_lock_is_held_once_however_often_it_is_taken_and_released_once(tmp_path):
    lock, other = FileLock(tmp_path / "lock"), FileLock(tmp_path / "lock")
    assert lock.take() and lock.take() and other.take() is False
    lock.release()
    lock.release()
    assert other.take() is True


def test_a_lock_whose_folder_is_missing_is_no_lock(tmp_path):
    assert FileLock(tmp_path / "nowhere" / "lock").take() is None
