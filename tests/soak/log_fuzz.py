"""Damaged logs: bags of every kind, tables of readings, CARMEN logs. Replaying one may only raise TwcError."""

from __future__ import annotations

import math
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.soak.map_fuzz import FuzzReport
from twc_env.datasets.logs.carmen_writer import write_carmen_log
from twc_env.datasets.logs.scan_log import ScanLog
from twc_env.datasets.ros.bag_writer import RobotRecording, write_recording
from twc_env.errors import TwcError
from twc_env.records.random_streams import random_stream
from twc_env.records.scanner import Scanner
from twc_env.replaying.inputs import Asked, read_input
from twc_env.replaying.run import run

SECONDS_MAX = 20.0
"""Limit for replaying one file; exceeding it is a fault."""
_SCANS, _BEGUN_S = 10, 1000.0
_ODD_WORDS = (
    b"nan", b"inf", b"-1", b"1e308", b"", b"x", b"9" * 400, b"0x10", b"\x00", b"2026-13-45T99:00:00", b"100", b",,,,",
    b'"', b"\xff\xfe", b"1e-320", b"aa:bb:cc:dd:ee:ff", b";", b"\r",
)  # fmt: skip
_ODD_NUMBERS = (b"\xff" * 8, b"\x00" * 8, b"\x00\x00\x00\x00\x00\x00\xf8\x7f", b"\xff\xff\xff\x7f", b"\x00\x00\xc0\x7f")
"""Bytes of huge, zero and NaN numbers."""


def fuzz_logs(count: int, seed: int = 0) -> FuzzReport:
    """Replay `count` damaged logs or tables beside a sound log; equal seeds give the same files."""
    report = FuzzReport()
    random = random_stream(seed, "log-fuzz")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        samples = _samples(folder)
        for name in ("sound.log", "a.bag"):  # kernels compile before the clock runs
            run(*_sound(folder / name))
        for number in range(count):
            sample = samples[number % len(samples)]
            place, what = _damaged(folder, sample, random)
            _replay(folder, sample, place, f"#{number} {sample.name}: {what}", report)
    return report


def _sound(log: Path):
    source = read_input([log], Asked())
    return source, source.config


def _replay(folder: Path, sample: Path, place: Path, what: str, report: FuzzReport) -> None:
    start = time.perf_counter()
    try:
        tables = {sample.stem: (place,)} if sample.suffix == ".csv" else {}
        source = read_input([folder / "sound.log" if tables else place], Asked(**tables))
        run(source, source.config)
        report.loaded += 1
    except TwcError as error:
        report.refused += 1
        if "\n" in str(error):
            report.escaped.append(f"{what}: an error of several lines")
    except Exception as error:  # any other exception is a fault
        report.escaped.append(f"{what}: {type(error).__name__}: {str(error)[:100]}")
    elapsed = time.perf_counter() - start
    report.count += 1
    if elapsed > report.slowest_s:
        report.slowest_s, report.slowest = elapsed, what


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
        raw, what = _mutated(sample.read_bytes(), sample.suffix in (".csv", ".log"), random)
        place.write_bytes(raw)
        return place, what
    shutil.copytree(sample, place)
    file = sorted(place.iterdir())[int(random.integers(len(list(place.iterdir()))))]
    if random.random() < 0.1:
        file.unlink()
        return place, f"{file.name} is missing"
    raw, what = _mutated(file.read_bytes(), file.suffix == ".yaml", random)
    file.write_bytes(raw)
    return place, f"{file.name}, {what}"


def _mutated(raw: bytes, is_text: bool, random: np.random.Generator) -> tuple[bytes, str]:
    """Bytes with up to three faults."""
    told = []
    for _ in range(int(random.integers(1, 4))):
        raw, what = _mutate(raw, is_text, random)
        told.append(what)
    return raw, ", ".join(told)


def _mutate(raw: bytes, is_text: bool, random: np.random.Generator) -> tuple[bytes, str]:
    if not raw:
        return b"x", "a letter"
    at = int(random.integers(len(raw)))
    kind = int(random.integers(8 if is_text else 6))
    if kind == 0:
        return raw[:at], f"cut at {at}"
    if kind == 1:
        return raw[:at] + bytes([raw[at] ^ (1 << int(random.integers(8)))]) + raw[at + 1 :], f"a bit of byte {at}"
    if kind == 2:
        end = min(at + int(random.integers(1, 200)), len(raw))
        return raw[:end] + raw[at:end] + raw[end:], f"bytes {at} to {end} twice"
    if kind == 3:
        end = min(at + int(random.integers(1, 200)), len(raw))
        return raw[:at] + raw[end:], f"without bytes {at} to {end}"
    if kind == 4:
        odd = _ODD_NUMBERS[int(random.integers(len(_ODD_NUMBERS)))]
        return raw[:at] + odd + raw[at + len(odd) :], f"odd bytes at {at}"
    if kind == 5:
        noise = random.bytes(int(random.integers(1, 40)))
        return raw[:at] + noise + raw[at + len(noise) :], f"noise at {at}"
    words = raw.split(b" " if b" " in raw and b"," not in raw else b"," if b"," in raw else b";")
    k = int(random.integers(len(words)))
    odd = _ODD_WORDS[int(random.integers(len(_ODD_WORDS)))]
    joined = b" " if b" " in raw and b"," not in raw else b"," if b"," in raw else b";"
    return joined.join([*words[:k], odd, *words[k + 1 :]]), f"word {k} is {odd[:10]!r}"
