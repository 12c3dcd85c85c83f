"""Accidents that meet commands: kills, Ctrl-C, no room, no right to write, closed pipes, two at once, another time.

After each: no traceback, no half file, every file that was said to be written is there, and the same command once more
in the same folder ends as if nothing had happened. All pairs take hours: a file keeps the outcomes of one version of
the code, and a run goes on with those that it lacks.
"""

from __future__ import annotations

import ctypes
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from tests.soak.attempts import Attempt, append_row, kept_rows, workplace
from twc_env.records.seal import is_unbroken

SETTINGS = ("--set", "lidar.beam_count=60")
COMMANDS: dict[str, tuple[str, ...]] = {
    "explore": ("explore", "--robots", "1", "--steps", "150", "--no-pictures", *SETTINGS),
    "record": ("record", "--robots", "1", "--steps", "150", *SETTINGS),
    "replay": ("replay", "LOG"),
    "compare": (
        "compare",
        "--agents",
        "nearest-frontier",
        "--maps",
        "twin-01",
        "twin-02",
        "--steps",
        "60",
        "--no-pictures",
    ),
    "benchmark": ("benchmark", "--maps", "twin-01", "--seeds", "0-1", "--steps", "60", "--no-pictures"),
    "train": ("train", "mappo", "--steps", "300", "--workers", "0", "--max-cycles", "40", "--references", "0"),
    "reproduce": (
        "reproduce",
        "reality",
        "--effects",
        "lost frames",
        "--buildings",
        "2",
        "--area",
        "150",
        "--robots",
        "1",
        "--steps",
        "60",
    ),
}
"""Small runs; each gets `--out`, but `reproduce`, which gets `--json` in the folder."""
WORKERS = {**dict.fromkeys(("compare", "benchmark", "reproduce"), ("--jobs", "2")), "train": ("--workers", "2")}
"""Of commands that start processes, how to have two; `train` names that option once more, and the last one counts."""
RESUMED = ("train",)
"""Commands that go on with `--resume`; others find what is finished by themselves, or begin anew."""
PROGRAM = (
    "import os, sys; sys.argv[0] = 'twc-env'\n{0}\nfrom twc_env.__main__ import main\n"
    "if __name__ == '__main__': sys.exit(main(sys.argv[1:]))"
)
ROOM = (
    "import atexit, resource; before = resource.getrlimit(resource.RLIMIT_FSIZE); "
    "resource.setrlimit(resource.RLIMIT_FSIZE, (3000, before[1])); "
    "atexit.register(resource.setrlimit, resource.RLIMIT_FSIZE, before); sys.dont_write_bytecode = True"
)
"""Until the command ends: what counts the lines that tests run writes its file then."""
MEMORY = "import resource; resource.setrlimit(resource.RLIMIT_AS, (700_000_000,) * 2)"
CLOCK = "import time; real = time.time; time.time = lambda: real() - 86400.0 * (time.process_time() > {moment_s})"
_PR_CAPBSET_DROP, _CAP_DAC_OVERRIDE = 24, 1
"""Of prctl(2): without this capability the rights of folders count for root too."""
SECONDS = 900.0
"""A command that takes longer hangs, also on a machine that others use."""


_EVERY_S = 0.1
"""How often the processor time of a command is looked at, which costs some itself."""


def pairs() -> list[tuple[str, str]]:
    """Command and accident, all pairs that exist: a worker can be killed only where there are some."""
    names = [name for name in COMMANDS if name != "train" or find_spec("torch")]
    return [(name, kind) for kind in ACCIDENTS for name in names if kind != WORKER_KILLED or name in WORKERS]


def accidents(count: int, seed: int = 0, kept: Path | None = None) -> Iterator[Attempt]:
    """Up to `count` of all pairs of a command and an accident, kills at random moments; equal seeds, equal order.

    A moment is a share of the processor time that the command takes undisturbed: on a busy machine, seconds would all
    lie in its start. kept: a file of outcomes, a line each, which are not played again."""
    random = np.random.default_rng(seed)
    rows = [] if kept is None else kept_rows(kept)
    known = {(row["number"], row["accident"]): row["wrong"] for row in rows if row.get("accident_seed") == seed}
    taken_s = {row["undisturbed"]: row["taken_s"] for row in rows if "undisturbed" in row}
    every = pairs()
    with workplace() as folder:
        log = folder / "log" / "frames.npz"
        for number in range(count):
            name, kind = every[number % len(every)]
            share, what = float(random.uniform(0.05, 1)), f"{name}, {kind}"
            if (number, what) in known:
                yield what, partial(_as_before, known[number, what])
                continue
            if not log.exists():
                _finished(
                    _started(("record", "--robots", "1", "--steps", "30", *SETTINGS, "--out", log.parent), folder)
                )
            if name not in taken_s:
                for out in (f"{name}-first", name):  # the first run may compile
                    taken_s[name] = _undisturbed_s(_arguments(name, folder / out, log), folder)
                if kept is not None:
                    append_row(kept, {"undisturbed": name, "taken_s": taken_s[name]})
            place = folder / f"{number}"
            place.mkdir()
            row = {"accident": what, "number": number, "accident_seed": seed, "moment_s": share * taken_s[name]}
            yield what, partial(_met, name, kind, place, log, row, kept)
            shutil.rmtree(place, ignore_errors=True)


def _met(name: str, kind: str, place: Path, log: Path, row: dict, kept: Path | None) -> None:
    """Play a pair, and keep its outcome."""
    try:
        meet(name, kind, place, log, row["moment_s"])
        row["wrong"] = ""
    except (AssertionError, OSError, ValueError) as error:
        row["wrong"] = f"{type(error).__name__} after {row['moment_s']:.1f} s: {error}"
    if kept is not None:
        append_row(kept, row)
    _as_before(row["wrong"])


def _as_before(wrong: str) -> None:
    assert not wrong, wrong


def _arguments(name: str, out: Path, log: Path) -> tuple[str, ...]:
    words = tuple(str(log) if word == "LOG" else word for word in COMMANDS[name])
    if name == "reproduce":
        return (*words, "--json", str(out / "table.json"), "--cache", str(out))
    return (*words, "--out", str(out))


def _undisturbed_s(arguments: tuple[str, ...], place: Path) -> float:
    """Processor time of a command that nothing happens to [s]."""
    running, used_s = _started(arguments, place), 0.0
    while running.poll() is None:
        used_s = max(used_s, _used_s(running.pid))
        time.sleep(_EVERY_S)
    told = running.communicate()[0]
    assert running.returncode == 0, f"undisturbed it ends with status {running.returncode}: {told[-300:]}"
    return used_s


def _used_s(session: int) -> float:
    """Processor time of all processes that live in a session, and of those they have waited for [s]."""
    ticks = 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:  # it has ended
            continue
        if int(fields[3]) == session:
            ticks += sum(int(field) for field in fields[11:15])
    return ticks / os.sysconf("SC_CLK_TCK")


def meet(name: str, kind: str, place: Path, log: Path, moment_s: float) -> None:
    """Let a command meet an accident (signals after so much processor time), look at what is left, and run it again."""
    out = place / "out"
    arguments = _arguments(name, out, log)
    hurt = (*arguments, *WORKERS[name]) if kind == WORKER_KILLED else arguments
    status, told = ACCIDENTS[kind](hurt, out, moment_s)
    assert "Traceback" not in told, f"a traceback: {told[-300:]}"
    assert status != 1, f"status 1: {told[-300:]}"
    look_at(out, may_have_parts=kind == "kill -9")
    if lost := [path for path in written(told, out) if not path.exists()]:
        raise AssertionError(f"said to be written, and not there: {lost[0]}")
    again = (*arguments, "--resume") if name in RESUMED and (out / "model.safetensors").exists() else arguments
    status, told = _finished(_started(again, place))
    refused = status == 2 and name in RESUMED and "--resume" in told
    assert status == 0 or refused, f"once more it ends with status {status}: {told[-300:]}"
    look_at(out, may_have_parts=kind == "kill -9")


def look_at(folder: Path, may_have_parts: bool = False) -> None:
    """Every file is whole. Raises AssertionError otherwise."""
    for path in folder.rglob("*") if folder.exists() else ():
        if path.name.startswith(".part-"):
            assert may_have_parts, f"{path.name} is left"
            continue
        if path.suffix == ".json":
            json.loads(path.read_text())
        elif path.suffix == ".npz":
            assert is_unbroken(path), f"{path.name} is cut off"
            np.load(path).close()
        elif path.suffix == ".tum":
            assert np.loadtxt(path, ndmin=2).shape[1] == 8, f"{path.name} is cut off"
        elif path.suffix == ".csv" and (text := path.read_text()):
            assert text.endswith("\n"), f"{path.name} is cut off"
        elif path.suffix == ".safetensors":
            from twc_env.training.checkpoint import load

            load(path)


def written(told: str, out: Path) -> list[Path]:
    """Files and folders within a folder that a command's last words name, but for those of its errors."""
    lines = [line for line in told.splitlines() if not line.startswith(("error:", "warning:"))]
    return [
        Path(path.rstrip(".,:;")) for line in lines for path in re.findall(rf"{re.escape(str(out))}[^\s'\"()]*", line)
    ]


def _started(arguments: tuple, place: Path, before: str = "pass", **options) -> subprocess.Popen:
    place.mkdir(parents=True, exist_ok=True)
    before = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n" + before
    call = [sys.executable, "-c", PROGRAM.format(before), *map(str, arguments)]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, **options}
    return subprocess.Popen(call, text=True, start_new_session=True, **streams)


def _finished(running: subprocess.Popen) -> tuple[int, str]:
    try:
        told, _ = running.communicate(timeout=SECONDS)
    except subprocess.TimeoutExpired:
        running.kill()
        told, _ = running.communicate()
        raise AssertionError(f"it hangs: {told[-300:]}") from None
    return running.returncode, told or ""


def _signalled(signals: tuple[int, ...], arguments: tuple[str, ...], out: Path, moment_s: float) -> tuple[int, str]:
    """Send signals at a moment of the work."""
    running = _started(arguments, out.parent)
    while running.poll() is None and _used_s(running.pid) < moment_s:
        time.sleep(_EVERY_S)
    for number in signals:
        if running.poll() is None:
            running.send_signal(number)
            time.sleep(0.5)
    status, told = _finished(running)
    return (0 if status == -signal.SIGKILL else status), told


def _limited(before: str, arguments: tuple[str, ...], out: Path, moment_s: float) -> tuple[int, str]:
    return _finished(_started(arguments, out.parent, before.replace("{moment_s}", str(moment_s))))


def _read_only(arguments: tuple[str, ...], out: Path, _: float) -> tuple[int, str]:
    """In a folder of a run before, that nobody may write to."""
    out.mkdir(parents=True)
    (out / "kept.json").write_text("{}\n")
    out.chmod(0o555)
    status, told = _finished(_started(arguments, out.parent, preexec_fn=_without_rights_of_root))
    out.chmod(0o755)
    assert status == 2, f"status {status}: {told[-300:]}"
    assert [path.name for path in out.iterdir()] == ["kept.json"], "it wrote to a folder that is read-only"
    return status, told


def _without_rights_of_root() -> None:
    ctypes.CDLL(None).prctl(_PR_CAPBSET_DROP, _CAP_DAC_OVERRIDE, 0, 0, 0)


def _worker_killed(arguments: tuple[str, ...], out: Path, moment_s: float) -> tuple[int, str]:
    """Kill a worker process, as the system does where memory ends."""
    running = _started(arguments, out.parent)
    while running.poll() is None and _used_s(running.pid) < moment_s:
        time.sleep(_EVERY_S)
    while running.poll() is None:
        if workers := _workers(running.pid):
            os.kill(workers[0], signal.SIGKILL)
            break
        time.sleep(_EVERY_S)
    return _finished(running)


def _workers(session: int) -> list[int]:
    """Worker processes that a command has started."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            fields = (path / "stat").read_text().rpartition(")")[2].split()
            is_worker = int(fields[3]) == session and b"spawn_main" in (path / "cmdline").read_bytes()
        except OSError:  # it has ended
            continue
        if is_worker:
            found.append(int(path.name))
    return sorted(found)


def _closed_pipe(arguments: tuple[str, ...], out: Path, _: float) -> tuple[int, str]:
    running = _started(arguments, out.parent, stderr=subprocess.DEVNULL)
    assert running.stdout is not None
    running.stdout.close()
    return running.wait(SECONDS), ""


def _two_at_once(arguments: tuple[str, ...], out: Path, _: float) -> tuple[int, str]:
    both = [_started(arguments, out.parent) for _ in range(2)]
    (first, told), (second, also) = map(_finished, both)
    assert 0 in (first, second), f"neither ends well: {told[-200:]} {also[-200:]}"
    return max(first, second), told + also


WORKER_KILLED = "a worker killed"
Accident = Callable[[tuple[str, ...], Path, float], tuple[int, str]]
ACCIDENTS: dict[str, Accident] = {
    "kill -9": partial(_signalled, (signal.SIGKILL,)),
    "SIGTERM": partial(_signalled, (signal.SIGTERM,)),
    "Ctrl-C": partial(_signalled, (signal.SIGINT,)),
    "Ctrl-C twice": partial(_signalled, (signal.SIGINT, signal.SIGINT)),
    "no room": partial(_limited, ROOM),
    "read-only folder": _read_only,
    "closed pipe": _closed_pipe,
    "two at once": _two_at_once,
    "clock set back": partial(_limited, CLOCK),
    "little memory": partial(_limited, MEMORY),
    WORKER_KILLED: _worker_killed,
}
