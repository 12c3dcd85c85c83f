"""What an agent sees: a function of sensor frames and estimates alone. No truth is among its arguments."""

from __future__ import annotations

import math
from collections import Counter
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from gymnasium import spaces
from numba import njit
from numpy.typing import NDArray

from twc_env.config import EnvConfig
from twc_env.exploration import map_view
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
    if config.slam.k_visibility.enabled:
        wanted["radio"] = spaces.Box(0, 255, (2, shape.map_cells, shape.map_cells), np.uint8)
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


class _Seen(NamedTuple):
    """What the blocks of one observation are made of."""

    frame: SensorFrame
    belief: Belief
    candidates: Candidates
    mask: Array | None


class ObservationBuilder:
    """Builds one robot's observations; remembers its WiFi slots, its path and recent readings."""

    def __init__(self, config: EnvConfig, robot: int):
        self._config = config
        self._robot, self._robots = robot, config.robots
        made = {
            "map": self._map,
            "overview": self._whole_map,
            "frontiers": self._frontiers,
            "radio": self._radio,
            "action_mask": self._mask,
        }
        self._makers = [(name, made.get(name)) for name in block_spaces(config)]
        """Blocks in order; what makes them, but for the small ones, which are all made at once."""
        self._is_flat = config.observation.kind != "dict"
        self._beams, self._per_metre = config.lidar.beam_count, 1.0 / config.lidar.range_max_m
        self._slots_of_wifi = WifiSlots(config.observation.wifi_slots)
        self._texts: list[str] = []
        """Of the latest readings, newest first."""
        self._readings = np.zeros((config.observation.sign_slots, 4))
        """Of each: time, x and y in the odom frame, and in how many other places the text is known."""
        self._path_odom = np.zeros((max(1, round(config.observation.path_m / PATH_SPACING_M)), 2))
        self._path_count, self._path_end = 0, (math.inf, math.inf)
        self._overview: tuple[tuple[int, int], tuple[Array, Array, float]] | None = None
        self._time_step_s, self._memory_s = config.dynamics.time_step_s, config.observation.sign_memory_s
        mates = max(self._robots - 1, 1)
        self._contact_steps, self._mate_rows = np.full(mates, -1), np.zeros(mates, np.int64)
        self._mates = np.zeros((mates, 3))
        """Scratch: when each mate was last heard of; row and pose, in this robot's frame, of each mate of the group."""
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
            self._readings[1:] = self._readings[:-1].copy()
            self._readings[0, :3] = frame.time_s, x + away * math.cos(angle), y + away * math.sin(angle)
            self._texts = [sign.text, *self._texts[: len(self._readings) - 1]]
        self._count_elsewhere()

    def build(
        self, frame: SensorFrame, belief: Belief, candidates: Candidates = NOTHING, mask: Array | None = None
    ) -> dict[str, Array] | Array:
        """The observation after one frame, which `notice` must have seen."""
        if belief.signs is not self._indexed_signs:
            self._index_signs(belief.signs)
        small = self._small_blocks(frame, belief)
        seen = _Seen(frame, belief, candidates, mask)
        blocks = {name: small[name] if make is None else make(seen) for name, make in self._makers}
        return _joined(blocks) if self._is_flat else blocks

    def _small_blocks(self, frame: SensorFrame, belief: Belief) -> dict[str, Array]:
        """Those that one compiled call fills; it also turns the mates' poses into this robot's frame."""
        lidar, pose = np.empty(self._beams, np.float32), np.empty(len(POSE_LIMITS), np.float32)
        signs = np.zeros((len(self._readings), 5), np.float32)
        team = np.zeros((len(self._mates), 5), np.float32)
        robot, steps, rows = self._robot, self._contact_steps, self._mate_rows
        for mate, step in belief.contact_steps.items():
            steps[mate if mate < robot else mate - 1] = step
        for k, (mate, pose_map_mate) in enumerate(belief.mates.items()):
            rows[k] = mate if mate < robot else mate - 1
            self._mates[k] = pose_map_mate
        _fill_small(
            frame.ranges_m, self._per_metre, lidar, belief.pose_map_robot, belief.pose_std, belief.since_closure_m,
            POSE_LIMITS, pose, self._readings, len(self._texts), frame.time_s, self._memory_s, belief.pose_odom, signs,
            frame.step, self._time_step_s, steps, len(belief.contact_steps), rows, self._mates, len(belief.mates), team,
        )  # fmt: skip
        return {"lidar": lidar, "pose": pose, "wifi": self._slots_of_wifi.levels.copy(), "signs": signs, "team": team}

    def _frontiers(self, seen: _Seen) -> Array:
        return features_of(seen.candidates, seen.belief.pose_map_robot, self._config.action.frontier_slots)

    def _mask(self, seen: _Seen) -> Array:
        return np.zeros(0, np.int8) if seen.mask is None else seen.mask.copy()

    def _map(self, seen: _Seen) -> Array:
        shape, belief = self._config.observation, seen.belief
        return map_view.view(
            belief, shape.map_cells, shape.map_cell_m, self._path_odom, self._path_count, self._mates,
            self._sign_places,
        )  # fmt: skip

    def _radio(self, seen: _Seen) -> Array:
        """Probably free, probably wall around the robot, from signal strength alone."""
        shape, belief = self._config.observation, seen.belief
        if belief.radio_map is None:
            return np.zeros((2, shape.map_cells, shape.map_cells), np.uint8)
        return map_view.crop_around(belief.radio_map, belief.pose_map_robot, shape.map_cells, shape.map_cell_m)[:2]

    def _index_signs(self, signs: tuple[KnownSign, ...]) -> None:
        """Places (k, 2) and how often each text is known."""
        self._indexed_signs = signs
        self._sign_places, self._text_counts = _index_of(signs)
        self._count_elsewhere()

    def _count_elsewhere(self) -> None:
        for row, text in enumerate(self._texts):
            self._readings[row, 3] = max(self._text_counts[text] - 1, 0)

    def _whole_map(self, seen: _Seen) -> Array:
        belief, cells = seen.belief, self._config.observation.overview_cells
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
        x, y, _ = pose_odom.tolist()
        if math.hypot(x - self._path_end[0], y - self._path_end[1]) >= PATH_SPACING_M:
            self._path_odom[self._path_count % len(self._path_odom)] = self._path_end = x, y
            self._path_count += 1


@lru_cache(maxsize=4)
def _index_of(signs: tuple[KnownSign, ...]) -> tuple[Array, Counter[str]]:
    """Places (k, 2) and how often each text is known; robots of one group share the list of signs."""
    return np.array([sign.position_m for sign in signs]).reshape(-1, 2), Counter([sign.text for sign in signs])


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
def _fill_signs(readings, count, now_s, memory_s, pose, rows):
    """The block `signs`: readings (slots, 4), newest first, that are not older than the memory."""
    for k in range(min(count, rows.shape[0])):
        age_s = now_s - readings[k, 0]
        if age_s > memory_s + 1e-9:
            return
        dx, dy, elsewhere = readings[k, 1] - pose[0], readings[k, 2] - pose[1], readings[k, 3]
        bearing = (math.atan2(dy, dx) - pose[2] + math.pi) % (2.0 * math.pi) - math.pi
        away = math.sqrt(dx * dx + dy * dy)
        rows[k, 0], rows[k, 1] = 1.0, bearing / math.pi
        rows[k, 2] = away / (away + HALF_WAY_M)
        rows[k, 3] = min(age_s / max(memory_s, 1e-9), 1.0)
        rows[k, 4] = elsewhere / (elsewhere + HALF_COUNT)


@njit(cache=True, error_model="numpy")
def _as_seen_from(pose, others, count):
    """`geometry.between` of a pose and each of the first of the others, written over these."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for k in range(count):
        dx, dy, turn = others[k, 0] - pose[0], others[k, 1] - pose[1], others[k, 2] - pose[2]
        others[k, 0], others[k, 1] = c * dx + s * dy, c * dy - s * dx
        others[k, 2] = (turn + math.pi) % (2.0 * math.pi) - math.pi


@njit(cache=True, error_model="numpy")
def _fill_team(now, time_step_s, contact_steps, contact_count, mate_rows, mates, mate_count, rows):
    """The block `team`: the step in which each mate was last heard of; rows and poses of those of the same map."""
    for row in range(contact_count):
        step = contact_steps[row]
        age_s = (now - step) * time_step_s
        rows[row, 4] = 1.0 if step < 0 else age_s / (age_s + HALF_AGE_S)
    for k in range(mate_count):
        row = rows[mate_rows[k]]
        away = math.sqrt(mates[k, 0] * mates[k, 0] + mates[k, 1] * mates[k, 1])
        row[0], row[1] = 1.0, math.atan2(mates[k, 1], mates[k, 0]) / math.pi
        row[2], row[3] = away / (away + HALF_WAY_M), mates[k, 2] / math.pi


@njit(cache=True, error_model="numpy")
def _fill_small(
    ranges, per_metre, lidar, pose_map, pose_std, since_m, limits, pose, readings, reading_count, now_s, memory_s,
    pose_odom, signs, step, time_step_s, contact_steps, contact_count, mate_rows, mates, mate_count, team,
):  # fmt: skip
    """The blocks `lidar`, `pose`, `signs` and `team`; mates (m, 3) come in the map frame and leave in the robot's."""
    _shares(ranges, per_metre, lidar)
    _fill_pose(pose_map, pose_std, since_m, limits, pose)
    _fill_signs(readings, reading_count, now_s, memory_s, pose_odom, signs)
    _as_seen_from(pose_map, mates, mate_count)
    _fill_team(step, time_step_s, contact_steps, contact_count, mate_rows, mates, mate_count, team)


@njit(cache=True, error_model="numpy")
def _place(macs, rssi_dbm, scan, slot_macs, last_scan, levels):
    """The strongest transmitters take, or keep, the slots. Those longest out of the strongest give way."""
    slots, heard = slot_macs.shape[0], rssi_dbm.shape[0]
    strongest = np.empty(slots, np.int64)
    count = 0
    for k in range(heard):  # inserted in falling order; of equals, the first stays ahead
        at = count
        while at > 0 and rssi_dbm[strongest[at - 1]] < rssi_dbm[k]:
            at -= 1
        if at < slots:
            count = min(count + 1, slots)
            for i in range(count - 1, at, -1):
                strongest[i] = strongest[i - 1]
            strongest[at] = k
    is_new = np.ones(slots, np.bool_)
    for k in range(count):
        for slot in range(slots):
            if slot_macs[slot] == macs[strongest[k]]:
                is_new[k] = False
                last_scan[slot] = scan
    for k in range(count):
        if is_new[k]:
            oldest = 0
            for slot in range(1, slots):
                if last_scan[slot] < last_scan[oldest]:
                    oldest = slot
            slot_macs[oldest], last_scan[oldest] = macs[strongest[k]], scan
    for slot in range(slots):
        levels[slot] = 0.0
        for k in range(heard):
            if macs[k] == slot_macs[slot]:
                levels[slot] = min(max((rssi_dbm[k] - RSSI_ZERO_DBM) / RSSI_SPAN_DB, 0.0), 1.0)
                break
