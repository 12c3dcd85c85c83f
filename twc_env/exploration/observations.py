"""What an agent sees: a function of sensor frames and estimates alone. No truth is among its arguments."""

from __future__ import annotations

import math

import numpy as np
from gymnasium import spaces
from numba import njit
from numpy.typing import NDArray

from twc_env.config import EnvConfig
from twc_env.geometry import between
from twc_env.messages import Belief, SensorFrame

Array = NDArray

RSSI_ZERO_DBM, RSSI_SPAN_DB = -100.0, 80.0
POSE_LIMIT_M = 1000.0
FIXED_BITS = 32
FIXED_POINT = 2.0**FIXED_BITS
"""Cell numbers are stepped in whole parts of a cell, so that a step is an addition and a shift, no conversion."""


def observation_space(config: EnvConfig) -> spaces.Dict:
    """The space of one agent's observation; see `ExplorationEnv` for the meaning of each block."""
    shape = config.observation
    return spaces.Dict(
        {
            "lidar": spaces.Box(0.0, 1.0, (config.lidar.beam_count,), np.float32),
            "map": spaces.Box(0, 255, (3, shape.map_cells, shape.map_cells), np.uint8),
            "pose": spaces.Box(-POSE_LIMIT_M, POSE_LIMIT_M, (4,), np.float32),
            "wifi": spaces.Box(0.0, 1.0, (shape.wifi_slots,), np.float32),
            "signs": spaces.Box(-1.0, 1.0, (shape.sign_slots, 3), np.float32),
            "team": spaces.Box(-1.0, 1.0, (max(config.robots - 1, 1), 4), np.float32),
        }
    )


class ObservationBuilder:
    """Builds one robot's observations; remembers only which transmitter has which WiFi slot."""

    def __init__(self, config: EnvConfig, robot: int):
        self._config = config
        self._robot, self._robots = robot, config.robots
        self._known_macs = np.zeros(0, np.int64)
        """Ascending."""
        self._slot_of_known = np.zeros(0, np.int64)
        self._wifi = np.zeros(config.observation.wifi_slots, np.float32)

    def build(self, frame: SensorFrame, belief: Belief) -> dict[str, Array]:
        """The observation after one frame."""
        config = self._config
        mates = {mate: between(belief.pose_map_robot, pose).tolist() for mate, pose in belief.mates.items()}
        return {
            "lidar": (frame.ranges_m / config.lidar.range_max_m).clip(0.0, 1.0).astype(np.float32),
            "map": self._map(belief, mates),
            "pose": _pose(belief),
            "wifi": self._update_wifi(frame),
            "signs": self._signs(frame),
            "team": self._team(mates),
        }

    def _map(self, belief: Belief, mates: dict[int, list[float]]) -> Array:
        shape = self._config.observation
        crop = np.zeros((3, shape.map_cells, shape.map_cells), np.uint8)
        grid, pose = belief.grid, belief.pose_map_robot
        x, y = pose[:2] - grid.origin_m
        _crop(grid.log_odds, x, y, pose[2], 1.0 / grid.resolution_m, shape.map_cell_m, crop)
        half = shape.map_cells // 2
        for x, y, _ in mates.values():
            row, column = math.floor(y / shape.map_cell_m) + half, math.floor(x / shape.map_cell_m) + half
            if 0 <= row < shape.map_cells and 0 <= column < shape.map_cells:
                crop[2, row, column] = 255
        return crop

    def _update_wifi(self, frame: SensorFrame) -> Array:
        scan = frame.wifi
        if scan is not None:
            self._wifi[:] = 0.0
            level = ((scan.rssi_dbm - RSSI_ZERO_DBM) / RSSI_SPAN_DB).clip(0.0, 1.0)
            slots = self._slots_of(scan.macs, level)
            mine = slots < len(self._wifi)
            self._wifi[slots[mine]] = level[mine]
        return self._wifi.copy()

    def _slots_of(self, macs: Array, level: Array) -> Array:
        """(heard,) slot of each transmitter; new ones get the next slots, the strongest first."""
        known = self._known_macs
        place = np.searchsorted(known, macs)
        if len(known) == 0 or not np.array_equal(known[np.minimum(place, len(known) - 1)], macs):
            new = np.setdiff1d(macs, known, assume_unique=True)
            strongest_first = new[np.argsort(-level[np.searchsorted(macs, new)], kind="stable")]
            merged = np.concatenate([known, strongest_first])
            slots = np.concatenate([self._slot_of_known, len(known) + np.arange(len(new))])
            order = np.argsort(merged)
            self._known_macs, self._slot_of_known = merged[order], slots[order]
            place = np.searchsorted(self._known_macs, macs)
        return self._slot_of_known[place]

    def _signs(self, frame: SensorFrame) -> Array:
        config = self._config
        rows = np.zeros((config.observation.sign_slots, 3), np.float32)
        nearest = sorted(frame.signs, key=lambda s: s.range_m)[: len(rows)]
        for row, sign in zip(rows, nearest, strict=False):
            row[:] = 1.0, sign.bearing_rad / math.pi, min(max(sign.range_m / config.signs.range_max_m, 0.0), 1.0)
        return rows

    def _team(self, mates: dict[int, list[float]]) -> Array:
        rows = np.zeros((max(self._robots - 1, 1), 4), np.float32)
        for mate, (x, y, heading) in mates.items():
            distance = math.hypot(x, y)
            row = mate if mate < self._robot else mate - 1
            rows[row] = 1.0, math.atan2(y, x) / math.pi, distance / (distance + 10.0), heading / math.pi
        return rows


def _pose(belief: Belief) -> Array:
    x, y, heading = belief.pose_map_robot.tolist()
    x, y = (min(max(v, -POSE_LIMIT_M), POSE_LIMIT_M) for v in (x, y))
    return np.array([x, y, math.cos(heading), math.sin(heading)], np.float32)


@njit(cache=True, error_model="numpy")
def _crop(log_odds, x, y, heading, inverse_m, cell_m, out):
    """Egocentric view, robot in the middle and looking along +column: out[0] free, out[1] wall (255 or 0).

    Each cell takes two samples on one of its diagonals, by turns, so that a thin wall hardly slips through.
    """
    height, width = log_odds.shape
    size = out.shape[1]
    step = 0.5 * cell_m * inverse_m
    c, s = math.cos(heading) * step, math.sin(heading) * step
    first = 0.5 - 2 * (size // 2)  # in samples, two to a cell
    x0 = x * inverse_m + first * (c - s)
    y0 = y * inverse_m + first * (s + c)
    cells = log_odds.reshape(-1)
    dx, dy = int(2 * c * FIXED_POINT), int(2 * s * FIXED_POINT)
    for i in range(2 * size):
        shift = (i + (i >> 1)) & 1
        gx = int(math.floor((x0 - s * i + c * shift) * FIXED_POINT))
        gy = int(math.floor((y0 + c * i + s * shift) * FIXED_POINT))
        free, wall = out[0, i >> 1], out[1, i >> 1]
        k0, k1 = gx >> FIXED_BITS, (gx + dx * (size - 1)) >> FIXED_BITS
        r0, r1 = gy >> FIXED_BITS, (gy + dy * (size - 1)) >> FIXED_BITS
        if min(k0, k1) >= 0 and min(r0, r1) >= 0 and max(k0, k1) < width and max(r0, r1) < height:
            for j in range(size):  # the whole row lies inside: no cell needs a check
                level = cells[((gy + j * dy) >> FIXED_BITS) * width + ((gx + j * dx) >> FIXED_BITS)]
                free[j] |= np.uint8(level < 0)
                wall[j] |= np.uint8(level > 0)
        else:
            for j in range(size):
                k, r = (gx + j * dx) >> FIXED_BITS, (gy + j * dy) >> FIXED_BITS
                if 0 <= r < height and 0 <= k < width:
                    level = log_odds[r, k]
                    free[j] |= np.uint8(level < 0)
                    wall[j] |= np.uint8(level > 0)
    for i in range(size):
        for j in range(size):
            is_wall = out[1, i, j]
            out[0, i, j] = (out[0, i, j] & (1 - is_wall)) * 255
            out[1, i, j] = is_wall * 255
