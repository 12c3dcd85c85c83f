"""The settings of each robot of a team, and those that a mixed team shares."""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from typing import Any

from twc_env.config.environment import EnvConfig
from twc_env.config.robots import ROBOT_SETTINGS, Overrides, sections_with
from twc_env.config.world import CIRCLE_BEAMS_MAX, LidarConfig

_FILTER = "slam.odometry_filter."


@lru_cache(maxsize=64)
def robot_configs(config: EnvConfig) -> tuple[EnvConfig, ...]:
    """The settings of each robot: those of the team with its own instead. Robots with equal settings share them."""
    known: dict[Any, EnvConfig] = {}
    own = []
    for number, overrides in enumerate(config.robot or ((),) * config.robots):
        if overrides not in known:
            known[overrides] = _of_robot(config, number, overrides)
        own.append(known[overrides])
    equal: dict[EnvConfig, EnvConfig] = {}
    return tuple(equal.setdefault(each, each) for each in own)


def _of_robot(config: EnvConfig, number: int, overrides: Overrides) -> EnvConfig:
    if not config.robot:
        return config
    return dataclasses.replace(config, robot=(), **sections_with(config, number, overrides))


def start_times_s(config: EnvConfig) -> tuple[float, ...]:
    """When each robot is switched on [s]."""
    gap_s = config.failure.start_spread_s / max(config.robots - 1, 1)
    return tuple(number * gap_s + own.failure.start_s for number, own in enumerate(robot_configs(config)))


def has_one_scanner(config: EnvConfig) -> bool:
    """Whether the scanners of all robots are alike."""
    return len({own.lidar for own in robot_configs(config)}) == 1


@lru_cache(maxsize=64)
def shared_config(config: EnvConfig) -> EnvConfig:
    """The settings in which a mixed team shares one map: scans on circles that hold those of the best scanner.

    Of what is each robot's own, only sizes and the assumed noise of odometry are left, which the engine is told.
    """
    if not config.robot:
        return config
    robots = robot_configs(config)
    scanners = [own.lidar for own in robots]
    lidar = scanners[0]
    if not has_one_scanner(config):
        lidar = LidarConfig(
            beam_count=min(max(each.circle_beam_count for each in scanners), CIRCLE_BEAMS_MAX),
            range_max_m=max(each.range_max_m for each in scanners),
            range_noise_std_m=max(each.range_noise_std_m for each in scanners),
            range_noise_per_m=max(each.range_noise_per_m for each in scanners),
            dropout_probability=max(each.dropout_probability for each in scanners),
        )
    radii_m = [own.dynamics.robot_radius_m for own in robots]
    dynamics = dataclasses.replace(robots[0].dynamics, robot_radius_m=max(radii_m))
    filters = [own.slam.odometry_filter for own in robots]
    slam = dataclasses.replace(config.slam, odometry_filter=filters[0])
    own_ones: tuple[Overrides, ...] = ()
    if len(set(radii_m)) > 1 or len(set(filters)) > 1:
        names = [name.removeprefix(_FILTER) for name in ROBOT_SETTINGS if name.startswith(_FILTER)]
        own_ones = tuple(
            (("dynamics.robot_radius_m", radius_m), *((f"{_FILTER}{k}", getattr(own, k)) for k in names))
            for radius_m, own in zip(radii_m, filters, strict=True)
        )
    return dataclasses.replace(config, lidar=lidar, dynamics=dynamics, slam=slam, robot=own_ones)
