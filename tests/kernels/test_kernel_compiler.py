"""Cache files of kernels: atomic, compiled once, and only for kernels that Python calls."""

import contextlib
import os
import subprocess
import sys

import numba
import numpy as np
import pytest
from numba.core import errors
from numba.core.codegen import JITCPUCodegen
from numba.core.postproc import PostProcessor
from numba.core.target_extension import current_target
from numba.core.types.functions import BaseFunction
from numba.core.typing.context import BaseContext

from tests.forks import ALONE
from twc_env.kernels import kernel_compiler
from twc_env.kernels.compiled import kernel
from twc_env.kernels.kernel_compiler import Part
from twc_env.running import file_lock
from twc_env.running.file_lock import FileLock

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
REPORT = "print(len(kernels.total.stats.cache_hits), len(kernels.total.stats.cache_misses))"
CALL = f"import kernels; assert kernels.total(3, 2) == 14; {REPORT}"
SLOW = f"""
import time
from numba.core import event

class Nap(event.Listener):
    def on_start(self, event):
        print("compiling", flush=True)
        time.sleep({{nap_s}})

    def on_end(self, event):
        pass

event.register("numba:compile", Nap())
{CALL}
"""


@pytest.fixture
def folder(tmp_path):
    """A folder with a module of two kernels, one of which calls the other."""
    (tmp_path / "kernels.py").write_text(KERNELS)
    return tmp_path


@pytest.fixture(scope="module", autouse=True)
def forks(kernel_forks):
    global FORKS
    FORKS = kernel_forks


def said(folder, code=CALL):
    status, text = FORKS.run(code, folder)
    assert status == 0, text
    return text.split()


def hits_and_misses(folder, code=CALL):
    return tuple(map(int, said(folder, code)[-2:]))


def begin(folder, code):
    """Start a process without waiting for its end."""
    return subprocess.Popen([sys.executable, "-c", code], cwd=folder, env=ALONE, stdout=subprocess.PIPE, text=True)


def files(folder, ending="nbc"):
    return sorted(path.name.split("-")[0] for path in (folder / "__pycache__").glob(f"*.{ending}"))


def test_a_kernel_called_by_kernels_is_a_part_until_python_calls_it(folder):
    assert hits_and_misses(folder) == (0, 1)
    assert files(folder) == ["kernels.total"]
    assert hits_and_misses(folder, f"{CALL}; assert kernels.doubled(4) == 8") == (1, 0)
    assert files(folder) == ["kernels.doubled", "kernels.total"]


def test_a_part_called_by_python_becomes_a_kernel_and_raises_its_errors():
    part = kernel(lambda x: 1 / x if x > 0 else -x)
    whole = kernel(lambda x: part(x) + 1)
    for made in (part, whole):
        made._cache.disable()  # cache files of earlier runs would be complete
    assert whole(2.0) == 1.5
    (found,) = part.overloads.values()
    assert isinstance(found.entry_point, Part)
    assert part(4.0) == 0.25
    (found,) = part.overloads.values()
    assert not isinstance(found.entry_point, Part)
    assert whole(4.0) == 1.25


def test_only_the_kernel_itself_becomes_machine_code(monkeypatch):
    made: list[str] = []
    add = JITCPUCodegen._add_module

    def note(codegen, code):
        made.append(code.name)
        return add(codegen, code)

    monkeypatch.setattr(JITCPUCodegen, "_add_module", note)
    part = kernel(lambda values: max(values[0], 2.0) ** 3 + int(values[1]))
    whole = kernel(lambda count: part(np.zeros((count, 2)).reshape(-1)) + np.full(count, 4).sum())
    whole._cache.disable()
    assert whole(5) == 28.0
    assert len(made) == 1


def test_numba_is_restored_after_a_compilation_or_an_error():
    whole = kernel(lambda x: np.zeros(3)[x] + max(x, 1))
    for made, numbers in ((whole, 2), (kernel(lambda x: x + "no such sum"), 2)):
        made._cache.disable()
        with contextlib.suppress(numba.TypingError):
            made(numbers)
        assert current_target() == "cpu"
        assert BaseFunction.get_call_type.__module__.startswith("numba.")
        assert PostProcessor.run.__module__.startswith("numba.")
        assert BaseContext.resolve_value_type.__module__.startswith("numba.")
        assert "errmsg" not in vars(errors.termcolor())
    assert numba.njit(lambda x: np.zeros(3)[x] + max(x, 1) + whole(x))(2) == 4.0


def test_errors_of_parts_reach_python(folder):
    code = """
import kernels
for call in (lambda: kernels.total(-3, 2), lambda: kernels.doubled(-3)):
    try:
        call()
    except ValueError as error:
        print(error)
"""
    for _ in range(2):  # compiled, then read from disk
        assert said(folder, code) == ["negative", "negative"]


@pytest.mark.skipif(sys.platform == "win32", reason="no such locks there")
def test_of_concurrent_processes_one_compiles_a_kernel_and_the_others_wait(folder):
    processes = [begin(folder, SLOW.format(nap_s=1.0)) for _ in range(3)]
    ends = [tuple(map(int, process.communicate()[0].split()[-2:])) for process in processes]
    assert sorted(ends) == [(0, 1), (1, 0), (1, 0)]
    assert files(folder, "lock") == []


@pytest.mark.skipif(sys.platform == "win32", reason="no such locks there")
def test_a_process_killed_while_compiling_leaves_no_file_and_no_lock(folder):
    process = begin(folder, SLOW.format(nap_s=600.0))
    assert process.stdout.readline() == "compiling\n"
    process.kill()
    process.communicate()
    assert files(folder) == []
    assert hits_and_misses(folder) == (0, 1)


def test_a_corrupt_cache_file_is_replaced(folder):
    assert hits_and_misses(folder) == (0, 1)
    (path,) = (folder / "__pycache__").glob("*.nbc")
    path.write_bytes(path.read_bytes()[:100])
    assert hits_and_misses(folder) == (0, 1)
    assert hits_and_misses(folder) == (1, 0)


def test_cache_files_of_earlier_sources_are_deleted(folder):
    assert hits_and_misses(folder) == (0, 1)
    (folder / "kernels.py").write_text(KERNELS + "\n")
    assert hits_and_misses(folder) == (0, 1)
    assert files(folder) == ["kernels.total"]


def test_without_a_writable_folder_kernels_are_compiled_in_memory(monkeypatch):
    def refuse(_function):
        raise RuntimeError("no locator available")

    monkeypatch.setattr(kernel_compiler, "_Places", refuse)
    made = kernel(lambda x: x + 1)
    assert made(np.arange(2)).tolist() == [1, 2]
    assert made.stats.cache_path is None


NOWHERE = f"""
import os, numba, numba.core.caching as caching

os.environ.update({{names!r}})
numba.config.reload_config()

class Refusing:
    @staticmethod
    def TemporaryFile(dir):
        if not os.path.realpath(dir).startswith({{writable!r}}):
            raise PermissionError
        return open(os.devnull)

caching.tempfile = Refusing
{CALL}
print(kernels.total.stats.cache_path)
"""


def read_only(folder, writable="nothing", **names):
    """Cache hits, misses and the cache folder of a process that can write to this folder only."""
    hits, misses, place = said(folder, NOWHERE.format(writable=str(writable), names=names))
    return int(hits), int(misses), place


def test_cache_files_in_a_read_only_folder_are_loaded(folder, tmp_path):
    assert read_only(folder) == (0, 1, "None")
    assert hits_and_misses(folder) == (0, 1)
    assert read_only(folder) == (1, 0, "None")
    home = tmp_path / "home"
    home.mkdir()
    hits, misses, place = read_only(folder, home, HOME=str(home))
    assert (hits, misses) == (1, 0) and place.startswith(str(home))
    assert not list(home.rglob("*.nbc"))
    (folder / "kernels.py").write_text(KERNELS + "\n")
    assert read_only(folder, home, HOME=str(home))[:2] == (0, 1)
    assert len(list(home.rglob("*.nbc"))) == 1
    assert read_only(folder, home, HOME=str(home))[:2] == (1, 0)


def test_with_numba_cache_dir_kernels_are_loaded_from_there_only(folder, tmp_path):
    named = {"NUMBA_CACHE_DIR": str(tmp_path / "named")}
    assert hits_and_misses(folder) == (0, 1)
    assert read_only(folder, **named) == (0, 1, "None")
    assert read_only(folder, tmp_path / "named", **named)[:2] == (0, 1)
    assert read_only(folder, **named) == (1, 0, "None")


def test_kernels_with_bounds_checks_have_separate_files(folder):
    checked = "import numba; numba.config.BOUNDSCHECK = 1\n" + CALL
    assert hits_and_misses(folder) == (0, 1)
    assert [hits_and_misses(folder, code) for code in (checked, checked, CALL)] == [(0, 1), (1, 0), (1, 0)]


def test_a_full_disk_leaves_no_partial_file(folder):
    full = """
import os, kernels
def refuse(*paths): raise OSError(28, "no room")
os.replace = refuse
assert kernels.total(3, 2) == 14
print(0, 0)
"""
    assert hits_and_misses(folder, full) == (0, 0)
    assert files(folder, "tmp") == files(folder) == []
    assert hits_and_misses(folder) == (0, 1)


def test_without_locks_each_process_compiles_for_itself(monkeypatch, tmp_path):
    naps: list[float] = []
    monkeypatch.setattr(file_lock.time, "sleep", naps.append)
    monkeypatch.setattr(FileLock, "take", lambda _self: None)
    with FileLock(tmp_path / "x.lock").held(120.0), FileLock(tmp_path / "x.lock").held(120.0):
        assert naps == []


@pytest.mark.skipif(sys.platform == "win32", reason="no such locks there")
def test_waiting_for_a_lock_is_limited(monkeypatch, tmp_path):
    clock = iter(range(0, 10_000, 50))
    monkeypatch.setattr(file_lock.time, "monotonic", lambda: next(clock))
    monkeypatch.setattr(file_lock.time, "sleep", lambda _seconds: None)
    lock = FileLock(tmp_path / "x.lock")
    assert lock.take()
    with FileLock(tmp_path / "x.lock").held(120.0) as is_held:
        assert not is_held
        assert lock.take()


@pytest.mark.skipif(sys.platform == "win32", reason="no such locks there")
def test_a_lock_has_one_holder_at_a_time(tmp_path):
    first, second = FileLock(tmp_path / "lock"), FileLock(tmp_path / "lock")
    assert (first.take(), first.take(), second.take()) == (True, True, False)
    second.release()
    assert second.take() is False
    first.release()
    assert second.take() is True
    second.release()
    assert list(tmp_path.iterdir()) == []
    assert FileLock(tmp_path / "no such folder" / "lock").take() is None


@pytest.mark.skipif(sys.platform == "win32", reason="no such locks there")
def test_a_lock_released_while_another_takes_it_has_one_holder(tmp_path, monkeypatch):
    first, second, third = (FileLock(tmp_path / "lock") for _ in range(3))
    assert first.take()
    opened = os.open

    def given_up(*arguments):
        descriptor = opened(*arguments)
        first.release()
        return descriptor

    monkeypatch.setattr(os, "open", given_up)
    assert (second.take(), third.take()) == (True, False)


@pytest.mark.parametrize(
    ("version", "is_known"), [("0.62.1", True), ("0.68.1", True), ("0.61.2", False), ("1.0", False)]
)
def test_with_an_unsupported_numba_kernels_are_plain_njit_functions_without_cache(monkeypatch, version, is_known):
    monkeypatch.setattr(numba, "__version__", version)
    twice = kernel(lambda x: 2 * x)
    assert isinstance(twice, kernel_compiler.KernelDispatcher) == is_known
    if not is_known:
        assert twice(3) == 6 and twice._cache.cache_path is None
