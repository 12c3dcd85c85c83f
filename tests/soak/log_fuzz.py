"""Damaged logs: bags of every kind, tables of readings, CARMEN logs. Replaying one may only raise TwcError."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from tests.soak.attempts import Attempt, workplace
from tests.soak.mutations import OF_TEXT, mutated
from twc_env.datasets.logs.carmen_writer import write_carmen_log
from twc_env.datasets.logs.scan_log import ScanLog
from twc_env.datasets.ros.bag_writer import RobotRecording, write_recording
from twc_env.records.random_streams import random_stream
from twc_env.records.scanner import Scanner
from twc_env.replaying.inputs import Asked, read_input
from twc_env.replaying.run import run

_SCANS, _BEGUN_S = 10, 1000.0
TEXTS = (".csv", ".log", ".yaml")


def damaged_logs(count: int, seed: int = 0) -> Iterator[Attempt]:
    """Replay `count` damaged logs, or tables beside a sound log; equal seeds give the same files."""
    random = random_stream(seed, "log-fuzz")
    with workplace() as folder:
        samples = _samples(folder)
        for name in ("sound.log", "a.bag"):  # kernels compile before the clock runs
            _replay(folder / name)()
        for number in range(count):
            sample = samples[number % len(samples)]
            place, what = _damaged(folder, sample, random)
            tables = {sample.stem: (place,)} if sample.suffix == ".csv" else {}
            yield f"#{number} {sample.name}: {what}", _replay(folder / "sound.log" if tables else place, tables)


def _replay(log: Path, tables: dict[str, tuple[Path]] | None = None) -> Callable[[], None]:
    def replay() -> None:
        source = read_input([log], Asked(**(tables or {})))
        run(source, source.config)

    return replay


def _samples(folder: Path) -> list[Path]:
    """One sound file of every kind; the tables belong to sound.log."""
    turn = np.linspace(0.0, 2.0, _SCANS)
    poses = np.stack([2.0 * np.cos(turn), 2.0 * np.sin(turn), turn], axis=1)
    times_s, angles = _BEGUN_S + np.arange(_SCANS), np.radians(np.arange(-90.0, 90.0, 2.0))
    ranges = np.round(4.0 + np.cos(angles[None] + turn[:, None]), 2)
    write_carmen_log(folder / "sound.log", ScanLog(times_s, poses, ranges, angles), 20.0)
    shutil.copy(folder / "sound.log", folder / "carmen.log")
    scanner = Scanner(-math.pi / 2, math.radians(2.0), (0.1, 0.0, 0.1), 0.1, 20.0, sweep_s=0.05)
    rates = np.full(_SCANS, 0.1)
    robot = RobotRecording("robot_0", times_s, poses, list(ranges), scanner, rates)
    for name in ("a.bag", "a.mcap", "a.db3", "folder"):
        write_recording(folder / name, [robot])
    heard = [f"{t},0,aa:bb:cc:dd:ee:0{k},{-50 - k}" for t in times_s for k in range(3)]
    (folder / "wifi.csv").write_text("timestamp,robot,bssid,rssi\n" + "\n".join(heard) + "\n")
    read = [f"{t};A {k:.0f};{20 * k - 100:.1f};{2 + 0.1 * k:.2f}" for k, t in enumerate(times_s)]
    (folder / "signs.csv").write_text("t;text;bearing_deg;range_m\n" + "\n".join(read) + "\n")
    names = ("a.bag", "wifi.csv", "a.mcap", "signs.csv", "a.db3", "carmen.log", "folder", "wifi.csv", "signs.csv")
    return [folder / name for name in names]


def _damaged(folder: Path, sample: Path, random: np.random.Generator) -> tuple[Path, str]:
    """A damaged copy."""
    shutil.rmtree(folder / "damaged", ignore_errors=True)
    (folder / "damaged").mkdir()
    place = folder / "damaged" / sample.name
    if not sample.is_dir():
        raw, what = mutated(sample.read_bytes(), random, OF_TEXT if sample.suffix in TEXTS else ())
        place.write_bytes(raw)
        return place, what
    shutil.copytree(sample, place)
    file = sorted(place.iterdir())[int(random.integers(len(list(place.iterdir()))))]
    if random.random() < 0.1:
        file.unlink()
        return place, f"{file.name} is missing"
    raw, what = mutated(file.read_bytes(), random, OF_TEXT if file.suffix in TEXTS else ())
    file.write_bytes(raw)
    return place, f"{file.name}, {what}"
