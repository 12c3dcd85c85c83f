"""Validation of floor plans: walls, names, free space, signs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import MapError, one_of
from twc_env.world.building.floor_cells import Cells
from twc_env.world.building.floorplan import SIGN_FACE_M, SIGN_FRONT_M, Floorplan, Sign, angle_fault, mac_text
from twc_env.world.building.materials import MATERIALS

SIGN_TO_WALL_MAX_M = 0.3
_WALL_LENGTH_MIN_M = 1e-6
COORDINATE_MAX_M = 100_000.0
"""Limit of absolute coordinates, below which single precision resolves decimetres."""
_CHECK_RESOLUTION_M = 0.1


def validate(plan: Floorplan) -> Floorplan:
    """Return the plan if it is valid; otherwise raise MapError."""
    if "is_sound" in plan._cache:
        return plan
    where = f"map {plan.name!r}"
    _check_walls(plan, where)
    _check_names(plan, where)
    _check_angles(plan.home, where)
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
    plan._cache["is_sound"] = True
    return plan


def _check_walls(plan: Floorplan, where: str) -> None:
    if len(plan.walls_m) == 0:
        raise MapError(f"{where} has no walls; a building needs at least a closed outer wall")
    if len(plan.wall_loss_db) != len(plan.walls_m):
        raise MapError(
            f"{where} has {len(plan.walls_m)} walls but {len(plan.wall_loss_db)} losses; give one loss per wall"
        )
    for label, values in _named_arrays(plan):
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
        hint = one_of(name, MATERIALS)
        raise MapError(f"{where}: a wall is of the unknown material {name!r}{hint}")
    for i in np.flatnonzero((plan.wall_loss_db < 0) | (plan.wall_loss_db > 1000)):
        raise MapError(f"{where}: wall {i} has a loss of {plan.wall_loss_db[i]:g} dB; losses are 0 to 1000")


def _check_angles(home: Floorplan, where: str) -> None:
    named = [(f"start {i}: its heading", start[2]) for i, start in enumerate(home.starts)]
    for name, angle_rad in named + [(f"sign {sign.text!r}: facing_rad", sign.facing_rad) for sign in home.signs]:
        if fault := angle_fault(angle_rad):
            raise MapError(f"{where}: {name} {fault}")


def _named_arrays(plan: Floorplan) -> Iterator[tuple[str, Array]]:
    for key in ("walls_m", "wall_loss_db", "starts", "interior_m", "pose_building_home"):
        yield key, getattr(plan, key)
    for room in plan.rooms:
        yield f"room {room.name!r}", room.polygon_m
    for sign in plan.signs:
        yield f"sign {sign.text!r}", np.append(sign.position_m, sign.facing_rad)
    for access_point in plan.access_points:
        yield f"access point {access_point.name!r}", access_point.position_m


def _check_names(plan: Floorplan, where: str) -> None:
    names = [plan.name, *(room.name for room in plan.rooms), *(point.name for point in plan.access_points)]
    for text in names + [sign.text for sign in plan.signs]:
        if not isinstance(text, str):
            raise MapError(f"{where}: names and sign texts are texts; got {text!r}")
        if any("\ud800" <= letter <= "\udfff" for letter in text):
            raise MapError(f"{where}: the text {text[:40]!r} holds half a letter (a lone surrogate); write it whole")
    owner: dict[int, str] = {}
    for access_point in plan.access_points:
        if not access_point.macs:
            raise MapError(f"{where}: access point {access_point.name!r} has no MAC address; give it at least one")
        for mac in access_point.macs:
            if not isinstance(mac, (int, np.integer)) or not 0 < mac < 1 << 48:
                raise MapError(
                    f"{where}: access point {access_point.name!r} has MAC {mac!r}; use a number of 48 bits, not 0"
                )
            if mac in owner:
                raise MapError(
                    f"{where}: MAC {mac_text(mac)} is used by {owner[mac]!r} and by {access_point.name!r}; "
                    "every address must be unique"
                )
            owner[mac] = access_point.name
    for i, sign in enumerate(plan.signs):
        if not sign.text.strip():
            raise MapError(f"{where}: sign {i} at {_point_text(sign.position_m)} has no text; give it one or remove it")


def hangs_well(plan: Floorplan, sign: Sign) -> bool:
    """Whether a sign hangs on a wall of the plan, with free floor in front."""
    return not _sign_fault(plan, sign, plan.cells(_CHECK_RESOLUTION_M))


def _check_signs(plan: Floorplan, cells: Cells, where: str) -> None:
    for sign in plan.signs:
        if fault := _sign_fault(plan, sign, cells):
            raise MapError(f"{where}: sign {sign.text!r} at {_point_text(sign.position_m)} {fault}")


def _sign_fault(plan: Floorplan, sign: Sign, cells: Cells) -> str:
    if plan.wall_index.distance_m(sign.position_m[None], SIGN_TO_WALL_MAX_M)[0] >= SIGN_TO_WALL_MAX_M:
        return f"is not on a wall: there is none within {SIGN_TO_WALL_MAX_M} m; move it onto one"
    normal = np.array([np.cos(sign.facing_rad), np.sin(sign.facing_rad)])
    front = sign.position_m + SIGN_FRONT_M * normal
    if not cells.is_free(front):
        return f"has no free floor in front of it: {_point_text(front)} is not free; turn or move it"
    face = sign.position_m + SIGN_FACE_M * normal
    if plan.wall_index.crossing(front, face[None])[0][0]:
        return "is buried inside a wall; move it to the wall's face, towards its facing side"
    return ""


def _point_text(point: Array) -> str:
    return f"({point[0]:.2f}, {point[1]:.2f})"
