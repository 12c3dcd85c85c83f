"""Where compiled kernels are kept: staleness, places that cannot be written, processes that start together."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from twc_env.kernels import cache_folder as places
from twc_env.processes.file_lock import FileLock

ROOT = Path(__file__).parents[2]
KERNELS = """from twc_env.kernels.compiled import kernel


@kernel
def doubled(x):
    if x < 0:
        raise ValueError("negative")
    return 2 * x


@kernel
def total(x, count):
    found = 0
    for i in range(count):
        found += doubled(x + i)
    return found
"""
CALL = """
import kernels
from twc_env.kernels.cache_folder import cache_folder, is_kept
assert kernels.total(3, 2) == 14
print(len(kernels.total.stats.cache_hits), is_kept(), cache_folder(), kernels.total.stats.cache_path)
"""


@pytest.fixture
def folder(tmp_path):
    """A folder with a module of two kernels, one of which calls the other."""
    (tmp_path / "kernels.py").write_text(KERNELS)
    return tmp_path


def begin(folder, code=CALL, **environment):
    kept = {name: os.environ[name] for name in ("PATH", "SYSTEMROOT") if name in os.environ}
    return subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=folder,
        env={**kept, "PYTHONPATH": str(ROOT), **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def said(process):
    text, errors = process.communicate()
    assert process.returncode == 0, errors
    hits, kept, folder, used = text.split()
    return int(hits), kept == "True", Path(folder), Path(used)


def test_a_second_process_reads_what_the_first_has_compiled(folder):
    cache = folder / "cache"
    first = said(begin(folder, NUMBA_CACHE_DIR=str(cache)))
    assert first[:2] == (0, True) and cache in first[2].parents and first[2] in first[3].parents
    assert said(begin(folder, NUMBA_CACHE_DIR=str(cache)))[0] == 1
    assert not list(cache.rglob("*.lock"))


USER = """from helping import FACTOR, doubled, unused
from twc_env.kernels.compiled import kernel


@kernel
def total(x, count):
    found = FACTOR
    for i in range(count):
        found += later(x + i)
    return found


@kernel
def later(x):
    return doubled(x)
"""
HELPING = """from values import FACTOR, Unused
from twc_env.kernels.compiled import kernel


def unused():
    return 1


@kernel
def doubled(x):
    return 2 * x
"""


def test_only_what_depends_on_a_change_compiles_anew(tmp_path):
    (tmp_path / "kernels.py").write_text(USER)
    (tmp_path / "helping.py").write_text(HELPING)
    (tmp_path / "values.py").write_text("FACTOR = 0\n\n\nclass Unused:\n    pass\n")
    call = "import kernels\nprint(kernels.total(3, 2), len(kernels.total.stats.cache_hits), 0, 0)"

    def results():
        process = begin(tmp_path, call, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
        text, errors = process.communicate()
        assert process.returncode == 0, errors
        return tuple(map(int, text.split()[:2]))

    assert (results(), results()) == ((14, 0), (14, 1))
    (tmp_path / "values.py").write_text("FACTOR = 0\n\n\nclass Unused:\n    changed = 1\n")
    assert results() == (14, 1)
    (tmp_path / "values.py").write_text("FACTOR = 5\n\n\nclass Unused:\n    pass\n")
    assert (results(), results()) == ((19, 0), (19, 1))
    (tmp_path / "helping.py").write_text(HELPING.replace("2 * x", "3 * x"))  # of the kernel called by a later kernel
    assert (results(), results()) == ((26, 0), (26, 1))


def test_contents_of_constants_are_told_apart():
    values = [1, 1.0, True, "1", b"1", None, (1, 2), (1, (2,)), np.arange(3), np.arange(3.0), np.arange(2000)]
    values += [np.where(np.arange(2000) == 1000, 0, np.arange(2000)), np.float32(1)]
    contents = [places._content(value) for value in values]
    assert None not in contents and len(set(contents)) == len(contents)


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
def test_damaged_files_are_compiled_anew(folder, suffix):
    cache = folder / "cache"
    said(begin(folder, NUMBA_CACHE_DIR=str(cache)))
    for path in cache.rglob(f"*.{suffix}"):
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
    process = begin(folder, NUMBA_CACHE_DIR=str(cache))
    text, errors = process.communicate()
    assert process.returncode == 0 and text.split()[0] == "0"
    assert errors.count("damaged files in") == 1
    assert said(begin(folder, NUMBA_CACHE_DIR=str(cache)))[0] == 1


@pytest.mark.parametrize("sums", [None, "", "{", "[]"])
def test_files_without_checksums_are_compiled_anew(folder, sums):
    """As after a kill between the two."""
    cache = folder / "cache"
    said(begin(folder, NUMBA_CACHE_DIR=str(cache)))
    (path,) = cache.rglob("sums.json")
    path.unlink()
    if sums is not None:
        path.write_text(sums)
    assert [said(begin(folder, NUMBA_CACHE_DIR=str(cache)))[0] for _ in range(2)] == [0, 1]


def test_a_folder_that_can_only_be_read_is_copied(folder):
    """As in an image whose kernels were compiled when it was built; also for root, who may write anywhere."""
    cache = folder / "cache"
    said(begin(folder, NUMBA_CACHE_DIR=str(cache)))
    refusing = (
        "import tempfile\nmake = tempfile.TemporaryFile\n"
        "def refuse(*a, dir=None, **k):\n"
        f"    if str(dir).startswith({str(cache)!r}):\n        raise PermissionError\n"
        "    return make(*a, dir=dir, **k)\n"
        "tempfile.TemporaryFile = refuse\n"
    )
    files = sorted(cache.rglob("*"))
    hits, kept, used, _ = said(begin(folder, refusing + CALL, NUMBA_CACHE_DIR=str(cache)))
    assert (hits, kept) == (1, False)
    assert cache not in used.parents and not used.exists()  # deleted at the end of the process
    assert sorted(cache.rglob("*")) == files


@pytest.mark.parametrize("environment", [{"HOME": "/proc/nowhere", "XDG_CACHE_HOME": "/proc/nowhere"}, {}])
def test_without_a_home_kernels_are_compiled_all_the_same(folder, environment):
    place = folder / "user"
    hits, kept, used, _ = said(begin(folder, **(environment or {"XDG_CACHE_HOME": str(place)})))
    assert hits == 0
    assert kept == (not environment) and used.exists() == kept


@pytest.mark.parametrize("is_named", [False, True])
def test_a_user_without_a_home_and_without_an_entry_compiles_all_the_same(folder, is_named):
    """As in a container that is started with a number of a user: `pwd` does not know it."""
    nameless = (
        "import os, pwd\n"
        "def unknown(uid):\n    raise KeyError(uid)\n"
        "pwd.getpwuid = unknown\nassert os.path.expanduser('~') == '~'\n"
    )
    where = {"NUMBA_CACHE_DIR": str(folder / "named")} if is_named else {}
    hits, kept, used, _ = said(begin(folder, nameless + CALL, **where))
    assert (hits, kept) == (0, is_named)
    assert used.exists() == is_named


def test_a_process_that_is_stopped_while_it_compiles_is_waited_for_once(folder):
    cache = folder / "cache"
    said(begin(folder, NUMBA_CACHE_DIR=str(cache)))
    (used,) = cache.iterdir()
    impatient = "from twc_env.kernels import compilation\ncompilation.SILENT_S, compilation.WAIT_MAX_S = 1.0, 2.0\n"
    more = "kernels.doubled(3), kernels.total(3.5, 2)\n"
    with FileLock(used / "compiling.lock").held(1.0):
        process = begin(folder, impatient + CALL + more, NUMBA_CACHE_DIR=str(cache))
        text, errors = process.communicate()
    assert process.returncode == 0, errors
    assert errors.count("waiting for another process") == 1 and "is it stopped?" in errors
    assert text.split()[0] == "1"


def test_of_processes_that_start_together_one_compiles_and_none_fails(folder):
    cache = folder / "cache"
    processes = [begin(folder, NUMBA_CACHE_DIR=str(cache)) for _ in range(8)]
    hits = sorted(said(process)[0] for process in processes)
    assert hits == [0] + 7 * [1]


def test_a_process_killed_while_it_compiles_leaves_nothing_in_the_way(folder):
    cache = folder / "cache"
    nap = (
        "import time\nfrom numba.core import event\nclass Nap(event.Listener):\n"
        "    def on_start(self, event):\n        print('compiling', flush=True)\n        time.sleep(600)\n"
        "    def on_end(self, event):\n        pass\n"
        "event.register('numba:compile', Nap())\n"
    )
    process = begin(folder, nap + CALL, NUMBA_CACHE_DIR=str(cache))
    assert process.stdout.readline() == "compiling\n"
    process.kill()
    process.communicate()
    begun = time.monotonic()
    assert said(begin(folder, NUMBA_CACHE_DIR=str(cache)))[0] == 0
    assert time.monotonic() - begun < 60.0


def test_a_kill_costs_no_kernel_that_was_compiled_before(folder):
    """While `both` is compiled, `doubled` is, and then `other`, whose begin is the end of the process."""
    cache = folder / "cache"
    more = "\n\n@kernel\ndef other(x):\n    return x + 1\n\n\n@kernel\ndef both(x):\n    return doubled(x) + other(x)\n"
    (folder / "kernels.py").write_text(KERNELS + more)
    killed = (
        "import os\nfrom numba.core import event\nclass Kill(event.Listener):\n"
        "    def on_start(self, event):\n"
        "        if event.data['dispatcher'].py_func.__name__ == 'other':\n            os._exit(9)\n"
        "    def on_end(self, event):\n        pass\n"
        "import kernels\nevent.register('numba:compile', Kill())\nkernels.both(3)\n"
    )
    process = begin(folder, killed, NUMBA_CACHE_DIR=str(cache))
    process.communicate()
    assert process.returncode == 9
    process = begin(folder, CALL.replace("total(3, 2) == 14", "doubled(3) == 6").replace(".total", ".doubled"),
                    NUMBA_CACHE_DIR=str(cache))  # fmt: skip
    text, errors = process.communicate()
    assert process.returncode == 0 and text.split()[0] == "1" and not errors


def test_folders_that_nobody_used_for_long_are_deleted(tmp_path):
    mine, old, recent, other = (tmp_path / f"{name}" for name in ("twc_env-1", "twc_env-2", "twc_env-3", "other"))
    for each in (mine, old, recent, other):
        each.mkdir()
        (each / "file").write_text("")
    long_ago = time.time() - (places.UNUSED_DAYS + 1) * 86400
    for each in (mine, old, other):
        os.utime(each, (long_ago, long_ago))
    places._delete_unused(mine)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["other", "twc_env-1", "twc_env-3"]
