"""Malformed map files: truncated, wrong types, NaN, huge numbers, deep nesting. Reading one may only raise MapError."""

from __future__ import annotations

import base64
import copy
import gzip
import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from twc_env.datasets.buildings.map_export import export_map
from twc_env.errors import MapError
from twc_env.maps import load_map
from twc_env.records.random_streams import random_stream
from twc_env.running.process_memory import peak_mb
from twc_env.world.building.floorplan_file import write_floorplan
from twc_env.world.building.generate import generate

SECONDS_MAX = 1.0
MEMORY_MAX_MB = 1000.0
"""Limits for reading one file; exceeding either is a fault."""

_ODD_VALUES: tuple = (
    None, True, False, "", "x", "NaN", 0, -1, 1e308, -1e308, 10**400, 1e-320, float("nan"), float("inf"),
    -float("inf"), [], {}, [[]], [[[]]], {"a": {"a": {}}}, "\x00", "é" * 50, 2**63, 1e9, 1e6, 1e5,
)  # fmt: skip
_ODD_TEXTS = (
    "NaN", "Infinity", "-Infinity", "1e400", "9" * 5000, "null", "[" * 3000, '{"a":' * 3000, "\\ud800", "\x00",
)  # fmt: skip
_ODD_LINES = (
    "nan", "-1", "0", "1e308", "1e-300", "[]", "[1e300, 0, 0]", "..", "/", "x" * 300, "\x00", "1" * 400, "0.3", "8",
)  # fmt: skip


@dataclass(slots=True)
class FuzzReport:
    """Results of `fuzz_maps`."""

    count: int = 0
    refused: int = 0
    loaded: int = 0
    slowest_s: float = 0.0
    slowest: str = ""
    grown_mb: float = float("nan")
    """Increase of the peak memory of the process; NaN if the system does not report it."""
    escaped: list[str] = field(default_factory=list)
    """Mutations that raised an exception other than MapError."""


def fuzz_maps(count: int, seed: int = 0) -> FuzzReport:
    """Read `count` mutated files of all formats; equal seeds give the same files."""
    report = FuzzReport()
    random = random_stream(seed, "map-fuzz")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        samples = _samples(folder)
        for path in samples:  # kernels compile before the clock runs
            load_map(path)
        before_mb = peak_mb()
        for number in range(count):
            sample = samples[number % len(samples)]
            raw, what = _mutated(sample, random)
            target = folder / "mutated" / sample.name
            target.write_bytes(raw)
            _read(target, f"#{number} {sample.name}: {what}", report)
        report.grown_mb = peak_mb() - before_mb
    return report


def _read(path: Path, what: str, report: FuzzReport) -> None:
    start = time.perf_counter()
    try:
        load_map(path)
        report.loaded += 1
    except MapError as error:
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
    """One valid file of every format, with companion files (pictures, floor_info.json), which are not mutated."""
    plan = generate("office", 100, 0)
    (folder / "mutated").mkdir()
    write_floorplan(plan, folder / "native.json")
    (folder / "house.json").write_text(json.dumps(_HOUSE))
    (folder / "floor.geojson").write_text(json.dumps(_FLOOR))
    (folder / "level.geojson").write_text(json.dumps(_LEVEL))
    for place in (folder, folder / "mutated"):
        (place / "floor_info.json").write_text('{"map_info": {"width": 20.0, "height": 15.0}}')
        export_map(plan, place / "ros.yaml")
    (folder / "picture.pgm").write_bytes((folder / "ros.pgm").read_bytes().replace(b"\xfe", b"\xff"))
    (folder / "picture.png").write_bytes(base64.b64decode(_PNG))
    for name in ("native.json", "house.json", "picture.pgm"):
        (folder / f"{name}.gz").write_bytes(gzip.compress((folder / name).read_bytes(), mtime=0))
    names = (
        "native.json", "house.json", "floor.geojson", "level.geojson", "native.json", "ros.yaml", "picture.pgm",
        "native.json.gz", "picture.pgm.gz", "house.json.gz",
    )  # fmt: skip
    return [folder / name for name in (*names, *(("picture.png",) if find_spec("PIL") else ()))]


def _mutated(path: Path, random: np.random.Generator) -> tuple[bytes, str]:
    raw = path.read_bytes()
    is_json = path.suffix in (".json", ".geojson")
    kinds: list[Callable] = [_cut, _flip, _repeat, _insert]
    if is_json:
        kinds += [_odd_value] * 5 + [_odd_text, _dropped_key, _nested]
    elif path.suffix == ".yaml":
        kinds += [_odd_line] * 4
    mutate = kinds[int(random.integers(len(kinds)))]
    return mutate(raw, random), mutate.__name__.lstrip("_")


def _cut(raw: bytes, random: np.random.Generator) -> bytes:
    return raw[: int(random.integers(len(raw)))]


def _flip(raw: bytes, random: np.random.Generator) -> bytes:
    changed = bytearray(raw)
    reach = len(raw) if random.random() < 0.5 else min(64, len(raw))
    for at in random.integers(0, reach, int(random.integers(1, 12))):
        changed[int(at)] = int(random.integers(256))
    return bytes(changed)


def _repeat(raw: bytes, random: np.random.Generator) -> bytes:
    begin, end = sorted(int(at) for at in random.integers(0, len(raw), 2))
    return raw[:end] + raw[begin:]


def _insert(raw: bytes, random: np.random.Generator) -> bytes:
    at = int(random.integers(len(raw)))
    return raw[:at] + random.bytes(int(random.integers(1, 40))) + raw[at:]


def _odd_text(raw: bytes, random: np.random.Generator) -> bytes:
    """Replace a value of the file by a text that may not be valid JSON there."""
    words = raw.split(b",")
    at = int(random.integers(len(words)))
    words[at] = _ODD_TEXTS[int(random.integers(len(_ODD_TEXTS)))].encode()
    return b",".join(words)


def _odd_value(raw: bytes, random: np.random.Generator) -> bytes:
    values = json.loads(raw)
    for _ in range(int(random.integers(1, 4))):
        holder, key = _somewhere(values, random)
        holder[key] = copy.deepcopy(_ODD_VALUES[int(random.integers(len(_ODD_VALUES)))])
    return json.dumps(values).encode()


def _dropped_key(raw: bytes, random: np.random.Generator) -> bytes:
    values = json.loads(raw)
    holder, key = _somewhere(values, random)
    kept = holder.pop(key)
    if isinstance(holder, dict) and random.random() < 0.5:
        holder[f"{key}s"] = kept
    return json.dumps(values).encode()


def _nested(raw: bytes, random: np.random.Generator) -> bytes:
    values = json.loads(raw)
    holder, key = _somewhere(values, random)
    deep = holder[key]
    for _ in range(int(random.integers(1, 300))):
        deep = [deep]
    holder[key] = deep
    return json.dumps(values).encode()


def _odd_line(raw: bytes, random: np.random.Generator) -> bytes:
    lines = raw.decode().splitlines()
    at = int(random.integers(len(lines)))
    key = lines[at].split(":")[0]
    lines[at] = f"{key}: {_ODD_LINES[int(random.integers(len(_ODD_LINES)))]}"
    return "\n".join(lines).encode()


def _somewhere(values, random: np.random.Generator):
    """A random element of nested values: the list or dictionary that holds it, and its key."""
    holder, key = values, _key(values, random)
    while isinstance(holder[key], (list, dict)) and holder[key] and random.random() < 0.75:
        holder = holder[key]
        key = _key(holder, random)
    return holder, key


def _key(holder, random: np.random.Generator):
    keys = list(holder) if isinstance(holder, dict) else range(len(holder))
    return keys[int(random.integers(len(keys)))]


def _polygon(corners: list[tuple[float, float]], **properties) -> dict:
    ring = [[19.0 + x / 73_000, 47.0 + y / 111_320] for x, y in [*corners, corners[0]]]
    return {"type": "Feature", "properties": properties, "geometry": {"type": "Polygon", "coordinates": [ring]}}


def _room(x0: float, y0: float, x1: float, y1: float, name: str, door: tuple[float, float] | None = None) -> dict:
    corners = [(x0, y0), (x1, y0), (x1, y1), *([door] if door else []), (x0, y1)]
    return _polygon(
        corners,
        tags={"buildingpart": "room", "name": name},
        relations=[{"role": "buildingpart", "reltags": {"level": "0"}}],
    )


_HOUSE = {
    "id": "house",
    "room_num": 2,
    "verts": [[0.1, 0.1], [5.1, 0.1], [5.1, 1.6], [5.2, 1.6], [5.2, 0.1], [10.2, 0.1], [10.2, 4.1], [0.1, 4.1]],
    "bbox": {"min": [0.1, 0.1], "max": [10.2, 4.1]},
    "room_category": {"Kitchen": [[0.1, 0.1, 5.1, 4.1]], "Living_Room": [[5.2, 0.1, 10.2, 4.1]]},
}
_FLOOR = {
    "type": "FeatureCollection",
    "features": [
        _polygon([(0, 0), (20, 0), (20, 15), (0, 15)], name="F1"),
        _polygon([(3, 3), (9, 3), (9, 8), (3, 8)], name="bookshop"),
        _polygon([(12, 3), (17, 3), (17, 12), (12, 12)], name="louti"),
        _polygon([(4, 10), (8, 10), (8, 13), (4, 13)], name="fuzhumian"),
    ],
}
_LEVEL = {
    "type": "FeatureCollection",
    "features": [
        _room(0, 0, 8, 4, "001", door=(4, 4)),
        _room(0, 4.2, 8, 7, "002"),
        {
            "type": "Feature",
            "properties": {"tags": {"door": "yes", "width": "1"}},
            "geometry": {"type": "Point", "coordinates": [19.0 + 4 / 73_000, 47.0 + 4 / 111_320]},
        },
    ],
}
_PNG = (
    "iVBORw0KGgoAAAANSUhEUgAAAHgAAABaCAAAAABWa80zAAAAWElEQVR42u3WsQ2AMBAEwQXRf8smJTUSIJnZBkZ/0Zf0UFtV42Wv"
    "2r+6GAwGg8FgMBgMXgg+pj/xa8PUYDAYDAaDwUs8e8PUYDAYDAaDwWAwGPwfWJJudwIyyAObAlclSQAAAABJRU5ErkJggg=="
)
"""A white floor of 120 x 90 pixels with one pillar."""
