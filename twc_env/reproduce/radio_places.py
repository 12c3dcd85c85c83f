"""Plans that imitate the places of real radio surveys, and simulation of the radio model at the scans of a survey.

Unknown walls are those of an office or hall of the same extent; access points are at their known positions, or spread
by seed. Strengths are never taken from the data.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array
from scipy.ndimage import distance_transform_edt

from twc_env.config import RadioConfig
from twc_env.datasets.surveys.ble_flat import Flat
from twc_env.datasets.surveys.fingerprints import RadioSurvey
from twc_env.records.geometry import points_along
from twc_env.records.random_streams import random_stream
from twc_env.reproduce.routes import RoutePlanner
from twc_env.world.building.floor_cells import Cells
from twc_env.world.building.floorplan import AccessPoint, Floorplan
from twc_env.world.sensors.radio import RadioModel
from twc_env.world.sensors.reception import WifiReceiver

_VENDOR = 0x02_00_5E << 24
MODULE_M, WALL_DB, OUTER_WALL_DB = 7.0, 4.0, 10.0
"""Width of rooms, and losses of walls, if unknown."""
WALL_FACES = 2
"""Lines of the outline of a flat, or of its free space, that a ray through one wall crosses."""


def office(name: str, bounds_m: Array, module_m: float = MODULE_M, wall_db: float = WALL_DB) -> Floorplan:
    """Rooms of `module_m` on both sides of corridors 2.4 m wide along the longer side of bounds (4,)."""
    x0, y0, x1, y1 = (float(v) for v in bounds_m)
    middle = np.array([[(x0 + x1) / 2, (y0 + y1) / 2]])
    turned = y1 - y0 > x1 - x0
    if turned:
        x0, y0, x1, y1 = y0, x0, y1, x1
    corners = ((x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0))
    walls = [(*start, *end, OUTER_WALL_DB) for start, end in itertools.pairwise(corners)]
    bands = max(1, round((y1 - y0) / (2 * module_m + 2.4)))
    height = (y1 - y0) / bands
    for band in range(bands):
        low, high = y0 + band * height, y0 + (band + 1) * height
        near, far = low + (height - 2.4) / 2, high - (height - 2.4) / 2
        if band:
            walls.append((x0, low, x1, low, wall_db))
        walls += [(x0, near, x1, near, wall_db), (x0, far, x1, far, wall_db)]
        for x in np.arange(x0 + module_m, x1 - 1.0, module_m):
            walls += [(x, low, x, near, wall_db), (x, far, x, high, wall_db)]
    table = np.array(walls)
    ends = table[:, [1, 0, 3, 2]] if turned else table[:, :4]
    return Floorplan(name, ends.reshape(-1, 2, 2), table[:, 4], interior_m=middle)


def flat(plan: Flat, wall_db: float) -> Floorplan:
    """The outline as a plan: each face of a wall has half of its loss."""
    ends = np.stack([plan.outline_m, np.roll(plan.outline_m, -1, axis=0)], axis=1)
    points = [AccessPoint(f"anchor-{i}", place, (i + 1,)) for i, place in enumerate(plan.anchors_m)]
    return Floorplan(
        "flat", ends, np.full(len(ends), wall_db / WALL_FACES), access_points=tuple(points), interior_m=np.ones((1, 2))
    )


def walls_of(faces: Array) -> Array:
    """Number of walls from the number of faces crossed; a ray that ends inside a wall has crossed it."""
    return (faces + WALL_FACES - 1) // WALL_FACES


def another(plan: Floorplan, seed: int) -> Floorplan:
    """The plan under another name, which gives other shadowing and transmitter powers."""
    return dataclasses.replace(plan, name=f"{plan.name} {seed}")


def with_known_transmitters(plan: Floorplan, survey: RadioSurvey, floor: int) -> Floorplan:
    """Access points at the transmitters of the survey: address k of the plan is column k - 1 of the survey."""
    transmitter_m, storeys, is_high = survey.transmitters
    boxes: dict[tuple, list[int]] = {}
    for k, (place, level) in enumerate(zip(transmitter_m, storeys, strict=True)):
        boxes.setdefault((*place.tolist(), int(level)), []).append(k)
    points = []
    for (x, y, level), columns in boxes.items():
        ordered = sorted(columns, key=lambda k: bool(is_high[k]))
        points.append(AccessPoint(f"ap-{columns[0]}", np.array([x, y]), tuple(k + 1 for k in ordered), level - floor))
    return dataclasses.replace(plan, access_points=tuple(points))


def with_spread_transmitters(
    plan: Floorplan,
    boxes: int,
    addresses: int,
    seed: int,
    bounds_m: Array | None = None,
    floors: Sequence[int] = (0,),
    around: Cells | None = None,
) -> Floorplan:
    """Access points at random positions, distributed over storeys: within bounds (default: the plan's), or on the free
    cells of `around`."""
    random = random_stream(seed, f"transmitters {plan.name}")
    if around is not None:
        rows, columns = np.nonzero(around.free)
        drawn = random.integers(0, len(rows), boxes)
        corners = np.column_stack([columns[drawn], rows[drawn]]) + random.random((boxes, 2))
        places = around.origin_m + around.resolution_m * corners
    else:
        low_high = plan.bounds_m if bounds_m is None else np.asarray(bounds_m, float)
        places = random.uniform(low_high[:2], low_high[2:], (boxes, 2))
    ends = np.linspace(0, addresses, boxes + 1).round().astype(int)
    points = [
        AccessPoint(
            f"ap-{i}", places[i], tuple(range(_VENDOR + int(ends[i]) + 1, _VENDOR + int(ends[i + 1]) + 1)),
            int(floors[i % len(floors)]),
        )
        for i in range(boxes)
        if ends[i + 1] > ends[i]
    ]  # fmt: skip
    return dataclasses.replace(plan, access_points=tuple(points))


def beside_wide_floor(cells: Cells, width_m: float, depth_m: float) -> Cells:
    """The area within `depth_m` of floor at least `width_m` wide: shops along a concourse, no service corridors."""
    inside_m = distance_transform_edt(np.pad(cells.free, 1))[1:-1, 1:-1] * cells.resolution_m
    wide = distance_transform_edt(inside_m < width_m / 2) * cells.resolution_m <= width_m / 2
    beside = distance_transform_edt(~wide) * cells.resolution_m <= depth_m
    return dataclasses.replace(cells, free=beside)


def over_storeys(plan: Floorplan, floors: Sequence[int]) -> Floorplan:
    """The plan with its access points distributed over storeys."""
    points = [dataclasses.replace(point, floor=floors[i % len(floors)]) for i, point in enumerate(plan.access_points)]
    return dataclasses.replace(plan, access_points=tuple(points))


class RememberingModel(RadioModel):
    """A radio model that caches its results by position, for several receivers at the same positions."""

    def __init__(self, config: RadioConfig, plan: Floorplan):
        super().__init__(config, plan)
        self._known: dict[bytes, Array] = {}

    def mean_rssi_dbm(self, position_m: Array, bodies: Array | None = None) -> Array:
        """(transmitters,) as RadioModel; not cached among people."""
        if bodies is not None:
            return super().mean_rssi_dbm(position_m, bodies)
        key = np.asarray(position_m, float).tobytes()
        if key not in self._known:
            self._known[key] = super().mean_rssi_dbm(position_m)
        return self._known[key].copy()


def simulate(
    survey: RadioSurvey,
    plan: Floorplan,
    config: RadioConfig,
    seed: int,
    phones: bool = True,
    model: RadioModel | None = None,
) -> RadioSurvey:
    """The survey with simulated readings at its positions and times, in the plan of one storey.

    Each walk has its own phone, unless `phones` is False. An existing `model` may be given.
    """
    model = model or RadioModel(config, plan)
    table = np.full((len(survey.position_m), len(model.macs)), np.nan, np.float32)
    ages = table.copy()
    receivers: dict[int, WifiReceiver] = {}
    for k, (place, walk) in enumerate(zip(survey.position_m, survey.walk.tolist(), strict=True)):
        device = walk if phones else 0
        if device not in receivers:
            receivers[device] = WifiReceiver(config, model, device, seed)
        scan = receivers[device].scan(place, float(survey.time_s[k]))
        columns = np.searchsorted(model.macs, scan.macs)
        table[k, columns] = scan.rssi_dbm
        ages[k, columns] = 0.0 if scan.age_s is None else scan.age_s
    return dataclasses.replace(
        survey,
        addresses=tuple(str(mac) for mac in model.macs),
        rssi_dbm=table,
        transmitter_m=None,
        transmitter_floor=None,
        is_high_band=model.band_of == 1,
        age_s=ages,
    )


def stroll(plan: Floorplan, length_m: float, spacing_m: float, speed_m_s: float, seed: int) -> RadioSurvey:
    """A survey without readings along a walk between random places of the open floor."""
    way = RoutePlanner(plan).wander(length_m, random_stream(seed, f"stroll {plan.name}"))
    at = np.arange(0.0, length_m, spacing_m)
    zeros, nothing = np.zeros(len(at), int), np.zeros((len(at), 0), np.float32)
    return RadioSurvey(plan.name, points_along(way, at), zeros, at / speed_m_s, zeros, (), nothing)


def merged(surveys: Sequence[RadioSurvey]) -> RadioSurvey:
    """The scans of several phones at the same positions, averaged over those that heard a transmitter (papers.md
    R3)."""
    readings = np.stack([survey.rssi_dbm for survey in surveys])
    count = np.isfinite(readings).sum(axis=0)
    total = np.nansum(readings, axis=0)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)
    return dataclasses.replace(surveys[0], rssi_dbm=mean)
