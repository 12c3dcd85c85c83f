"""Procedural buildings: similar rooms, corridors that form loops, repeated signs and unique room names.

A floor consists of tiles (rooms, open floor, voids) on a 0.1 m grid, with walls on their common edges and doors as gaps
in them. The same arguments give the same building on every machine.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import MapError
from twc_env.records.random_streams import random_stream
from twc_env.world.building.fittings import finish
from twc_env.world.building.floor_cells import Cells
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.floorplan_check import validate
from twc_env.world.building.layouts import KINDS, LAYOUTS

AREA_MIN_M2, AREA_MAX_M2 = 100, 10_000
"""Limits of the gross floor area."""
ROBOT_RADIUS_M = 0.2
"""Robots of this radius can reach every room."""
_NAMED_MAX = 5
"""Rooms listed in an error."""


def generate(kind: str, area_m2: float, seed: int, check: bool = True) -> Floorplan:
    """The building `gen:KIND:AREA:SEED`; check: validate it and check that all rooms are reachable.

    Raises MapError for an unknown kind, a gross floor area outside 100 .. 10,000 m2 or a negative seed.
    """
    if kind not in KINDS:
        raise MapError(f"no buildings of kind {kind!r}; kinds are {', '.join(KINDS)}")
    if not AREA_MIN_M2 <= area_m2 <= AREA_MAX_M2:
        raise MapError(f"the floor area must be {AREA_MIN_M2} to {AREA_MAX_M2} m2; got {area_m2:g}")
    if seed < 0:
        raise MapError(f"the seed of a building must be 0 or more; got {seed}")
    random = random_stream(seed, f"generate-{kind}-{area_m2:g}")
    drawing = LAYOUTS[kind](area_m2, random)
    plan = finish(drawing, f"gen:{kind}:{area_m2:g}:{seed}", random)
    return check_reachable(validate(plan)) if check else plan


def check_reachable(plan: Floorplan, radius_m: float = ROBOT_RADIUS_M) -> Floorplan:
    """Return the plan if a disc of this radius can move between all rooms; otherwise raise MapError."""
    cells = plan.cells()
    labels, sizes = _parts(cells, radius_m)
    if len(sizes) < 2:
        raise MapError(f"map {plan.name!r} has no room for a robot of radius {radius_m:g} m; widen the floor")
    largest = 1 + int(np.argmax(sizes[1:]))
    out_of_reach = []
    for room in plan.rooms:
        low = np.floor((room.polygon_m.min(axis=0) - cells.origin_m) / cells.resolution_m).astype(int).clip(0)
        high = np.ceil((room.polygon_m.max(axis=0) - cells.origin_m) / cells.resolution_m).astype(int)
        if not (labels[low[1] : high[1], low[0] : high[0]] == largest).any():
            out_of_reach.append(repr(room.name))
    if out_of_reach:
        raise MapError(
            f"map {plan.name!r}: {len(out_of_reach)} of {len(plan.rooms)} rooms cannot be reached by a robot of radius "
            f"{radius_m:g} m ({', '.join(out_of_reach[:_NAMED_MAX])}"
            f"{', ...' if len(out_of_reach) > _NAMED_MAX else ''}); widen their doors or clear the way"
        )
    return plan


def cut_off_m2(plan: Floorplan, radius_m: float) -> float:
    """Area of the floor where a disc of this radius fits, and from where it cannot move to the largest such part."""
    cells = plan.cells()
    _, sizes = _parts(cells, radius_m)
    return float(sizes[1:].sum() - sizes[1:].max(initial=0)) * cells.resolution_m**2


def _parts(cells: Cells, radius_m: float) -> tuple[Array, Array]:
    """Where the centre of a disc can be: (rows, columns) numbers of connected parts, 0 for nowhere, and the count of
    cells of each."""
    from scipy import ndimage  # slow to import

    gap_m = ndimage.distance_transform_edt(~cells.wall) * cells.resolution_m
    labels, _ = ndimage.label(cells.free & (gap_m > radius_m + cells.resolution_m / 2))
    return labels, np.bincount(labels.ravel())
