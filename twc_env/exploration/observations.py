"""What an agent sees: a function of sensor frames and estimates alone. No truth is among its arguments."""

from __future__ import annotations

import math

import numpy as np
from gymnasium import spaces
from numba import njit
from numpy.typing import NDArray

from twc_env.config import EnvConfig
from twc_env.geometry import between
from twc_env.messages import Belief, SensorFrame, WifiScan

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
        self._beams, self._per_metre = config.lidar.beam_count, 1.0 / config.lidar.range_max_m
        self._map_shape = (3, config.observation.map_cells, config.observation.map_cells)
        self._sign_shape, self._team_shape = (config.observation.sign_slots, 3), (max(config.robots - 1, 1), 4)
        self._known_macs = np.zeros(0, np.int64)
        """Ascending."""
        self._slot_of_known = np.zeros(0, np.int64)
        self._wifi = np.zeros(config.observation.wifi_slots, np.float32)

    def build(self, frame: SensorFrame, belief: Belief) -> dict[str, Array]:
        """The observation after one frame."""
        mates = {mate: between(belief.pose_map_robot, pose).tolist() for mate, pose in belief.mates.items()}
        lidar, pose = np.empty(self._beams, np.float32), np.empty(4, np.float32)
        _fill(frame.ranges_m, self._per_metre, *belief.pose_map_robot.tolist(), lidar, pose)
        return {
            "lidar": lidar,
            "map": self._map(belief, mates),
            "pose": pose,
            "wifi": self._update_wifi(frame),
            "signs": self._signs(frame),
            "team": self._team(mates),
        }

    def _map(self, belief: Belief, mates: dict[int, list[float]]) -> Array:
        crop = np.zeros(self._map_shape, np.uint8)
        grid, pose, shape = belief.grid, belief.pose_map_robot, self._config.observation
        if grid.log_odds.size == 0:
            return crop
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
        if scan is not None and not self._place(scan):
            self._learn(scan.macs, scan.rssi_dbm)
            self._place(scan)
        return self._wifi.copy()

    def _place(self, scan: WifiScan) -> bool:
        return _place(scan.macs, scan.rssi_dbm, self._known_macs, self._slot_of_known, self._wifi)

    def _learn(self, macs: Array, rssi_dbm: Array) -> None:
        """Give each new transmitter the next slot, the strongest first."""
        known = self._known_macs
        new = np.setdiff1d(macs, known, assume_unique=True)
        strongest_first = new[np.argsort(-rssi_dbm[np.searchsorted(macs, new)], kind="stable")]
        merged = np.concatenate([known, strongest_first])
        slots = np.concatenate([self._slot_of_known, len(known) + np.arange(len(new))])
        order = np.argsort(merged)
        self._known_macs, self._slot_of_known = merged[order], slots[order]

    def _signs(self, frame: SensorFrame) -> Array:
        rows = np.zeros(self._sign_shape, np.float32)
        if not frame.signs:
            return rows
        nearest = sorted(frame.signs, key=lambda s: s.range_m)[: len(rows)]
        for row, sign in zip(rows, nearest, strict=False):
            row[:] = 1.0, sign.bearing_rad / math.pi, min(max(sign.range_m / self._config.signs.range_max_m, 0.0), 1.0)
        return rows

    def _team(self, mates: dict[int, list[float]]) -> Array:
        rows = np.zeros(self._team_shape, np.float32)
        for mate, (x, y, heading) in mates.items():
            distance = math.hypot(x, y)
            row = mate if mate < self._robot else mate - 1
            rows[row] = 1.0, math.atan2(y, x) / math.pi, distance / (distance + 10.0), heading / math.pi
        return rows


@njit(cache=True, error_model="numpy")
def _fill(ranges, per_metre, x, y, heading, lidar, pose):
    """The blocks `lidar` and `pose`."""
    for b in range(min(ranges.shape[0], lidar.shape[0])):
        lidar[b] = min(max(ranges[b] * per_metre, 0.0), 1.0)
    pose[0] = min(max(x, -POSE_LIMIT_M), POSE_LIMIT_M)
    pose[1] = min(max(y, -POSE_LIMIT_M), POSE_LIMIT_M)
    pose[2], pose[3] = math.cos(heading), math.sin(heading)


@njit(cache=True, error_model="numpy")
def _place(macs, rssi_dbm, known_macs, slot_of_known, wifi):
    """Strengths into the slots of their transmitters; both lists of addresses ascend. False when one is not known."""
    wifi[:] = 0.0
    k = 0
    for t in range(macs.shape[0]):
        while k < known_macs.shape[0] and known_macs[k] < macs[t]:
            k += 1
        if k == known_macs.shape[0] or known_macs[k] != macs[t]:
            return False
        slot = slot_of_known[k]
        if slot < wifi.shape[0]:
            wifi[slot] = min(max((rssi_dbm[t] - RSSI_ZERO_DBM) / RSSI_SPAN_DB, 0.0), 1.0)
    return True


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
