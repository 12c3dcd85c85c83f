"""What an agent sees: a function of sensor frames and estimates alone. No truth is among its arguments."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from gymnasium import spaces
from numba import njit
from numpy.typing import NDArray

from twc_env.config import EnvConfig
from twc_env.exploration import map_view
from twc_env.geometry import between
from twc_env.messages import Belief, KnownSign, SensorFrame
from twc_env.planning.candidates import NOTHING, Candidates, features_of

Array = NDArray

RSSI_ZERO_DBM, RSSI_SPAN_DB = -100.0, 80.0
POSE_LIMITS = np.array([1000.0, 1000.0, 1.0, 1.0, 100.0, 100.0, math.pi, 10_000.0], np.float32)
POSE_LOWEST = POSE_LIMITS * np.array([-1, -1, -1, -1, 0, 0, 0, 0], np.float32)
HALF_WAY_M = 10.0
"""Distances d are shown as d / (d + this)."""
HALF_AGE_S = 10.0
HALF_COUNT = 2.0
PATH_SPACING_M = 0.2
OVERVIEW_PERIOD_STEPS = 10
ORIGIN = np.zeros(3)
EXTRA_CHOICES = ("sign", "mate", "stay")
"""What the choice among frontiers offers besides frontiers, in this order."""


def block_spaces(config: EnvConfig) -> dict[str, spaces.Space]:
    """The blocks that the config asks for, in order."""
    shape, mates = config.observation, max(config.robots - 1, 1)
    chooses = config.action.kind == "frontier"
    slots = config.action.frontier_slots
    blocks: dict[str, spaces.Space] = {
        "lidar": spaces.Box(0.0, 1.0, (config.lidar.beam_count,), np.float32),
        "map": spaces.Box(0, 255, (map_view.CHANNELS, shape.map_cells, shape.map_cells), np.uint8),
        "overview": spaces.Box(
            0, 255, (map_view.OVERVIEW_CHANNELS, shape.overview_cells, shape.overview_cells), np.uint8
        ),
        "pose": spaces.Box(POSE_LOWEST, POSE_LIMITS, dtype=np.float32),
        "wifi": spaces.Box(0.0, 1.0, (shape.wifi_slots,), np.float32),
        "signs": spaces.Box(-1.0, 1.0, (shape.sign_slots, 5), np.float32),
        "team": spaces.Box(-1.0, 1.0, (mates, 5), np.float32),
        "frontiers": spaces.Box(-1.0, 1.0, (slots, 6), np.float32),
    }
    wanted = {
        name: space for name, space in blocks.items() if getattr(shape, name) or (chooses and name == "frontiers")
    }
    if chooses:
        wanted["action_mask"] = spaces.Box(0, 1, (slots + len(EXTRA_CHOICES),), np.int8)
    return wanted


def observation_space(config: EnvConfig) -> spaces.Dict | spaces.Box:
    """The space of one agent's observation; see `ExplorationEnv` for the meaning of each block."""
    blocks = block_spaces(config)
    if config.observation.kind == "dict":
        return spaces.Dict(blocks)
    low, high = (_joined({name: getattr(space, end) for name, space in blocks.items()}) for end in ("low", "high"))
    return spaces.Box(low, high, dtype=np.float32)


def _joined(blocks: dict[str, Array]) -> Array:
    """All blocks in one vector of float32, pictures scaled to [0, 1]."""
    parts = [np.ravel(b) / np.float32(255.0) if b.dtype == np.uint8 else np.ravel(b) for b in blocks.values()]
    return np.concatenate(parts).astype(np.float32) if parts else np.zeros(0, np.float32)


class ObservationBuilder:
    """Builds one robot's observations; remembers its WiFi slots, its path and recent readings."""

    def __init__(self, config: EnvConfig, robot: int):
        self._config = config
        self._robot, self._robots = robot, config.robots
        self._names = tuple(block_spaces(config))
        self._slots_of_wifi = WifiSlots(config.observation.wifi_slots)
        self._readings: list[tuple[float, str, float, float]] = []
        """Time, text, and x and y in the odom frame, newest last."""
        self._path_odom = np.zeros((max(1, round(config.observation.path_m / PATH_SPACING_M)), 2))
        self._path_count = 0
        self._overview: tuple[tuple[int, int], tuple[Array, Array, float]] | None = None
        self._indexed_signs: tuple[KnownSign, ...] = ()
        self._sign_places = np.zeros((0, 2))
        self._text_counts: Counter[str] = Counter()

    def notice(self, frame: SensorFrame, belief: Belief) -> None:
        """Take in one frame that no observation is built of: path, radio and readings are kept up."""
        self._slots_of_wifi.update(frame)
        self._extend_path(belief.pose_odom)
        if not frame.signs:
            return
        x, y, heading = belief.pose_odom.tolist()
        for sign in frame.signs:
            angle, away = heading + sign.bearing_rad, sign.range_m
            place = x + away * math.cos(angle), y + away * math.sin(angle)
            self._readings.append((frame.time_s, sign.text, *place))

    def build(
        self, frame: SensorFrame, belief: Belief, candidates: Candidates = NOTHING, mask: Array | None = None
    ) -> dict[str, Array] | Array:
        """The observation after one frame, which `notice` must have seen."""
        mates = {mate: between(belief.pose_map_robot, pose).tolist() for mate, pose in belief.mates.items()}
        blocks: dict[str, Array] = {}
        for name in self._names:
            if name == "lidar":
                blocks[name] = np.empty(self._config.lidar.beam_count, np.float32)
                _shares(frame.ranges_m, 1.0 / self._config.lidar.range_max_m, blocks[name])
            elif name == "map":
                blocks[name] = self._map(belief, mates)
            elif name == "overview":
                blocks[name] = self._whole_map(belief)
            elif name == "pose":
                blocks[name] = _pose(belief)
            elif name == "wifi":
                blocks[name] = self._slots_of_wifi.levels.copy()
            elif name == "signs":
                blocks[name] = self._recent_signs(frame, belief)
            elif name == "team":
                blocks[name] = self._team(frame, belief, mates)
            elif name == "frontiers":
                blocks[name] = features_of(candidates, belief.pose_map_robot, self._config.action.frontier_slots)
            else:
                blocks[name] = np.zeros(0, np.int8) if mask is None else mask.copy()
        return blocks if self._config.observation.kind == "dict" else _joined(blocks)

    def _map(self, belief: Belief, mates: dict[int, list[float]]) -> Array:
        shape = self._config.observation
        crop = map_view.crop_around(belief.grid, belief.pose_map_robot, shape.map_cells, shape.map_cell_m)
        path = self._path_odom[: min(self._path_count, len(self._path_odom))]
        map_view.mark(crop[map_view.PATH], path, belief.pose_odom, shape.map_cell_m)
        if mates:
            places = np.array([place[:2] for place in mates.values()])
            map_view.mark(crop[map_view.MATES], places, ORIGIN, shape.map_cell_m)
        if belief.signs:
            self._index_signs(belief.signs)
            map_view.mark(crop[map_view.SIGNS], self._sign_places, belief.pose_map_robot, shape.map_cell_m)
        return crop

    def _index_signs(self, signs: tuple[KnownSign, ...]) -> None:
        """Places (k, 2) and how often each text is known, made anew only when the list changed."""
        if self._indexed_signs is not signs:
            self._indexed_signs = signs
            self._sign_places = np.array([sign.position_m for sign in signs])
            self._text_counts = Counter(sign.text for sign in signs)

    def _whole_map(self, belief: Belief) -> Array:
        cells = self._config.observation.overview_cells
        key = (belief.step // OVERVIEW_PERIOD_STEPS, belief.map_version)
        if self._overview is None or self._overview[0] != key:
            self._overview = (key, map_view.shrink(belief.grid, cells))
        picture, corner_m, cell_m = self._overview[1]
        out = np.zeros((map_view.OVERVIEW_CHANNELS, cells, cells), np.uint8)
        out[:2] = picture
        for channel, pose in [(2, belief.pose_map_robot), *((3, pose) for pose in belief.mates.values())]:
            column, row = (math.floor(v) for v in (pose[:2] - corner_m) / cell_m)
            if 0 <= row < cells and 0 <= column < cells:
                out[channel, row, column] = 255
        return out

    def _extend_path(self, pose_odom: Array) -> None:
        x, y = float(pose_odom[0]), float(pose_odom[1])
        last = self._path_odom[(self._path_count - 1) % len(self._path_odom)]
        if self._path_count == 0 or math.hypot(x - last[0], y - last[1]) >= PATH_SPACING_M:
            self._path_odom[self._path_count % len(self._path_odom)] = x, y
            self._path_count += 1

    def _recent_signs(self, frame: SensorFrame, belief: Belief) -> Array:
        shape = self._config.observation
        rows = np.zeros((shape.sign_slots, 5), np.float32)
        if not self._readings:
            return rows
        oldest_s = frame.time_s - shape.sign_memory_s - 1e-9
        self._readings = [reading for reading in self._readings if reading[0] >= oldest_s][-shape.sign_slots :]
        self._index_signs(belief.signs)
        robot_x, robot_y, heading = belief.pose_odom.tolist()
        memory_s, values = max(shape.sign_memory_s, 1e-9), []
        for time_s, text, x, y in reversed(self._readings):
            away = math.hypot(x - robot_x, y - robot_y)
            bearing = math.remainder(math.atan2(y - robot_y, x - robot_x) - heading, 2 * math.pi)
            elsewhere = max(self._text_counts[text] - 1, 0)
            age = min((frame.time_s - time_s) / memory_s, 1.0)
            values.append(
                (1.0, bearing / math.pi, away / (away + HALF_WAY_M), age, elsewhere / (elsewhere + HALF_COUNT))
            )
        if values:
            rows[: len(values)] = values
        return rows

    def _team(self, frame: SensorFrame, belief: Belief, mates: dict[int, list[float]]) -> Array:
        rows = np.zeros((max(self._robots - 1, 1), 5), np.float32)
        time_step_s = self._config.dynamics.time_step_s
        for mate, step in belief.contact_steps.items():
            row = rows[mate if mate < self._robot else mate - 1]
            age_s = (frame.step - step) * time_step_s
            row[4] = 1.0 if step < 0 else age_s / (age_s + HALF_AGE_S)
        for mate, (x, y, heading) in mates.items():
            away = math.hypot(x, y)
            row = rows[mate if mate < self._robot else mate - 1]
            row[:4] = 1.0, math.atan2(y, x) / math.pi, away / (away + HALF_WAY_M), heading / math.pi
        return rows


class WifiSlots:
    """The strongest transmitters in a fixed number of slots; each keeps its slot until a stronger one needs it."""

    def __init__(self, count: int):
        self.levels = np.zeros(count, np.float32)
        """(slots,) of the latest scan: 0 at -100 dBm or not heard, 1 at -20 dBm."""
        self._macs = np.full(count, -1, np.int64)
        self._last_scan = np.zeros(count, np.int64)
        """The scan in which each slot's transmitter was last among the strongest."""
        self._scans = 0

    def update(self, frame: SensorFrame) -> None:
        """Take in the scan of a frame, if it has one."""
        scan = frame.wifi
        if scan is None:
            return
        self._scans += 1
        _place(scan.macs, scan.rssi_dbm, self._scans, self._macs, self._last_scan, self.levels)


def _pose(belief: Belief) -> Array:
    out = np.empty(len(POSE_LIMITS), np.float32)
    _fill_pose(belief.pose_map_robot, belief.pose_std, belief.since_closure_m, POSE_LIMITS, out)
    return out


@njit(cache=True, error_model="numpy")
def _shares(ranges, per_metre, out):
    for b in range(min(ranges.shape[0], out.shape[0])):
        out[b] = min(max(ranges[b] * per_metre, 0.0), 1.0)


@njit(cache=True, error_model="numpy")
def _fill_pose(pose, std, since_m, limits, out):
    out[0], out[1] = pose[0], pose[1]
    out[2], out[3] = math.cos(pose[2]), math.sin(pose[2])
    out[4], out[5], out[6], out[7] = std[0], std[1], std[2], since_m
    for k in range(8):
        out[k] = min(max(out[k], -limits[k]), limits[k])


@njit(cache=True, error_model="numpy")
def _place(macs, rssi_dbm, scan, slot_macs, last_scan, levels):
    """The strongest transmitters take, or keep, the slots; macs ascend. Those longest out of the strongest give way."""
    slots = slot_macs.shape[0]
    order = np.argsort(-rssi_dbm, kind="mergesort")[:slots]
    is_new = np.ones(order.shape[0], np.bool_)
    for k in range(order.shape[0]):
        for slot in range(slots):
            if slot_macs[slot] == macs[order[k]]:
                is_new[k] = False
                last_scan[slot] = scan
    for k in range(order.shape[0]):
        if is_new[k]:
            oldest = np.argmin(last_scan)
            slot_macs[oldest], last_scan[oldest] = macs[order[k]], scan
    for slot in range(slots):
        place = np.searchsorted(macs, slot_macs[slot])
        levels[slot] = 0.0
        if place < macs.shape[0] and macs[place] == slot_macs[slot]:
            levels[slot] = min(max((rssi_dbm[place] - RSSI_ZERO_DBM) / RSSI_SPAN_DB, 0.0), 1.0)
