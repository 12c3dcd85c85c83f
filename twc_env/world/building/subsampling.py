"""Harder variants of a building: fewer signs, repeated sign texts, fewer access points."""

from __future__ import annotations

import dataclasses

import numpy as np

from twc_env.config import BuildingConfig
from twc_env.records.random_streams import random_stream
from twc_env.world.building.floorplan import AccessPoint, Floorplan, Sign

DUPLICATES = 4
"""Approximate number of signs per repeated text."""


def subsampled(plan: Floorplan, config: BuildingConfig) -> Floorplan:
    """The plan with the shares of signs and access points in `config`; the plan itself for the default config.

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
