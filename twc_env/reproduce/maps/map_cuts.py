"""Pairs of maps cut from one real map, drawn as two mapping runs would have saved them.

Each part has its own turn, origin and resolution; its walls are bent by a smooth error of the trajectory, rough by a
few centimetres, and have holes; and things of 0.2 to 0.5 m stand in it that are not in the other part. A part's true
pose is that at which its bent floor lies best on the building, as trajectories are aligned before errors are taken:
the mean of the bend is no error of the map's shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array
from scipy import ndimage

from twc_env.datasets.buildings.raster import largest_part
from twc_env.records.geometry import align_rigidly, compose, inverse
from twc_env.slam.saved_maps.saved_map import SavedMap

BEND_M, BEND_LENGTH_M = 0.04, 5.0
"""Standard deviation and length of the smooth error of a run's walls."""
ROUGH_M = 0.02
"""Standard deviation of each wall cell's place."""
HOLES = 0.08
"""Share of wall cells that a run has not seen."""
THINGS_PER_M2, THING_M = 1 / 25, (0.2, 0.5)
"""Density and diameters of what stands in one run only."""
REACH_M = 0.3
"""Walls this far from the floor of a part belong to it."""


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """Two saved maps of one building."""

    target: SavedMap
    source: SavedMap
    pose: Array
    """(3,) of the source's map frame in the target's."""
    overlap: float
    """Share of the smaller part's floor that the other knows."""
    without_errors: tuple[SavedMap, ...] = ()
    """The parts as the building shows them, in its frame; none if they are of two buildings."""


def overlapping_parts(building: SavedMap, share: float, random: np.random.Generator) -> tuple[Array, Array]:
    """Floor (rows, columns) bool of two parts of equal size on both sides of a random direction, of which `share` is
    common; negative: a share between them that neither has."""
    floor = largest_part(building.free)
    across = _across(floor, random.uniform(0.0, np.pi))
    # Each part has the share p of the floor: 2 p - share p = 1.
    of_all = 1.0 / (2.0 - share)
    low, high = np.quantile(across[floor], [1.0 - of_all, of_all])
    return largest_part(floor & (across <= high)), largest_part(floor & (across >= low))


def overlap_of(parts: tuple[Array, Array]) -> float:
    """Share of the smaller part's floor that both have."""
    both = int((parts[0] & parts[1]).sum())
    return both / max(min(int(parts[0].sum()), int(parts[1].sum())), 1)


def saved_parts(
    building: SavedMap, parts: tuple[Array, Array], resolutions_m: tuple[float, float], random: np.random.Generator
) -> Cut:
    """The two parts as runs of their own saved them."""
    drawn = [_run(building, floor, res, random, which) for which, floor, res in
             zip("ab", parts, resolutions_m, strict=True)]  # fmt: skip
    (target, in_target), (source, in_source) = drawn
    res = building.resolution_m
    bare = tuple(SavedMap(building.name, floor, building.walls & _beside(floor, res), res) for floor in parts)
    return Cut(target, source, compose(in_target, inverse(in_source)), overlap_of(parts), bare)


def twice(wing: SavedMap, floor: Array) -> tuple[SavedMap, Array]:
    """A building that holds the same wing twice, side by side, and its floor."""
    rows, columns = np.nonzero(floor)
    margin = round(REACH_M / wing.resolution_m) + 1
    box = (slice(max(rows.min() - margin, 0), rows.max() + margin + 1),
           slice(max(columns.min() - margin, 0), columns.max() + margin + 1))  # fmt: skip
    free, walls = floor[box], (wing.walls & _beside(floor, wing.resolution_m))[box]
    return SavedMap(f"{wing.name} twice", np.hstack([free, free]), np.hstack([walls, walls]), wing.resolution_m), (
        np.hstack([free, free])
    )


def _across(floor: Array, angle: float) -> Array:
    """(rows, columns) position of each cell along a direction, in cells."""
    row, column = np.indices(floor.shape)
    return np.asarray(np.cos(angle) * column + np.sin(angle) * row)


def _beside(floor: Array, resolution_m: float) -> Array:
    return np.asarray(ndimage.distance_transform_edt(~floor) * resolution_m <= REACH_M)


def _run(
    building: SavedMap, floor: Array, resolution_m: float, random: np.random.Generator, which: str
) -> tuple[SavedMap, Array]:
    """A part as a run saves it, and the pose (3,) of the building's grid in the run's map frame."""
    res = building.resolution_m
    walls = building.walls & _beside(floor, res)
    known = (np.argwhere(floor | walls)[:, ::-1] + 0.5) * res
    turn = random.uniform(-np.pi, np.pi)
    c, s = np.cos(turn), np.sin(turn)
    low = (known @ np.array([[c, s], [-s, c]])).min(axis=0) - 1.0
    size = (known @ np.array([[c, s], [-s, c]])).max(axis=0) + 1.0 - low
    columns, rows = np.ceil(size / resolution_m).astype(int)
    centres = (np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) + 0.5) * resolution_m + low
    there = centres @ np.array([[c, -s], [s, c]])  # turned back
    there = there + _bend((rows, columns), resolution_m, random)
    rough = there + random.normal(0.0, ROUGH_M, there.shape)
    its_floor, its_walls = _looked_up(floor, there, res), _looked_up(walls, rough, res)
    in_grid = align_rigidly(there[its_floor], (centres - low)[its_floor])  # pose of the building's grid in the run's
    its_walls &= random.random(its_walls.shape) >= HOLES
    its_floor &= ~its_walls
    for _ in range(random.poisson(THINGS_PER_M2 * floor.sum() * res**2)):
        row, column = np.argwhere(its_floor)[random.integers(its_floor.sum())]
        reach = 0.5 * random.uniform(*THING_M) / resolution_m
        y, x = np.ogrid[:rows, :columns]
        thing = np.hypot(y - row, x - column) <= reach
        its_walls |= thing & its_floor
        its_floor &= ~thing
    origin = np.array([*random.uniform(-20.0, 20.0, 2), random.choice([0.0, random.uniform(-np.pi, np.pi)])])
    saved = SavedMap(f"{building.name} {which}", its_floor, its_walls, resolution_m, origin)
    return saved, compose(origin, in_grid)


def _bend(shape: tuple[int, int], resolution_m: float, random: np.random.Generator) -> Array:
    """(rows, columns, 2) smooth displacement [m]."""
    step = max(1, round(BEND_LENGTH_M / resolution_m / 2))
    out = np.empty((*shape, 2))
    for axis in range(2):
        coarse = random.normal(size=(shape[0] // step + 4, shape[1] // step + 4))
        fine = ndimage.zoom(ndimage.gaussian_filter(coarse, 1.0), step, order=1)[: shape[0], : shape[1]]
        out[..., axis] = BEND_M * fine / max(float(fine.std()), 1e-9)
    return out


def _looked_up(mask: Array, points: Array, resolution_m: float) -> Array:
    column, row = np.moveaxis(np.floor(points / resolution_m).astype(np.int64), -1, 0)
    is_inside = (row >= 0) & (row < mask.shape[0]) & (column >= 0) & (column < mask.shape[1])
    return np.asarray(is_inside & mask[np.clip(row, 0, mask.shape[0] - 1), np.clip(column, 0, mask.shape[1] - 1)])
