"""Damaged logs: laser logs, bags of every kind, tables of readings. Replaying one may only raise TwcError."""

from __future__ import annotations

import gzip
import json
import math
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from tests.soak.attempts import Attempt, workplace
from tests.soak.malformed.mutations import OF_JSON, OF_TEXT, mutated
from twc_env.datasets.logs.carmen_writer import write_carmen_log
from twc_env.datasets.logs.scan_log import ScanLog
from twc_env.datasets.ros.bag_writer import RobotRecording, write_recording
from twc_env.records.random_streams import random_stream
from twc_env.records.scanner import Scanner
from twc_env.replaying.inputs import Asked, read_input
from twc_env.replaying.run import run

_SCANS, _BEGUN_S = 10, 1000.0
_CHANGES = {".csv": OF_TEXT, ".log": OF_TEXT, ".yaml": OF_TEXT, ".json": OF_JSON}
"""Faults of texts, by the ending of their names."""


def damaged_logs(count: int, seed: int = 0) -> Iterator[Attempt]:
    """Replay `count` damaged laser logs of CARMEN and JSON; equal seeds give the same files."""
    return _damaged_files(count, seed, ("robotlaser.log", "flaser.log", "rawlaser.log", "scans.json", "packed.log.gz"))


def damaged_bags(count: int, seed: int = 0) -> Iterator[Attempt]:
    """Replay `count` damaged bags of ROS 1 and 2."""
    return _damaged_files(count, seed, ("a.bag", "a.mcap", "a.db3", "folder"))


def damaged_tables(count: int, seed: int = 0) -> Iterator[Attempt]:
    """Replay a sound log with `count` damaged tables of WiFi and signs beside it."""
    return _damaged_files(count, seed, ("wifi.csv", "signs.csv"))


def _damaged_files(count: int, seed: int, names: tuple[str, ...]) -> Iterator[Attempt]:
    random = random_stream(seed, "log-fuzz")
    with workplace() as folder:
        _write_samples(folder, any(not name.endswith((".csv", ".log", ".json", ".gz")) for name in names))
        for name in (*names, "robotlaser.log"):  # kernels compile before the clock runs
            _replay_of(folder / name, folder)()
        for number in range(count):
            sample = folder / names[number % len(names)]
            place, what = _damaged(folder, sample, random)
            yield f"#{number} {sample.name}: {what}", _replay_of(place, folder)


def _replay_of(file: Path, folder: Path) -> Callable[[], None]:
    """Of a log, or of the sound one with a table."""
    return _replay(folder / "robotlaser.log", {file.stem: (file,)}) if file.suffix == ".csv" else _replay(file)


def _replay(log: Path, tables: dict[str, tuple[Path]] | None = None) -> Callable[[], None]:
    def replay() -> None:
        source = read_input([log], Asked(**(tables or {})))
        run(source, source.config)

    return replay


def _write_samples(folder: Path, with_bags: bool) -> None:
    """One sound file of every kind; the tables belong to robotlaser.log."""
    turn = np.linspace(0.0, 2.0, _SCANS)
    poses = np.stack([2.0 * np.cos(turn), 2.0 * np.sin(turn), turn], axis=1)
    times_s, angles = _BEGUN_S + np.arange(_SCANS), np.radians(np.arange(-90.0, 90.0, 2.0))
    ranges = np.round(4.0 + np.cos(angles[None] + turn[:, None]), 2)
    _write_laser_logs(folder, ScanLog(times_s, poses, ranges, angles))
    heard = [f"{t},0,aa:bb:cc:dd:ee:0{k},{-50 - k}" for t in times_s for k in range(3)]
    (folder / "wifi.csv").write_text("timestamp,robot,bssid,rssi\n" + "\n".join(heard) + "\n")
    read = [f"{t};A {k:.0f};{20 * k - 100:.1f};{2 + 0.1 * k:.2f}" for k, t in enumerate(times_s)]
    (folder / "signs.csv").write_text("t;text;bearing_deg;range_m\n" + "\n".join(read) + "\n")
    if not with_bags:
        return
    scanner = Scanner(-math.pi / 2, math.radians(2.0), (0.1, 0.0, 0.1), 0.1, 20.0, sweep_s=0.05)
    robot = RobotRecording("robot_0", times_s, poses, list(ranges), scanner, np.full(_SCANS, 0.1))
    for name in ("a.bag", "a.mcap", "a.db3", "folder"):
        write_recording(folder / name, [robot])


def _write_laser_logs(folder: Path, log: ScanLog) -> None:
    """The same scans as lines of every kind that is read, as JSON, and packed."""
    write_carmen_log(folder / "robotlaser.log", log, 20.0)
    (folder / "packed.log.gz").write_bytes(gzip.compress((folder / "robotlaser.log").read_bytes()))
    flaser, raw, scans = ["PARAM laser_front_laser_fov 180"], ["PARAM robot_frontlaser_offset 0.1"], {}
    for time_s, pose, ranges_m in zip(log.times_s.tolist(), log.poses.tolist(), log.ranges_m.tolist(), strict=True):
        told = " ".join(map(str, (len(ranges_m), *ranges_m)))
        at = " ".join(map(str, pose))
        flaser.append(f"FLASER {told} {at} {at} {time_s} host {time_s}")
        raw.append(f"ODOM {at} 0 0 0 {time_s} host {time_s}")
        raw.append(f"RAWLASER1 0 -1.5708 3.1416 0.0349 20.0 0.01 0 {told} 0 {time_s} host {time_s}")
        scans[str(time_s)] = {"range": ranges_m, **dict(zip(("x", "y", "theta"), pose, strict=True))}
    (folder / "flaser.log").write_text("\n".join(flaser) + "\n")
    (folder / "rawlaser.log").write_text("\n".join(raw) + "\n")
    (folder / "scans.json").write_text(json.dumps({"map": scans}))


def _damaged(folder: Path, sample: Path, random: np.random.Generator) -> tuple[Path, str]:
    """A damaged copy."""
    shutil.rmtree(folder / "damaged", ignore_errors=True)
    (folder / "damaged").mkdir()
    place = folder / "damaged" / sample.name
    if not sample.is_dir():
        raw, what = _mutated(sample, random)
        place.write_bytes(raw)
        return place, what
    shutil.copytree(sample, place)
    file = sorted(place.iterdir())[int(random.integers(len(list(place.iterdir()))))]
    if random.random() < 0.1:
        file.unlink()
        return place, f"{file.name} is missing"
    raw, what = _mutated(file, random)
    file.write_bytes(raw)
    return place, f"{file.name}, {what}"


def _mutated(file: Path, random: np.random.Generator) -> tuple[bytes, str]:
    """Faults of its kind; a packed file is damaged within as often as outside."""
    raw = file.read_bytes()
    if file.suffix == ".gz" and random.random() < 0.5:
        inside, what = mutated(gzip.decompress(raw), random, OF_TEXT)
        return gzip.compress(inside), f"within, {what}"
    return mutated(raw, random, _CHANGES.get(file.suffix, ()))
