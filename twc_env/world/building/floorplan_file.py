"""Reading and writing of floor plans in the native JSON format."""

from __future__ import annotations

import gzip
import json
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import UNFIT, DataError, MapError, one_of
from twc_env.records.input_file import input_path, unpacked_bytes_max
from twc_env.records.json_values import check_lists, table_of
from twc_env.records.whole_file import whole_file
from twc_env.world.building.floorplan import FORMAT, AccessPoint, Floorplan, Room, Sign, angle_fault, to_values
from twc_env.world.building.floorplan_check import validate

FILE_BYTES_MAX = 64_000_000
"""Maximum size of a map file, uncompressed."""
FLOORS_MAX = 200
"""Maximum storeys between a floor and an access point."""


def read_floorplan(path: str | Path) -> Floorplan:
    """Read and validate a native JSON plan. Raises MapError."""
    path = Path(path)
    return validate(floorplan_from_values(load_json(path), path.name))


def load_bytes(path: Path, what: str = "map") -> bytes:
    """Content of a map file, decompressed if its name ends in .gz. Raises MapError if unreadable or too large."""
    most = FILE_BYTES_MAX
    try:
        with input_path(path).open("rb") as packed:
            if not path.name.lower().endswith(".gz"):
                raw = packed.read(most + 1)
            else:
                most = unpacked_bytes_max(packed, most) if what == "map" else most  # white paper packs well
                with gzip.GzipFile(fileobj=packed) as file:
                    raw = file.read(most + 1)
    except DataError as error:
        raise MapError(str(error)) from error
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise MapError(f"cannot read the {what} {path}: {error}; fetch the file again") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise MapError(f"cannot read the {what} {path}: {reason}; check the path") from error
    if len(raw) > most:
        remedy = "cut the map into parts" if most == FILE_BYTES_MAX else "unpack it if you know what it is"
        raise MapError(f"{path} holds more than {most // 10**6} MB; {remedy}")
    return raw


def load_json(path: Path) -> object:
    """Values of a JSON file (also .gz). Raises MapError if unreadable, invalid, too deep, or with a key twice."""
    raw = load_bytes(path)
    try:
        check_lists(raw)
        return json.loads(raw.decode("utf-8-sig"), object_pairs_hook=table_of)
    except RecursionError as error:
        raise MapError(f"{path} nests its lists too deeply; export it again") from error
    except ValueError as error:
        raise MapError(f"{path} is not valid JSON: {error}; fix it or export it again") from error


def write_floorplan(plan: Floorplan, path: str | Path) -> None:
    """Write the native JSON format; `read_floorplan` returns the same plan."""
    values = to_values(plan)
    lines = [f"{json.dumps(key)}: {_json_rows(value)}" for key, value in values.items()]
    with whole_file(path) as beside:
        beside.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def floorplan_from_values(values: object, where: str) -> Floorplan:
    """The plan of the values of a native JSON file, not validated; `where` names the file in errors.

    Raises MapError for a missing, unknown or unfit field, and for another format.
    """
    required = ("format", "name", "walls", "interior_m")
    optional = ("rooms", "signs", "access_points", "starts", "pose_building_home", "materials")
    table = _table(values, where, required, optional)
    if table["format"] != FORMAT:
        raise MapError(f"{where}: format must be {FORMAT!r}; got {table['format']!r}")
    walls = _numbers(table["walls"], (-1, 5), f"{where}: walls", "x1, y1, x2, y2, loss in dB")
    return Floorplan(
        name=_text(table["name"], f"{where}: name"),
        walls_m=walls[:, :4].reshape(-1, 2, 2),
        wall_loss_db=walls[:, 4],
        rooms=tuple(_room(v, f"{where}: rooms[{i}]") for i, v in _items(table, "rooms", where)),
        signs=tuple(_sign(v, f"{where}: signs[{i}]") for i, v in _items(table, "signs", where)),
        access_points=tuple(
            _access_point(v, f"{where}: access_points[{i}]") for i, v in _items(table, "access_points", where)
        ),
        starts=_numbers(table.get("starts", []), (-1, 3), f"{where}: starts", "x, y, heading"),
        interior_m=_numbers(table["interior_m"], (-1, 2), f"{where}: interior_m", "x, y"),
        pose_building_home=_numbers(
            table.get("pose_building_home", [0, 0, 0]), (3,), f"{where}: pose_building_home", "x, y, heading"
        ),
        wall_materials=_materials(table.get("materials", {}), len(walls), f"{where}: materials"),
    )


def _json_rows(value: object) -> str:
    """JSON text with one line per list item."""
    if not isinstance(value, list) or not value or not isinstance(value[0], (list, dict)):
        return json.dumps(value, ensure_ascii=False)
    return "[\n  " + ",\n  ".join(json.dumps(item, ensure_ascii=False) for item in value) + "\n]"


def _table(values: object, where: str, required: tuple[str, ...], optional: tuple[str, ...] = ()) -> dict:
    if not isinstance(values, dict):
        raise MapError(f"{where} must be a JSON object with {', '.join(required)}; got {type(values).__name__}")
    known = (*required, *optional)
    for key in values:
        if key not in known:
            hint = one_of(key, known)
            raise MapError(f"{where} has the unknown key {key!r}{hint}")
    for key in required:
        if key not in values:
            raise MapError(f"{where} lacks the key {key!r}; add it")
    return values


def _items(table: dict, key: str, where: str):
    values = table.get(key, [])
    if not isinstance(values, list):
        raise MapError(f"{where}: {key} must be a list; got {type(values).__name__}")
    return enumerate(values)


def _numbers(value: object, shape: tuple[int, ...], where: str, meaning: str) -> Array:
    size = f"{shape[-1]} numbers ({meaning})" if len(shape) == 1 else f"a list of {shape[-1]} numbers each ({meaning})"
    try:
        array = np.array(value, dtype=float)
        if np.array(value).dtype.kind not in "iuf" and array.size:
            raise ValueError  # numpy converts strings and booleans
    except UNFIT:
        raise MapError(f"{where} must be {size}; got {_short(value)}") from None
    if array.size == 0 and shape[0] == -1:
        return np.zeros((0, *shape[1:]))
    if array.ndim != len(shape) or array.shape[-1] != shape[-1]:
        raise MapError(f"{where} must be {size}; got {_short(value)}")
    if not np.isfinite(array).all():
        raise MapError(f"{where} holds a value that is not finite (NaN or infinity); give plain numbers")
    return array


def _text(value: object, where: str) -> str:
    if not isinstance(value, str):
        raise MapError(f"{where} must be a text; got {_short(value)}")
    return value


def _room(values: object, where: str) -> Room:
    table = _table(values, where, ("name", "polygon_m"))
    polygon = _numbers(table["polygon_m"], (-1, 2), f"{where}.polygon_m", "x, y")
    if len(polygon) < 3:
        raise MapError(f"{where}.polygon_m must have three or more corners; got {len(polygon)}")
    return Room(_text(table["name"], f"{where}.name"), polygon)


def _sign(values: object, where: str) -> Sign:
    table = _table(values, where, ("text", "position_m", "facing_rad"))
    position = _numbers(table["position_m"], (2,), f"{where}.position_m", "x, y")
    facing = _numbers([table["facing_rad"]], (1,), f"{where}.facing_rad", "angle")[0]
    if fault := angle_fault(facing):
        raise MapError(f"{where}.facing_rad {fault}")
    return Sign(_text(table["text"], f"{where}.text"), position, float(facing))


def _access_point(values: object, where: str) -> AccessPoint:
    table = _table(values, where, ("name", "position_m", "macs"), ("floor",))
    floor = table.get("floor", 0)
    if type(floor) is not int or abs(floor) > FLOORS_MAX:
        raise MapError(f"{where}.floor must be a whole number from -{FLOORS_MAX} to {FLOORS_MAX}; got {_short(floor)}")
    position = _numbers(table["position_m"], (2,), f"{where}.position_m", "x, y")
    macs = tuple(_mac(value, f"{where}.macs[{i}]") for i, value in _items(table, "macs", where))
    return AccessPoint(_text(table["name"], f"{where}.name"), position, macs, floor)


def _materials(values: object, wall_count: int, where: str) -> tuple[str, ...]:
    """{material: wall numbers} -> (walls,) names; empty if there are none."""
    if not isinstance(values, dict):
        raise MapError(f"{where} must be a JSON object from material to wall numbers; got {type(values).__name__}")
    names = [""] * (wall_count if values else 0)
    for material, walls in values.items():
        if not isinstance(walls, list):
            raise MapError(f"{where}.{material} must be a list of wall numbers; got {_short(walls)}")
        for wall in walls:
            if type(wall) is not int or not 0 <= wall < wall_count:
                raise MapError(f"{where}.{material} names wall {_short(wall)}; walls are 0 to {wall_count - 1}")
            if names[wall] not in ("", material):
                raise MapError(f"{where} names wall {wall} as {names[wall]} and as {material}; keep one")
            names[wall] = material
    return tuple(names)


def _mac(value: object, where: str) -> int:
    parts = value.split(":") if isinstance(value, str) else []
    try:
        if len(parts) != 6 or any(len(part) != 2 for part in parts):
            raise ValueError
        return int("".join(parts), 16)
    except ValueError:
        raise MapError(f"{where} must be a MAC address such as '02:00:5e:10:00:01'; got {_short(value)}") from None


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
