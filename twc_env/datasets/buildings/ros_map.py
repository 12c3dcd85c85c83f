"""ROS map_server maps (a yaml file and a PGM picture): read as a floor plan, written from an occupancy grid."""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.buildings.furnish import furnish_picture
from twc_env.datasets.buildings.raster import checked_floor, plan_from_free, read_grey
from twc_env.errors import MapError
from twc_env.records.messages import GridMap
from twc_env.records.whole_file import whole_file
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.floorplan_check import validate
from twc_env.world.building.floorplan_file import load_bytes

_KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
_MODES, _RAW_MAX = ("trinary", "scale", "raw"), 100
"""Interpretations of pixels; raw pixels are per cent of occupancy."""
RESOLUTION_MIN_M = 0.005
_FREE, _UNKNOWN, _OCCUPIED = 254, 205, 0
_OCCUPIED_ABOVE, _FREE_BELOW = 0.65, 0.196
SURE = np.int16(20)
"""Log-odds of the cells of a map that is read."""
_LOG = logging.getLogger(__name__)
_PLAIN = re.compile(r"\w[\w. -]*")
"""Names that YAML reads without quotes."""
_QUOTED = re.compile(r"""("(?:[^"\\]|\\.)*"|'(?:[^']|'')*')\s*(?:#.*)?""")
_COMMENT = re.compile(r"(?:^|\s)#.*")
"""A # within a word does not begin a comment."""


@dataclass(frozen=True, slots=True, eq=False)
class RosMap:
    """A map_server map; row 0 is the lowest y."""

    free: Array
    """(rows, columns) bool."""
    occupied: Array
    """(rows, columns) bool; cells that are neither are unknown."""
    resolution_m: float
    origin: Array
    """(3,) pose of the picture's lower left corner."""


def read_ros_map(path: str | Path, seed: int = 0) -> Floorplan:
    """The floor plan of a map_server yaml; signs and access points are placed by seed.

    Raises MapError for missing keys, a missing picture or a map without free space.
    """
    path = Path(path)
    ros_map = read_ros_cells(path)
    floor = checked_floor(ros_map.free, ros_map.resolution_m, path.name)
    plan = plan_from_free(floor, ros_map.resolution_m, path.stem)
    return validate(furnish_picture(plan, seed, ros_map.resolution_m, ros_map.origin))


def read_ros_cells(path: str | Path) -> RosMap:
    """The cells of a map_server yaml. The picture may lie beside it compressed (`map.pgm.gz` for `map.pgm`).

    Pictures in other folders are not read. Raises MapError if a file is missing or a value unfit; what is assumed, such
    as the meaning of grey, is a warning.
    """
    path = Path(path)
    values = _read_yaml(path)
    # The path may be that of another machine, and a map of strangers must not name files elsewhere.
    named = Path(values["image"])
    inside = None if named.is_absolute() or ".." in named.parts else _picture(path.parent / named)
    picture = inside or _picture(path.parent / PureWindowsPath(values["image"]).name)
    if picture is None:
        raise MapError(f"{path.name} names the picture {values['image']!r}, which is not there; put it beside it")
    occupancy = _occupancy(picture, values, path)
    resolution_m = _number(values, "resolution", path)
    if not RESOLUTION_MIN_M <= resolution_m < 10:
        raise MapError(f"{path.name}: resolution must be metres per pixel, 0.005 to 10; got {resolution_m:g}")
    free_below, occupied_above = _number(values, "free_thresh", path), _number(values, "occupied_thresh", path)
    if not 0.0 <= free_below <= occupied_above <= 1.0:
        raise MapError(
            f"{path.name}: free_thresh and occupied_thresh must be shares from 0 to 1, the first not above the second; "
            f"got {free_below:g} and {occupied_above:g}"
        )
    free = occupancy < free_below
    grey = occupancy == 1.0 - _UNKNOWN / 255.0
    if values.get("mode", "trinary") == "trinary" and (free & grey).any() and (free & ~grey).any():
        _LOG.warning(
            "%s: free_thresh %g would make the grey %d of map_saver, which is unknown, floor; it is left unknown: "
            "write free_thresh: %g", path.name, free_below, _UNKNOWN, _FREE_BELOW,
        )  # fmt: skip
        free &= ~grey
    return RosMap(
        free=free,
        occupied=occupancy > occupied_above,
        resolution_m=resolution_m,
        origin=_origin(values["origin"], path),
    )


def read_ros_grid(path: str | Path) -> GridMap:
    """The map of a map_server yaml as an occupancy grid. Raises MapError as `read_ros_cells`, and for a turned one."""
    ros_map = read_ros_cells(path)
    if ros_map.origin[2]:
        raise MapError(
            f"{Path(path).name}: its origin is turned by {ros_map.origin[2]:g} rad; turn the picture instead"
        )
    log_odds = ros_map.occupied.astype(np.int16) * SURE - ros_map.free.astype(np.int16) * SURE
    return GridMap(log_odds, np.asarray(ros_map.origin[:2], float), ros_map.resolution_m)


def _occupancy(picture: Path, values: dict[str, str], path: Path) -> Array:
    """(rows, columns) from 0 (free) to 1, the lowest row first; NaN for unknown pixels of a raw picture."""
    mode, negate = values.get("mode", "trinary"), values["negate"].lower()  # a boolean in ROS 2
    is_negated = negate == "true" or (negate != "false" and _number(values, "negate", path) != 0)
    if mode not in _MODES:
        raise MapError(f"{path.name}: mode must be trinary, scale or raw; got {mode!r}")
    grey = read_grey(picture, 255 if is_negated else 0)[::-1].astype(float)
    if mode == "raw":
        return np.where(grey <= _RAW_MAX, grey / _RAW_MAX, np.nan)
    return grey / 255.0 if is_negated else 1.0 - grey / 255.0


def write_ros_map(grid: GridMap, folder: str | Path, stem: str) -> Path:
    """Write `stem.pgm` and `stem.yaml` as map_server reads them; returns the path of the yaml."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    shade = np.full_like(grid.log_odds, _UNKNOWN, dtype=np.uint8)
    shade[grid.log_odds < 0] = _FREE
    shade[grid.log_odds > 0] = _OCCUPIED
    rows, columns = shade.shape
    with whole_file(folder / f"{stem}.pgm") as beside:
        beside.write_bytes(b"P5\n%d %d\n255\n" % (columns, rows) + shade[::-1].tobytes())
    # YAML 1.1 reads 1e-17, which has no decimal point, as text.
    resolution, x, y = (np.format_float_positional(v, trim="0") for v in (grid.resolution_m, *grid.origin_m))
    picture = f"{stem}.pgm" if _PLAIN.fullmatch(stem) else json.dumps(f"{stem}.pgm", ensure_ascii=False)
    path = folder / f"{stem}.yaml"
    text = (
        f"image: {picture}\nresolution: {resolution}\norigin: [{x}, {y}, 0.0]\nnegate: 0\n"
        f"occupied_thresh: {_OCCUPIED_ABOVE}\nfree_thresh: {_FREE_BELOW}\n"
    )
    with whole_file(path) as beside:
        beside.write_text(text, encoding="utf-8")
    return path


def write_ros_maps(grids: Iterable[GridMap], folder: Path) -> None:
    """Write the maps of groups, largest first, as `map`, `map_2` and so on; empty maps are skipped."""
    for k, grid in enumerate(grids, 1):
        if grid.log_odds.size:
            write_ros_map(grid, folder, "map" if k == 1 else f"map_{k}")


def _picture(path: Path) -> Path | None:
    """The picture or its compressed version; None if neither exists or the name is invalid."""
    try:
        return next((p for p in (path, path.with_name(path.name + ".gz")) if p.is_file()), None)
    except (OSError, ValueError):
        return None


def _read_yaml(path: Path) -> dict[str, str]:
    """The `key: value` lines of a map_server file; lists of any layout become one text "a, b"."""
    try:
        text = load_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise MapError(f"{path.name} is not text: {error}; export the map again") from error
    values, key = {}, ""
    for line in text.split("\n"):
        if line.rstrip() == "...":  # the document ends
            break
        name, separator, value = line.partition(":")
        if separator and "#" not in name:
            key = name.strip()
            if key in values and key in (*_KEYS, "mode"):
                raise MapError(f"{path.name} gives {key!r} twice; keep one of its values")
            values[key] = _scalar(value.strip())
        elif key and (item := _COMMENT.sub("", line).strip().removeprefix("- ").strip()):  # continues the line before
            values[key] = ", ".join(part.strip(", ") for part in (values[key], item) if part.strip(", "))
    for key in _KEYS:
        if key not in values:
            raise MapError(f"{path.name} lacks the key {key!r}; a map_server file has {', '.join(_KEYS)}")
    return values


def _scalar(text: str) -> str:
    """A value without quotes and without a trailing comment."""
    quoted = _QUOTED.fullmatch(text)
    if quoted is None:
        return _COMMENT.sub("", text).strip()
    inner = quoted[1][1:-1]
    if text[0] == "'":
        return inner.replace("''", "'")
    try:
        return json.loads(f'"{inner}"')
    except ValueError:  # an escape sequence that JSON does not have
        return inner


def _number(values: dict[str, str], key: str, path: Path) -> float:
    try:
        number = float(values[key])
    except ValueError:
        raise MapError(f"{path.name}: {key} must be a number; got {values[key]!r}") from None
    if not np.isfinite(number):
        raise MapError(f"{path.name}: {key} must be finite; got {values[key]!r}")
    return number


def _origin(text: str, path: Path) -> Array:
    try:
        origin = np.array([float(value) for value in text.strip("[], ").split(",")])
        if origin.shape == (3,) and np.isnan(origin[2]):  # as map_saver writes where it knows no yaw
            _LOG.warning("%s: the yaw of origin is no number; 0 is assumed: write it", path.name)
            origin[2] = 0.0
    except ValueError:
        origin = np.zeros(0)
    if origin.shape != (3,) or not np.isfinite(origin).all():
        raise MapError(f"{path.name}: origin must be [x, y, yaw]; got {text!r}")
    if abs(origin[2]) > 2 * np.pi:
        raise MapError(f"{path.name}: yaw, the last of origin, is in radians, at most a turn; got {origin[2]:g}")
    return origin
