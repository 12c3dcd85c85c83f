"""The building: walls, rooms, signs and access points; how it is read, checked, moved and rasterised.

Lengths in metres, angles in radians, counter-clockwise from +x. A plan that was moved remembers its home: everything
random about a building (shadowing, drawn starts) is fixed there, so moving it changes nothing a robot can measure.
"""

from __future__ import annotations

import dataclasses
import difflib
import gzip
import hashlib
import json
import math
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from twc_env.errors import MapError
from twc_env.geometry import compose, inverse, transform_points
from twc_env.world.materials import MATERIALS
from twc_env.world.wall_index import WallIndex, index_walls

Array = NDArray

FORMAT = "twc_env/floorplan-1"
SIGN_TO_WALL_MAX_M = 0.3
SIGN_FRONT_M = 0.3
"""The place this far in front of a sign must be free."""
SIGN_FACE_M = 0.02
"""A camera looks at the sign's face, this far off its position."""
_WALL_LENGTH_MIN_M = 1e-6
COORDINATE_MAX_M = 100_000.0
"""Nothing in a plan lies farther from the origin: beyond it, decimetres get lost in single precision."""
CELLS_MAX = 25_000_000
"""Of a raster: 500 x 500 m in cells of 0.1 m."""
FILE_BYTES_MAX = 64_000_000
"""Of a map file, unpacked."""
FLOORS_MAX = 200
"""Storeys between a floor and an access point."""
_CHECK_RESOLUTION_M = 0.1
_AREA_CELLS = ((0.0125, 500.0), (0.025, 4000.0), (0.05, 40_000.0), (0.1, math.inf))
"""Cell sizes [m] that measure floors, and the extent [m2] up to which each is used."""


@dataclass(frozen=True, slots=True, eq=False)
class Sign:
    """A text on a wall."""

    text: str
    position_m: Array
    """(2,)."""
    facing_rad: float
    """Direction of the outward normal of the wall it hangs on."""


@dataclass(frozen=True, slots=True, eq=False)
class AccessPoint:
    """A WiFi transmitter; one box sends under several MAC addresses."""

    name: str
    position_m: Array
    """(2,)."""
    macs: tuple[int, ...]
    """48-bit addresses, unique over the plan."""
    floor: int = 0
    """Storeys above (or below, negative) the drawn one; its signal also crosses the ceilings in between."""


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """A named part of the floor."""

    name: str
    polygon_m: Array
    """(k, 2) corners in order, not closed."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """The building as a raster; row 0 is the lowest y. A cell is free, wall, or neither (outside)."""

    free: Array
    """(rows, columns) bool: not wall and connected to an interior point."""
    wall: Array
    """(rows, columns) bool: the centre lies within half a cell of a wall."""
    origin_m: Array
    """(2,) lower left corner of cell [0, 0]."""
    resolution_m: float

    def is_free(self, points_m: Array) -> Array:
        """(..., 2) points -> (...) bool; False outside the raster."""
        at = np.floor((np.asarray(points_m, float) - self.origin_m) / self.resolution_m).astype(np.int64)
        inside = np.all((at >= 0) & (at < self.free.shape[::-1]), axis=-1)
        column, row = (np.where(inside, at[..., axis], 0) for axis in (0, 1))
        return inside & self.free[row, column]


@dataclass(frozen=True, eq=False)
class Floorplan:
    """One floor of a building. Arrays are read-only; `validate` says what a sound plan is."""

    name: str
    walls_m: Array
    """(walls, 2, 2): both ends (x, y) of each wall segment."""
    wall_loss_db: Array
    """(walls,) loss of a radio signal that crosses the wall."""
    rooms: tuple[Room, ...] = ()
    signs: tuple[Sign, ...] = ()
    access_points: tuple[AccessPoint, ...] = ()
    starts: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(starts, 3) suggested start poses; may be empty."""
    interior_m: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """(k, 2) points known to be free: the floor is what is connected to them."""
    pose_building_home: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) how far the building was moved from where it was drawn."""
    wall_materials: tuple[str, ...] = ()
    """(walls,) name of each wall's material ("" where not known), or empty: no material is known."""
    _cache: dict = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        shapes = {
            "walls_m": (-1, 2, 2),
            "wall_loss_db": (-1,),
            "starts": (-1, 3),
            "interior_m": (-1, 2),
            "pose_building_home": (3,),
        }
        for key, shape in shapes.items():
            object.__setattr__(self, key, _frozen_array(getattr(self, key), shape, f"{key} of map {self.name!r}"))
        for key in ("rooms", "signs", "access_points", "wall_materials"):
            object.__setattr__(self, key, tuple(getattr(self, key)))

    @property
    def bounds_m(self) -> Array:
        """(4,) x_min, y_min, x_max, y_max over all walls."""
        ends = self.walls_m.reshape(-1, 2)
        return np.concatenate([ends.min(axis=0), ends.max(axis=0)])

    @property
    def home(self) -> Floorplan:
        """The plan where it was drawn."""
        if not self.pose_building_home.any():
            return self
        if "home" not in self._cache:
            self._cache["home"] = _carried(self, inverse(self.pose_building_home), np.zeros(3))
        return self._cache["home"]

    @property
    def digest(self) -> str:
        """Twelve hex digits of the content; the same wherever the building stands."""
        if "digest" not in self._cache:
            self._cache["digest"] = hashlib.sha256(_digest_text(self.home).encode()).hexdigest()[:12]
        return self._cache["digest"]

    @property
    def wall_index(self) -> WallIndex:
        """The walls in buckets, built once."""
        if "wall_index" not in self._cache:
            self._cache["wall_index"] = index_walls(self.walls_m, self.wall_loss_db)
        return self._cache["wall_index"]

    def moved(self, pose: Array) -> Floorplan:
        """The same building after the rigid motion `pose` (3,)."""
        plan = _carried(self, pose, compose(pose, self.pose_building_home))
        plan._cache["home"] = self.home
        return plan

    def cells(self, resolution_m: float = 0.1) -> Cells:
        """The raster, built once per resolution. Walls on whole cells come out one cell thick."""
        if ("cells", resolution_m) not in self._cache:
            self._cache["cells", resolution_m] = _rasterise(self, resolution_m)
        return self._cache["cells", resolution_m]

    @property
    def floor_area_m2(self) -> float:
        """Free floor up to the lines of its walls.

        Cells that walls pass through are not free, which costs half a cell along every wall. That error shrinks with
        the cell, so two rasters tell how large it is.
        """
        if "floor_area_m2" not in self._cache:
            sizes = self.bounds_m[2:] - self.bounds_m[:2]
            fine = next(size for size, top in _AREA_CELLS if np.prod(sizes) < top)
            areas = [_rasterise(self, size).free.sum() * size**2 for size in (fine, 2 * fine)]
            self._cache["floor_area_m2"] = float(2 * areas[0] - areas[1])
        return self._cache["floor_area_m2"]

    def __getstate__(self) -> dict:
        # Caches stay behind, but not the home: it must come back to the last bit.
        kept = {key: self._cache[key] for key in ("home",) if key in self._cache}
        return {**self.__dict__, "_cache": kept}

    def __setstate__(self, state: dict) -> None:
        self.__dict__.update(state)


def validate(plan: Floorplan) -> Floorplan:
    """Return the plan if a robot can explore it; otherwise raise MapError naming the value and the remedy."""
    where = f"map {plan.name!r}"
    _check_walls(plan, where)
    _check_names(plan, where)
    cells = plan.cells(_CHECK_RESOLUTION_M)
    if not cells.free.any():
        raise MapError(
            f"{where} has no free space: none of its {len(plan.interior_m)} interior points lies clear of walls; "
            "put at least one point of interior_m into open floor"
        )
    _check_signs(plan, cells, where)
    for i in np.flatnonzero(~cells.is_free(plan.starts[:, :2])):
        at = _point_text(plan.starts[i])
        raise MapError(f"{where}: start {i} at {at} lies outside the free space; move it onto open floor")
    return plan


def read_floorplan(path: str | Path) -> Floorplan:
    """Read and check a native JSON plan. Raises MapError naming the file, the key and the remedy."""
    path = Path(path)
    return validate(floorplan_from_values(load_json(path), path.name))


def load_bytes(path: Path, what: str = "map") -> bytes:
    """The content of a map file, unpacked if its name ends in .gz; MapError when it cannot be read or is too large."""
    try:
        with gzip.open(path) if path.name.lower().endswith(".gz") else path.open("rb") as file:
            raw = file.read(FILE_BYTES_MAX + 1)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise MapError(f"cannot read the {what} {path}: {error}; fetch the file again") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise MapError(f"cannot read the {what} {path}: {reason}; check the path") from error
    if len(raw) > FILE_BYTES_MAX:
        raise MapError(f"{path} holds more than {FILE_BYTES_MAX // 10**6} MB; cut the map into parts")
    return raw


def load_json(path: Path) -> object:
    """The values of a JSON file (also .gz); MapError when it cannot be read, is no JSON or nests without end."""
    try:
        return json.loads(load_bytes(path).decode("utf-8"))
    except RecursionError as error:
        raise MapError(f"{path} nests its lists too deeply; export it again") from error
    except ValueError as error:
        raise MapError(f"{path} is not valid JSON: {error}; fix it or export it again") from error


def write_floorplan(plan: Floorplan, path: str | Path) -> None:
    """Write the native JSON format; `read_floorplan` gives the same plan back."""
    values = _to_values(plan)
    lines = [f"{json.dumps(key)}: {_json_rows(value)}" for key, value in values.items()]
    Path(path).write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def floorplan_from_values(values: object, where: str) -> Floorplan:
    """Build a plan from the values of a native JSON file; `where` names the file in errors."""
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


def mac_text(mac: int) -> str:
    """48-bit address -> "02:00:5e:10:00:01"."""
    return ":".join(f"{mac >> shift & 255:02x}" for shift in range(40, -1, -8))


def _carried(plan: Floorplan, pose: Array, pose_building_home: Array) -> Floorplan:
    """Everything in the plan moved by `pose`; its distance from home is given."""
    pose = np.asarray(pose, float)

    def move(points_m: Array) -> Array:
        return transform_points(pose, np.asarray(points_m).reshape(-1, 2))

    return Floorplan(
        name=plan.name,
        walls_m=move(plan.walls_m).reshape(-1, 2, 2),
        wall_loss_db=plan.wall_loss_db,
        rooms=tuple(Room(r.name, move(r.polygon_m)) for r in plan.rooms),
        signs=tuple(Sign(s.text, move(s.position_m)[0], s.facing_rad + float(pose[2])) for s in plan.signs),
        access_points=tuple(dataclasses.replace(a, position_m=move(a.position_m)[0]) for a in plan.access_points),
        starts=compose(pose, plan.starts),
        interior_m=move(plan.interior_m),
        pose_building_home=pose_building_home,
        wall_materials=plan.wall_materials,
    )


def _check_walls(plan: Floorplan, where: str) -> None:
    if len(plan.walls_m) == 0:
        raise MapError(f"{where} has no walls; a building needs at least a closed outer wall")
    if len(plan.wall_loss_db) != len(plan.walls_m):
        raise MapError(
            f"{where} has {len(plan.walls_m)} walls but {len(plan.wall_loss_db)} losses; give one loss per wall"
        )
    for label, values in _all_numbers(plan):
        if not np.isfinite(values).all():
            raise MapError(f"{where}: {label} holds a value that is not finite (NaN or infinity); give plain numbers")
        if values.size and np.abs(values).max() > COORDINATE_MAX_M:
            raise MapError(f"{where}: {label} holds {np.abs(values).max():.3g}, too large; lengths must be metres")
    lengths = np.linalg.norm(plan.walls_m[:, 1] - plan.walls_m[:, 0], axis=1)
    for i in np.flatnonzero(lengths < _WALL_LENGTH_MIN_M):
        raise MapError(f"{where}: wall {i} at {_point_text(plan.walls_m[i, 0])} has no length; remove it")
    if len(plan.wall_materials) not in (0, len(plan.walls_m)):
        raise MapError(
            f"{where} has {len(plan.walls_m)} walls but {len(plan.wall_materials)} materials; name one per wall or none"
        )
    for name in set(plan.wall_materials) - {"", *MATERIALS}:
        near = difflib.get_close_matches(str(name), MATERIALS, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(MATERIALS)}"
        raise MapError(f"{where}: a wall is of the unknown material {name!r}; {hint}")
    for i in np.flatnonzero((plan.wall_loss_db < 0) | (plan.wall_loss_db > 1000)):
        raise MapError(f"{where}: wall {i} has a loss of {plan.wall_loss_db[i]:g} dB; losses are 0 to 1000")


def _all_numbers(plan: Floorplan):
    for key in ("walls_m", "wall_loss_db", "starts", "interior_m", "pose_building_home"):
        yield key, getattr(plan, key)
    for room in plan.rooms:
        yield f"room {room.name!r}", room.polygon_m
    for sign in plan.signs:
        yield f"sign {sign.text!r}", np.append(sign.position_m, sign.facing_rad)
    for access_point in plan.access_points:
        yield f"access point {access_point.name!r}", access_point.position_m


def _check_names(plan: Floorplan, where: str) -> None:
    owner: dict[int, str] = {}
    for access_point in plan.access_points:
        if not access_point.macs:
            raise MapError(f"{where}: access point {access_point.name!r} has no MAC address; give it at least one")
        for mac in access_point.macs:
            if not 0 < mac < 1 << 48:
                raise MapError(f"{where}: access point {access_point.name!r} has MAC {mac}; use 48 bits, not all zero")
            if mac in owner:
                raise MapError(
                    f"{where}: MAC {mac_text(mac)} is used by {owner[mac]!r} and by {access_point.name!r}; "
                    "every address must be unique"
                )
            owner[mac] = access_point.name
    for i, sign in enumerate(plan.signs):
        if not sign.text.strip():
            raise MapError(f"{where}: sign {i} at {_point_text(sign.position_m)} has no text; give it one or remove it")


def _check_signs(plan: Floorplan, cells: Cells, where: str) -> None:
    for sign in plan.signs:
        label = f"{where}: sign {sign.text!r} at {_point_text(sign.position_m)}"
        if plan.wall_index.distance_m(sign.position_m[None], SIGN_TO_WALL_MAX_M)[0] >= SIGN_TO_WALL_MAX_M:
            raise MapError(f"{label} hangs on no wall: none is within {SIGN_TO_WALL_MAX_M} m; move it onto one")
        normal = np.array([np.cos(sign.facing_rad), np.sin(sign.facing_rad)])
        front = sign.position_m + SIGN_FRONT_M * normal
        if not cells.is_free(front):
            raise MapError(
                f"{label} has nothing free in front of it: {_point_text(front)} is no open floor; turn or move it"
            )
        face = sign.position_m + SIGN_FACE_M * normal
        if plan.wall_index.crossing(front, face[None])[0][0]:
            raise MapError(f"{label} is buried inside a wall; move it to the wall's face, towards its facing side")


def _rasterise(plan: Floorplan, resolution_m: float) -> Cells:
    low_x, low_y, high_x, high_y = plan.bounds_m
    # The outermost walls, and all walls whole cells away from them, run through cell centres.
    origin = np.array([low_x, low_y]) - 1.5 * resolution_m
    columns, rows = (np.round((np.array([high_x, high_y]) - origin) / resolution_m + 2.0).astype(int)).tolist()
    if rows * columns > CELLS_MAX:
        raise MapError(
            f"map {plan.name!r} spans {high_x - low_x:.0f} x {high_y - low_y:.0f} m, too large for cells of "
            f"{resolution_m:g} m ({CELLS_MAX} at most); check its unit, or use larger cells"
        )
    wall = np.zeros((rows, columns), np.bool_)
    _stamp_walls(plan.walls_m.reshape(-1, 4), origin, resolution_m, wall)
    free = np.zeros((rows, columns), np.bool_)
    seeds = np.floor((plan.interior_m - origin) / resolution_m).astype(np.int64)
    leaks = _flood(wall, seeds, free)
    if leaks:
        raise MapError(
            f"map {plan.name!r} is not closed: its free space reaches the edge of the drawing; "
            "close the outer wall, or move the interior points inside"
        )
    for array in (wall, free):
        array.flags.writeable = False
    return Cells(free, wall, origin, resolution_m)


@njit(cache=True, error_model="numpy")
def _stamp_walls(walls, origin, resolution, wall):
    rows, columns = wall.shape
    reach = 0.5 * resolution * (1.0 + 1e-6)
    for w in range(walls.shape[0]):
        ax, ay = walls[w, 0] - origin[0], walls[w, 1] - origin[1]
        bx, by = walls[w, 2] - origin[0], walls[w, 3] - origin[1]
        ex, ey = bx - ax, by - ay
        length2 = ex * ex + ey * ey
        r0 = max(int((min(ay, by) - reach) / resolution), 0)
        r1 = min(int((max(ay, by) + reach) / resolution), rows - 1)
        for r in range(r0, r1 + 1):
            y = (r + 0.5) * resolution
            # The part of the wall near this row bounds the columns to look at.
            t0, t1 = 0.0, 1.0
            if abs(ey) > 1e-9:
                ta, tb = (y - resolution - ay) / ey, (y + resolution - ay) / ey
                t0, t1 = max(t0, min(ta, tb)), min(t1, max(ta, tb))
                if t1 < t0:
                    continue
            xa, xb = ax + t0 * ex, ax + t1 * ex
            c0 = max(int((min(xa, xb) - resolution) / resolution), 0)
            c1 = min(int((max(xa, xb) + resolution) / resolution), columns - 1)
            for c in range(c0, c1 + 1):
                x = (c + 0.5) * resolution
                t = min(max(((x - ax) * ex + (y - ay) * ey) / length2, 0.0), 1.0)
                dx, dy = x - ax - t * ex, y - ay - t * ey
                if dx * dx + dy * dy <= reach * reach:
                    wall[r, c] = True


@njit(cache=True, error_model="numpy")
def _flood(wall, seeds, free):
    """Grow free from the seeds (k, 2) column, row; True when it reaches the raster's edge."""
    rows, columns = wall.shape
    stack = np.empty(rows * columns, np.int32)
    leaks = False
    for k in range(seeds.shape[0]):
        c, r = seeds[k, 0], seeds[k, 1]
        if r < 0 or r >= rows or c < 0 or c >= columns or wall[r, c] or free[r, c]:
            continue
        free[r, c] = True
        stack[0] = r * columns + c
        size = 1
        while size > 0:
            size -= 1
            r, c = stack[size] // columns, stack[size] % columns
            if r == 0 or c == 0 or r == rows - 1 or c == columns - 1:
                leaks = True
                continue
            for step in range(4):
                nr = r + (step == 0) - (step == 1)
                nc = c + (step == 2) - (step == 3)
                if not wall[nr, nc] and not free[nr, nc]:
                    free[nr, nc] = True
                    stack[size] = nr * columns + nc
                    size += 1
    return leaks


# --- native JSON -----------------------------------------------------------------------------------------------------


def _to_values(plan: Floorplan) -> dict:
    values = {
        "format": FORMAT,
        "name": plan.name,
        "walls": np.column_stack([plan.walls_m.reshape(-1, 4), plan.wall_loss_db]).tolist(),
        "interior_m": plan.interior_m.tolist(),
        "starts": plan.starts.tolist(),
        "rooms": [{"name": r.name, "polygon_m": np.asarray(r.polygon_m).tolist()} for r in plan.rooms],
        "signs": [
            {"text": s.text, "position_m": np.asarray(s.position_m).tolist(), "facing_rad": float(s.facing_rad)}
            for s in plan.signs
        ],
        "access_points": [
            {
                "name": a.name,
                "position_m": np.asarray(a.position_m).tolist(),
                "macs": [mac_text(mac) for mac in a.macs],
                **({"floor": a.floor} if a.floor else {}),
            }
            for a in plan.access_points
        ],
    }
    if any(plan.wall_materials):
        names = sorted(set(plan.wall_materials) - {""})
        values["materials"] = {n: [i for i, m in enumerate(plan.wall_materials) if m == n] for n in names}
    if plan.pose_building_home.any():
        values["pose_building_home"] = plan.pose_building_home.tolist()
    return values


def _json_rows(value: object) -> str:
    """Lists one item per line, the rest on one line."""
    if not isinstance(value, list) or not value or not isinstance(value[0], (list, dict)):
        return json.dumps(value, ensure_ascii=False)
    return "[\n  " + ",\n  ".join(json.dumps(item, ensure_ascii=False) for item in value) + "\n]"


def _digest_text(home: Floorplan) -> str:
    """All values to a tenth of a millimetre or milliradian, so that moving there and back keeps the digest."""
    values = {**_to_values(home), "pose_building_home": None}
    for sign in values["signs"]:
        sign["facing_rad"] = _rounded_angle(sign["facing_rad"])
    for start in values["starts"]:
        start[2] = _rounded_angle(start[2])
    return json.dumps(_rounded(values), sort_keys=True)


def _rounded_angle(angle_rad: float) -> float:
    turn = 2 * np.pi
    return round(angle_rad % turn, 4) % round(turn, 4)


def _rounded(value: object) -> object:
    if isinstance(value, float):
        return round(value, 4) + 0.0
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return value


def _table(values: object, where: str, required: tuple[str, ...], optional: tuple[str, ...] = ()) -> dict:
    if not isinstance(values, dict):
        raise MapError(f"{where} must be a JSON object with {', '.join(required)}; got {type(values).__name__}")
    known = (*required, *optional)
    for key in values:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known)}"
            raise MapError(f"{where} has the unknown key {key!r}; {hint}")
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
            raise ValueError  # texts and booleans convert, but are a mistake
    except (TypeError, ValueError, OverflowError, RecursionError):
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
    """{material: wall numbers} -> one name per wall; empty when none is named."""
    if not isinstance(values, dict):
        raise MapError(f"{where} must be a JSON object from material to wall numbers; got {type(values).__name__}")
    names = [""] * (wall_count if values else 0)
    for material, walls in values.items():
        if not isinstance(walls, list):
            raise MapError(f"{where}.{material} must be a list of wall numbers; got {_short(walls)}")
        for wall in walls:
            if type(wall) is not int or not 0 <= wall < wall_count:
                raise MapError(f"{where}.{material} names wall {_short(wall)}; walls are 0 to {wall_count - 1}")
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


def _frozen_array(value: object, shape: tuple[int, ...], where: str) -> Array:
    array = np.array(value, dtype=float)
    try:
        array = np.ascontiguousarray(array.reshape((0, *shape[1:]) if array.size == 0 else shape))
    except ValueError:
        raise MapError(f"{where} must have shape {shape}; got {array.shape}") from None
    array.flags.writeable = False
    return array


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _point_text(point: Array) -> str:
    return f"({point[0]:.2f}, {point[1]:.2f})"
