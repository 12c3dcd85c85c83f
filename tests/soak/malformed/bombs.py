"""Small files that are huge once unpacked, far above a limit or just below, nest deeply or name files elsewhere."""

from __future__ import annotations

import gzip
import io
import json
import lzma
import math
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from tests.soak.attempts import Attempt, load_anew, workplace
from twc_env.config import load
from twc_env.datasets.buildings.osm_level import ROOMS_MAX
from twc_env.datasets.buildings.raster import EDGES_MAX, FLOOR_CELLS_MAX
from twc_env.datasets.lasting_maps import read_lasting_map
from twc_env.datasets.logs.carmen_log import read_any_log
from twc_env.datasets.logs.column_units import Span
from twc_env.datasets.logs.frame_log import read_frame_log
from twc_env.datasets.logs.pose_graph_file import read_pose_graph
from twc_env.datasets.logs.readings_table import read_wifi
from twc_env.datasets.ros.bag_writer import RobotRecording, write_recording
from twc_env.offline.map_merge import read_saved_maps
from twc_env.records.input_file import PACKED_BYTES_FREE
from twc_env.records.json_values import LISTS_MAX
from twc_env.records.scanner import Scanner
from twc_env.replaying.inputs import Asked, read_input
from twc_env.replaying.run import run
from twc_env.world.building.floor_cells import CELLS_MAX

HUGE = 1_500_000_000
"""Bytes of a bomb, unpacked."""
BELOW = 0.9
"""Share of a limit, of bombs that are just below."""
EDGE = b"EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"
ELSEWHERE = ("/etc/passwd", "../../../../../../../../etc/passwd", "/proc/self/environ", "/dev/zero", "//etc//passwd")


def bombs(count: int, seed: int = 0) -> Iterator[Attempt]:
    """Up to `count` of all bombs; the seed changes nothing."""
    with workplace() as folder:
        for number, (name, make, read) in enumerate(_all()):
            if number == count:
                return
            place = folder / f"{number}-{name}"
            made = make(place)
            yield name, partial(read, place if made is None else made)
            if place.is_file():
                place.unlink()


Kind = tuple[str, Callable[[Path], Path | None], Callable[[Path], object]]


def _all() -> Iterator[Kind]:
    for suffix in (".json.gz", ".geojson.gz", ".pgm.gz"):
        yield f"zeros{suffix}", _gzipped, load_anew
    for suffix in (".log.gz", ".clf.gz"):
        yield f"zeros{suffix}", _gzipped, _replay
    yield "zeros.log.xz", _xz, _replay
    yield "zeros.g2o.gz", _gzipped, read_pose_graph
    yield "lines.log.gz", partial(_gzipped, piece=b"FLASER 2 1.0 1.0 0 0 0 0 0 0 1 h 1\n"), _replay
    yield from _just_below()
    for read in (read_frame_log, read_lasting_map):
        yield "zeros.npz", _npz, read
        yield "told-small.npz", partial(_npz, is_told=False), read
        yield "huge-shape.npz", _npz_of_shape, read
    if find_spec("safetensors"):
        from twc_env.training.checkpoint import load as load_model

        yield "huge.safetensors", _safetensors, load_model
        yield "sparse.safetensors", _sparse, load_model
    if find_spec("PIL"):
        yield "wide.png", _png, load_anew
        yield "wide-grid.png", _png, lambda path: read_saved_maps([str(path)])
    yield "wide.pgm", lambda path: _text(path, "P5 60000 60000 255\n"), load_anew
    yield "wide-text.pgm", lambda path: _text(path, "P2 5000 4900 255\n" + "0 " * 100), load_anew
    for opening, name in (("[", "list"), ('{"a":', "table")):
        yield f"deep-{name}.json", partial(_text, text=opening * 500_000), load_anew
        yield f"deep-{name}-settings.json", partial(_text, text=opening * 500_000), load
    yield "deep.toml", lambda path: _text(path, "a = " + "[" * 200_000), load
    yield "dotted.toml", lambda path: _text(path, ".".join("a" * 20_000) + " = 1"), load
    yield "deep.yaml", lambda path: _text(path, "image: " + "[" * 100_000), load_anew
    yield "references.yaml", lambda path: _text(path, _laughs()), load_anew
    yield "wide.json", lambda path: _text(path, _wide_plan()), load_anew
    yield "far.g2o", lambda path: _text(path, "EDGE_SE2 0 999999999999 1 0 0 1 0 0 1 0 1\n"), read_pose_graph
    yield "beams.log", lambda path: _text(path, f"FLASER {10**9} 1.0 0 0 0 0 0 0 1 h 1\n"), _replay
    for suffix in (".json", ".log", ".toml", ".yaml"):
        yield f"zeros{suffix}", _sparse, load if suffix == ".toml" else _replay if suffix == ".log" else load_anew
    for number, other in enumerate(ELSEWHERE):
        yield f"image-{number}.yaml", partial(_text, text=_map_of(other)), load_anew
        yield f"grid-{number}.yaml", partial(_text, text=_map_of(other)), lambda path: read_saved_maps([str(path)])
        if find_spec("rosbags"):
            yield f"bag-{number}", partial(_bag_elsewhere, other=other), _replay


def _just_below() -> Iterator[Kind]:
    """Repeated pieces of nine tenths of what a packed text may hold: these are read, and must be so in bounded memory.
    Of lists, rooms and edges of pixels nine tenths of their own limits."""
    log, plan = b'{"map":{"1":{"x":0,"y":0,"theta":0,"range":[', b'{"format":"x","a":['
    yield "words.log.gz", partial(_repeated, piece=b"ab\n", end=b"FLASER 1 1.0 0 0 0 0 0 0 1 h 1\n"), read_any_log
    yield "scans.log.gz", partial(_repeated, piece=b"FLASER 1 1.0 0 0 0 0 0 0 1 h 1\n"), read_any_log
    yield "lists.json.gz", partial(_repeated, begin=log, piece=b"[],", end=b"1]}}}"), read_any_log
    yield "words.g2o.gz", partial(_repeated, piece=b"ab\n", end=EDGE), read_pose_graph
    yield "edges.g2o.gz", partial(_repeated, piece=EDGE), read_pose_graph
    read_table = partial(read_wifi, span=Span(0.0, 10.0))
    yield "rows.csv.gz", partial(_repeated, begin=b"timestamp,bssid,rssi\n", piece=b"1,a,-50\n"), read_table
    yield "cells.csv.gz", partial(_repeated, begin=b"timestamp,bssid,rssi\n1", piece=b","), read_table
    few = BELOW * min(1.0, LISTS_MAX * 3 / PACKED_BYTES_FREE)
    for share, name in ((BELOW, "many"), (few, "fewer")):
        yield f"{name}.json.gz", partial(_repeated, begin=plan, piece=b"[],", end=b"1]}", share=share), load_anew
    features = b'{"type":"FeatureCollection","features":['
    yield "features.geojson.gz", partial(_repeated, begin=features, piece=b"{},", end=b"{}]}", share=few), load_anew
    rooms = int(BELOW * ROOMS_MAX)
    yield "rooms.geojson", lambda path: _text(path, _level_of(rooms, "room", 5e-5)), load_anew
    yield "open.geojson", lambda path: _text(path, _level_of(rooms, "area", 5e-5)), load_anew
    yield "heap.geojson", lambda path: _text(path, _level_of(rooms, "area", 1e-6)), load_anew
    if find_spec("PIL"):
        yield "dots.png", _dots, load_anew
        yield "white.png", _white, load_anew
        yield "white-in-grey.png", partial(_white, side=int(math.sqrt(CELLS_MAX))), load_anew
        yield "white-grid.png", _white, lambda path: read_saved_maps([str(path)])


def _replay(path: Path) -> None:
    source = read_input([path], Asked())
    run(source, source.config)


def _gzipped(path: Path, piece: bytes = b"\x00") -> None:
    block = gzip.compress(piece * (10_000_000 // len(piece)), 1)
    path.write_bytes(block * (HUGE // 10_000_000))  # as many archives in a row, which are read as one


def _repeated(path: Path, piece: bytes, begin: bytes = b"", end: bytes = b"", share: float = BELOW) -> None:
    path.write_bytes(gzip.compress(begin + piece * int(share * PACKED_BYTES_FREE / len(piece)) + end, 6))


def _level_of(rooms: int, kind: str, step_deg: float) -> str:
    """A level of square rooms of 4 x 5 m or so, side by side or one upon the other."""
    features = []
    for k in range(rooms):
        x, y = 19.0 + k % 40 * step_deg, 47.0 + k // 40 * step_deg
        ring = [[x, y], [x + 5e-5, y], [x + 5e-5, y + 5e-5], [x, y + 5e-5], [x, y]]
        shape = {"type": "Polygon", "coordinates": [ring]}
        features.append({"type": "Feature", "properties": {"indoor": kind, "level": "0"}, "geometry": shape})
    return json.dumps({"type": "FeatureCollection", "features": features})


def _dots(path: Path) -> None:
    """Obstacles of one pixel, whose edges are nine tenths of what is possible."""
    from PIL import Image

    apart = 8
    side = int(math.sqrt(BELOW * EDGES_MAX / 4)) * apart
    grey = np.full((side, side), 255, np.uint8)
    grey[::apart, ::apart] = grey[[0, -1]] = grey[:, [0, -1]] = 0
    Image.fromarray(grey).save(path)


def _white(path: Path, side: int = 0) -> None:
    """White floor of nine tenths of what is possible, in the middle of a picture of so many pixels squared."""
    from PIL import Image

    floor = int(math.sqrt(BELOW * FLOOR_CELLS_MAX))
    side = side or floor
    grey = np.full((side, side), 205, np.uint8)
    begin = (side - floor) // 2
    grey[begin : begin + floor, begin : begin + floor] = 255
    Image.fromarray(grey).save(path)


def _xz(path: Path) -> None:
    path.write_bytes(lzma.compress(b"\x00" * 10_000_000, preset=0) * (HUGE // 10_000_000))


def _npz(path: Path, is_told: bool = True) -> None:
    """An archive of one array of zeros; told small, its directory says that it has 100 bytes."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (HUGE // 8,)})
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("poses.npy", "w", force_zip64=True) as file,
    ):
        file.write(header.getvalue())
        for _ in range(HUGE // 10_000_000):
            file.write(b"\x00" * 10_000_000)
    if not is_told:
        raw = bytearray(path.read_bytes())
        at = raw.rfind(b"PK\x01\x02")
        raw[at + 24 : at + 28] = struct.pack("<I", 100)
        path.write_bytes(raw)


def _npz_of_shape(path: Path) -> None:
    """A few bytes whose header tells an array of 800 GB."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**11,)})
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("poses.npy", header.getvalue() + b"\x00" * 80)


def _safetensors(path: Path) -> None:
    told = {"a": {"dtype": "F64", "shape": [10**11], "data_offsets": [0, 8 * 10**11]}}
    header = json.dumps({"__metadata__": {"twc_env": '{"format": "twc_env/checkpoint-1"}'}, **told}).encode()
    path.write_bytes(struct.pack("<Q", len(header)) + header + b"\x00" * 80)


def _sparse(path: Path) -> None:
    """A file of zeros that takes no room on the disk."""
    with path.open("wb") as file:
        file.truncate(HUGE)


def _png(path: Path) -> None:
    """Black pixels, 20,000 times 20,000."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    packer, rows = zlib.compressobj(1), b""
    for _ in range(20):
        rows += packer.compress(b"\x00" * 20_001 * 1000)
    rows += packer.flush()
    head = struct.pack(">IIBBBBB", 20_000, 20_000, 8, 0, 0, 0, 0)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b""))


def _text(path: Path, text: str) -> None:
    path.write_text(text)


def _laughs() -> str:
    """References to references of YAML, 10^9 words when they are followed."""
    lines = ["a0: &a0 [lol, lol]"] + [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 10)]
    return "\n".join([*lines, "image: *a9", "resolution: 0.05", "origin: [0, 0, 0]", ""])


def _wide_plan() -> str:
    outline = [[0, 0], [1e6, 0], [1e6, 1e6], [0, 1e6]]
    return json.dumps({"format": "twc_env/floorplan-1", "name": "wide", "outline": outline, "walls": []})


def _map_of(picture: str) -> str:
    return (
        f"image: {picture}\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
    )


def _bag_elsewhere(path: Path, other: str) -> None:
    """A bag of ROS 2 whose metadata name a file elsewhere."""
    times_s = 1000.0 + np.arange(4)
    scanner = Scanner(-math.pi / 2, math.radians(2.0), (0.0, 0.0, 0.0), 0.1, 20.0)
    write_recording(path, [RobotRecording("robot_0", times_s, np.zeros((4, 3)), [np.full(90, 4.0)] * 4, scanner, None)])
    metadata = path / "metadata.yaml"
    name = next(file.name for file in path.iterdir() if file != metadata)
    metadata.write_text(metadata.read_text().replace(name, other))
