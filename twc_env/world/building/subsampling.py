"""Harder variants of a building: fewer signs, repeated sign texts, fewer access points, partitions of glass."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import BuildingConfig
from twc_env.records.random_streams import random_stream
from twc_env.world.building.floor_cells import rasterise
from twc_env.world.building.floorplan import AccessPoint, Floorplan, Sign

DUPLICATES = 4
"""Approximate number of signs per repeated text."""
CELL_M, BESIDE_M = 0.1, 0.3
"""Cells in which floor is looked for, and how far beside a wall."""


def subsampled(plan: Floorplan, config: BuildingConfig) -> Floorplan:
    """The plan with the shares of signs, access points and glass in `config`; the plan itself for the default config.

    The choice depends on the plan only, so it is the same in all episodes. What is left keeps its properties, such as
    the power and shadowing of the access points (`Floorplan.origin`).
    """
    if config == BuildingConfig():
        return plan
    home = plan.home
    seed = int(home.digest, 16)
    changed = dataclasses.replace(
        home,
        signs=_signs(home, config, seed),
        access_points=_access_points(home, config, seed),
        wall_materials=_materials(home, config, seed),
        subsampled_from=home.origin,
    )
    return changed.moved(plan.pose_building_home) if plan.pose_building_home.any() else changed


def _signs(plan: Floorplan, config: BuildingConfig, seed: int) -> tuple[Sign, ...]:
    random = random_stream(seed, "thinning-signs")
    order, luck = random.permutation(len(plan.signs)), random.random(len(plan.signs))
    kept = sorted(order[: round(config.sign_share * len(plan.signs))].tolist())
    signs = [plan.signs[k] for k in kept]
    repeated = np.flatnonzero(luck[kept] < config.sign_duplication)
    if len(repeated) > 1:  # the first few texts replace the others
        texts = [signs[k].text for k in repeated[: max(1, len(repeated) // DUPLICATES)]]
        for count, k in enumerate(repeated.tolist()):
            signs[k] = dataclasses.replace(signs[k], text=texts[count % len(texts)])
    return tuple(signs)


def _access_points(plan: Floorplan, config: BuildingConfig, seed: int) -> tuple[AccessPoint, ...]:
    order = random_stream(seed, "thinning-access-points").permutation(len(plan.access_points))
    kept = sorted(order[: round(config.access_point_share * len(plan.access_points))].tolist())
    return tuple(plan.access_points[k] for k in kept)


def _materials(plan: Floorplan, config: BuildingConfig, seed: int) -> tuple[str, ...]:
    if not config.glass_share:
        return plan.wall_materials
    luck = random_stream(seed, "glass").random(len(plan.walls_m))
    own = plan.wall_materials or ("",) * len(plan.walls_m)
    is_glass = (luck < config.glass_share) & _are_partitions(plan)
    return tuple("glass" if glass and not name else name for glass, name in zip(is_glass.tolist(), own, strict=True))


def _are_partitions(plan: Floorplan) -> Array:
    """(walls,) bool: whether there is floor on both sides of the middle of each wall."""
    cells = rasterise(plan.name, plan.walls_m, plan.interior_m, CELL_M)
    along = plan.walls_m[:, 1] - plan.walls_m[:, 0]
    across = np.column_stack([-along[:, 1], along[:, 0]]) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    middle_m = plan.walls_m.mean(axis=1)
    return cells.is_free(middle_m + BESIDE_M * across) & cells.is_free(middle_m - BESIDE_M * across)
