"""The blocks of an observation: which a config enables, their shapes and ranges."""

from __future__ import annotations

import math

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, robot_configs
from twc_env.exploration.observation import map_view

POSE_LIMITS = np.array([1000.0, 1000.0, 1.0, 1.0, 100.0, 100.0, math.pi, 10_000.0], np.float32)
POSE_LOWEST = POSE_LIMITS * np.array([-1, -1, -1, -1, 0, 0, 0, 0], np.float32)
EXTRA_CHOICES = ("sign", "teammate", "stay")
"""Choices that follow the frontiers in the action space, in this order."""


def beams_shown(config: EnvConfig) -> tuple[int, ...]:
    """(robots,) length of the block `lidar` of each robot."""
    beams = [own.lidar.beam_count for own in robot_configs(config)]
    return (max(beams),) * len(beams) if config.observation.equal_shapes else tuple(beams)


def block_spaces(config: EnvConfig, robot: int = 0) -> dict[str, spaces.Space]:
    """Spaces of the blocks that the config enables for a robot, in the order of the observation."""
    shape, teammates = config.observation, max(config.robots - 1, 1)
    chooses = config.action.kind == "frontier"
    slots = config.action.frontier_slots
    blocks: dict[str, spaces.Space] = {
        "lidar": spaces.Box(0.0, 1.0, (beams_shown(config)[robot],), np.float32),
        "map": spaces.Box(0, 255, (map_view.CHANNELS, shape.map_cells, shape.map_cells), np.uint8),
        "overview": spaces.Box(
            0, 255, (map_view.OVERVIEW_CHANNELS, shape.overview_cells, shape.overview_cells), np.uint8
        ),
        "pose": spaces.Box(POSE_LOWEST, POSE_LIMITS, dtype=np.float32),
        "wifi": spaces.Box(0.0, 1.0, (shape.wifi_slots,), np.float32),
        "signs": spaces.Box(-1.0, 1.0, (shape.sign_slots, 5), np.float32),
        "team": spaces.Box(-1.0, 1.0, (teammates, 5), np.float32),
        "frontiers": spaces.Box(-1.0, 1.0, (slots, 6), np.float32),
        "gains": spaces.Box(0.0, 1.0, (slots,), np.float32),
        "other_maps": spaces.Box(0.0, 1.0, (slots,), np.float32),
        "time_left": spaces.Box(0.0, 1.0, (1,), np.float32),
    }
    wanted = {
        name: space for name, space in blocks.items() if getattr(shape, name) or (chooses and name == "frontiers")
    }
    if "frontiers" not in wanted:
        wanted.pop("gains", None)
        wanted.pop("other_maps", None)
    if config.slam.k_visibility.enabled:
        wanted["radio"] = spaces.Box(0, 255, (2, shape.map_cells, shape.map_cells), np.uint8)
    if chooses:
        wanted["action_mask"] = spaces.Box(0, 1, (slots + len(EXTRA_CHOICES),), np.int8)
    return wanted


def observation_space(config: EnvConfig, robot: int = 0) -> spaces.Dict | spaces.Box:
    """The space of one robot's observation; see `ExplorationEnv` for the meaning of each block."""
    blocks = block_spaces(config, robot)
    if config.observation.kind == "dict":
        return spaces.Dict(blocks)
    low, high = (joined({name: getattr(space, end) for name, space in blocks.items()}) for end in ("low", "high"))
    return spaces.Box(low, high, dtype=np.float32)


def joined(blocks: dict[str, Array]) -> Array:
    """All blocks concatenated to one float32 vector, images scaled to [0, 1]."""
    parts = [np.ravel(b) / np.float32(255.0) if b.dtype == np.uint8 else np.ravel(b) for b in blocks.values()]
    return np.concatenate(parts).astype(np.float32) if parts else np.zeros(0, np.float32)
