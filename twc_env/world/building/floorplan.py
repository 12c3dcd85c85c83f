"""Floor plans: walls, rooms, signs and access points, and rigid motions of them.

Lengths in metres, angles in radians, counter-clockwise from +x. A moved plan stores its home pose: random properties
of a building (shadowing, sampled starts) are fixed in the home frame, so measurements do not depend on the motion.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import UNFIT, MapError
from twc_env.records.geometry import compose, inverse, transform_points
from twc_env.world.building.floor_cells import Cells, rasterise
from twc_env.world.building.wall_index import WallIndex, index_walls

FORMAT = "twc_env/floorplan-1"
ANGLE_MAX_RAD = 12.567
"""Two turns; greater angles are taken for degrees and rejected."""
SIGN_FRONT_M = 0.3
"""The point this far in front of a sign must be free."""
SIGN_FACE_M = 0.02
"""Distance of the point that cameras observe in front of a sign's position."""
_AREA_CELLS = ((0.0125, 500.0), (0.025, 4000.0), (0.05, 40_000.0), (0.1, math.inf))
"""Cell sizes [m] for the floor area, and the bounding box areas [m2] up to which each is used."""


@dataclass(frozen=True, slots=True, eq=False)
class Sign:
    """A text on a wall."""

    text: str
    position_m: Array
    """(2,)."""
    facing_rad: float
    """Direction of the outward normal of the wall it hangs on."""

    def __post_init__(self) -> None:
        _keep_array(self, "position_m", self.text)


@dataclass(frozen=True, slots=True, eq=False)
class AccessPoint:
    """A WiFi access point, which transmits under one or several MAC addresses."""

    name: str
    position_m: Array
    """(2,)."""
    macs: tuple[int, ...]
    """48-bit addresses, unique over the plan."""
    floor: int = 0
    """Storey relative to the drawn one (negative: below); the signal crosses the ceilings between them."""

    def __post_init__(self) -> None:
        _keep_array(self, "position_m", self.name)


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """A named part of the floor."""

    name: str
    polygon_m: Array
    """(k, 2) corners in order, not closed."""

    def __post_init__(self) -> None:
        _keep_array(self, "polygon_m", self.name)


@dataclass(frozen=True, slots=True)
class Origin:
    """What the random properties of a building are drawn from and numbered by."""

    digest: str
    """`Floorplan.digest` of the whole building."""
    macs: tuple[tuple[int, ...], ...]
    """The addresses of each of its access points, in order."""


@dataclass(frozen=True, eq=False)
class Floorplan:
    """One floor of a building; arrays are read-only. `floorplan_check.validate` checks it."""

    name: str
    walls_m: Array
    """(walls, 2, 2): both ends (x, y) of each wall segment."""
    wall_loss_db: Array
    """(walls,) RSSI loss per crossing."""
    rooms: tuple[Room, ...] = ()
    signs: tuple[Sign, ...] = ()
    access_points: tuple[AccessPoint, ...] = ()
    starts: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(starts, 3) suggested start poses; may be empty."""
    interior_m: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """(k, 2) free points; the floor is all space connected to them."""
    pose_building_home: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) pose of the frame in which the plan was drawn; zero unless moved."""
    wall_materials: tuple[str, ...] = ()
    """(walls,) material names, "" if unknown; empty if all are unknown."""
    subsampled_from: Origin | None = None
    """Of the whole building, if this plan is what `subsampling.subsampled` left of it. Neither in the digest nor in
    files."""
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
            object.__setattr__(self, key, _read_only(getattr(self, key), shape, f"{key} of map {self.name!r}"))
        for key in ("rooms", "signs", "access_points", "wall_materials"):
            object.__setattr__(self, key, tuple(getattr(self, key)))

    @property
    def bounds_m(self) -> Array:
        """(4,) x_min, y_min, x_max, y_max over all walls."""
        ends = self.walls_m.reshape(-1, 2)
        return np.concatenate([ends.min(axis=0), ends.max(axis=0)])

    @property
    def home(self) -> Floorplan:
        """The plan in the frame in which it was drawn."""
        if not self.pose_building_home.any():
            return self
        if "home" not in self._cache:
            self._cache["home"] = _transformed(self, inverse(self.pose_building_home), np.zeros(3))
        return self._cache["home"]

    @cached_property
    def digest(self) -> str:
        """Twelve hex digits (SHA-256) of the content in the home frame."""
        return hashlib.sha256(_digest_text(self.home).encode()).hexdigest()[:12]

    @cached_property
    def origin(self) -> Origin:
        """Of the whole building where signs or access points were left out, otherwise of the plan itself.

        A subsampled plan that was given other access points is a building of its own.
        """
        own = tuple(tuple(a.macs) for a in self.access_points)
        if self.subsampled_from is not None and set(own) <= set(self.subsampled_from.macs):
            return self.subsampled_from
        return Origin(self.digest, own)

    @cached_property
    def wall_index(self) -> WallIndex:
        """Spatial index of the walls."""
        return index_walls(self.walls_m, self.wall_loss_db)

    def moved(self, pose: Array) -> Floorplan:
        """The plan after the rigid motion `pose` (3,)."""
        plan = _transformed(self, pose, compose(pose, self.pose_building_home))
        plan._cache["home"] = self.home
        return plan

    def cells(self, resolution_m: float = 0.1) -> Cells:
        """The raster, cached per resolution; walls at multiples of the cell size are one cell thick.

        Raises MapError for cells smaller than 0.005 m or larger than 10 m.
        """
        if not isinstance(resolution_m, (int, float)) or not 0.005 <= resolution_m <= 10.0:
            raise MapError(f"cells have a size of 0.005 to 10 m; got {resolution_m!r}")
        if ("cells", resolution_m) not in self._cache:
            self._cache["cells", resolution_m] = rasterise(self.name, self.walls_m, self.interior_m, resolution_m)
        return self._cache["cells", resolution_m]

    @cached_property
    def floor_area_m2(self) -> float:
        """Free area up to the wall lines.

        Rasters miss half a cell along every wall. This error is linear in the cell size, and Richardson extrapolation
        from two sizes removes it.
        """
        sizes = self.bounds_m[2:] - self.bounds_m[:2]
        fine = next(size for size, top in _AREA_CELLS if np.prod(sizes) < top)
        rasters = [rasterise(self.name, self.walls_m, self.interior_m, size) for size in (fine, 2 * fine)]
        areas = [raster.free.sum() * raster.resolution_m**2 for raster in rasters]
        return float(2 * areas[0] - areas[1])

    def __getstate__(self) -> dict:
        # Of the cache, only `home`: recomputing it from the moved plan would round differently.
        kept = {key: self._cache[key] for key in ("home",) if key in self._cache}
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)} | {"_cache": kept}


def angle_fault(angle_rad: float) -> str:
    """What is wrong with an angle that can only be meant in degrees; "" if nothing is."""
    if abs(angle_rad) <= ANGLE_MAX_RAD:
        return ""
    return (
        f"must be an angle in radians; got {angle_rad:g}: as many degrees are "
        f"{np.radians(angle_rad) % (2 * np.pi):.4f} rad"
    )


def local_macs(box: int, count: int) -> tuple[int, ...]:
    """Locally administered MAC addresses (02:...) of a generated access point."""
    return tuple(0x02005E << 24 | int(box) << 8 | k for k in range(count))


def mac_text(mac: int) -> str:
    """48-bit address -> "02:00:5e:10:00:01"."""
    return ":".join(f"{mac >> shift & 255:02x}" for shift in range(40, -1, -8))


def _transformed(plan: Floorplan, pose: Array, pose_building_home: Array) -> Floorplan:
    """The plan transformed by `pose`, with the given home pose."""
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
        subsampled_from=plan.subsampled_from,
    )


def to_values(plan: Floorplan) -> dict:
    """The plan as the values of a native JSON file."""
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


def _digest_text(home: Floorplan) -> str:
    """All values as text, rounded to 1e-4 m or rad so that a motion and its inverse keep the digest."""
    values = {**to_values(home), "pose_building_home": None}
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


def _keep_array(part: Sign | AccessPoint | Room, key: str, name: str) -> None:
    """Make an array of a list of coordinates. Raises MapError for anything else."""
    value = getattr(part, key)
    if isinstance(value, np.ndarray):
        return
    try:
        array = np.array(value)
        if array.dtype.kind not in "iuf":
            raise ValueError
    except UNFIT:
        raise MapError(f"{key} of {name!r} must be numbers; got {value!r:.80}") from None
    object.__setattr__(part, key, array)


def _read_only(value: object, shape: tuple[int, ...], where: str) -> Array:
    array = np.array(value, dtype=float)
    try:
        array = np.ascontiguousarray(array.reshape((0, *shape[1:]) if array.size == 0 else shape))
    except ValueError:
        raise MapError(f"{where} must have shape {shape}; got {array.shape}") from None
    array.flags.writeable = False
    return array
