"""Malformed map files of every format, with their pictures: reading one may only raise MapError."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from tests.soak.attempts import Attempt, load_anew, workplace
from tests.soak.malformed.mutations import OF_JSON, OF_TEXT, mutated
from twc_env.datasets.buildings.map_export import export_map
from twc_env.maps import load_map
from twc_env.offline.map_merge import read_saved_maps
from twc_env.records.random_streams import random_stream
from twc_env.world.building.floorplan_file import write_floorplan
from twc_env.world.building.generate import generate

CHANGES = {".json": OF_JSON, ".geojson": OF_JSON, ".yaml": OF_TEXT}


def mutated_maps(count: int, seed: int = 0) -> Iterator[Attempt]:
    """Read `count` mutated files of all formats; equal seeds give the same files.

    Grids (map_server, pictures) are also read as saved maps, for `twc-env maps merge`.
    """
    random = random_stream(seed, "map-fuzz")
    with workplace() as folder:
        samples = _samples(folder)
        for path in samples:  # kernels compile before the clock runs
            load_map(path)
        for number in range(count):
            sample = samples[number % len(samples)]
            raw, what = mutated(sample.read_bytes(), random, CHANGES.get(sample.suffix, ()))
            target = folder / "mutated" / sample.name
            target.write_bytes(raw)
            is_grid = sample.suffix in (".yaml", ".pgm", ".png") and random.random() < 0.5
            yield f"#{number} {sample.name}: {what}", partial(_as_saved_map if is_grid else load_anew, target)


def _as_saved_map(path: Path) -> None:
    read_saved_maps([str(path)])


def _samples(folder: Path) -> list[Path]:
    """One valid file of every format, with companion files (pictures, floor_info.json)."""
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
