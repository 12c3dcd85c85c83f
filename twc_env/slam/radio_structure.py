"""Walls and free floor beyond what the robots have seen, from signal strength while they walk (papers.md X5, K24c).

Incremental inverse k-visibility: every reading casts one ray to its router and updates the cells on it. A router counts
as located once some robot has passed it nearly; how many walls a reading has crossed follows from its excess loss.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twc_env.config import KVisibilityConfig
from twc_env.geometry import compose, inverse, transform_points
from twc_env.kernels import kernel
from twc_env.messages import GridMap, SensorFrame

Array = NDArray

LEVELS_PER_NAT = 16.0
"""Log-odds are kept in sixteenths, as whole numbers."""
_LEVEL_MAX = 60
_WALL_DENSITY = 0.04
"""Share of cells that hold a wall, before anything is known."""
_RAY_WEIGHT = 0.25
"""Neighbouring rays say nearly the same."""
_MARGIN_M = 2.0
_PLACED_FROM = 40
"""A transmitter is placed by so many of its strongest readings, which few walls stand before."""
_POWER_STD_DB = 3.0
"""How well a transmitter's power is known before."""
_SEARCH_STEPS_M = (0.6, 0.15)
_SEARCH_REACH = 4
"""Places tried on either side of the best so far, at each step width."""


@dataclass(frozen=True, slots=True, eq=False)
class RadioPicture:
    """What the readings of some robots say, in one frame."""

    grid: GridMap
    """Probably free < 0, probably wall > 0."""
    transmitter_m: Array
    """(k, 2) where transmitters that were passed nearly are believed to stand, by rising address."""


@dataclass(slots=True, eq=False)
class _Readings:
    """What one robot heard, where its front end believed it was."""

    pose_odom: list[Array]
    macs: list[Array]
    rssi_dbm: list[Array]


class RadioStructure:
    """One robot team's readings, and the maps that they give for any set of robots in one frame."""

    def __init__(self, config: KVisibilityConfig, resolution_m: float, robots: int):
        self._config, self._resolution_m = config, resolution_m
        self._readings = [_Readings([], [], []) for _ in range(robots)]
        self._maps: dict[tuple[int, ...], tuple[tuple, RadioPicture]] = {}
        self._given: tuple[Array, Array, Array] | None = None

    def give_transmitters(self, macs: Array, position_m: Array, start_poses: Array) -> None:
        """Where transmitters stand, and in the same frame each robot's start: nothing is located any more."""
        order = np.argsort(macs)
        self._given = np.asarray(macs)[order], np.asarray(position_m, float)[order], np.asarray(start_poses, float)

    def add(self, frame: SensorFrame, pose_odom: Array) -> None:
        """Remember a frame's WiFi scan, if it holds one."""
        if frame.wifi is None or len(frame.wifi.macs) == 0:
            return
        own = self._readings[frame.robot]
        own.pose_odom.append(np.asarray(pose_odom, float).copy())
        own.macs.append(frame.wifi.macs)
        own.rssi_dbm.append(frame.wifi.rssi_dbm)

    def picture_of(self, robots: tuple[int, ...], poses_map_odom: Array, version: int) -> RadioPicture | None:
        """What the readings of these robots say, in a map frame; poses (robots, 3) lay their odom frames in it.

        Worked out anew every `period_scans` readings or when the map jumped. None before anything is heard.
        """
        count = sum(len(self._readings[r].macs) for r in robots)
        key = (version, count // self._config.period_scans)
        held = self._maps.get(robots)
        if held is not None and held[0] == key:
            return held[1]
        if not count:
            return None
        picture = self._drawn(robots, poses_map_odom)
        self._maps[robots] = (key, picture)
        return picture

    def _drawn(self, robots: tuple[int, ...], poses_map_odom: Array) -> RadioPicture:
        places, macs, levels = [], [], []
        for robot, pose in zip(robots, poses_map_odom, strict=True):
            own = self._readings[robot]
            if own.macs:
                at = compose(pose, np.array(own.pose_odom))[:, :2]
                places.append(np.repeat(at, [len(m) for m in own.macs], axis=0))
                macs.append(np.concatenate(own.macs))
                levels.append(np.concatenate(own.rssi_dbm))
        place, mac, level = np.concatenate(places), np.concatenate(macs), np.concatenate(levels)
        if self._given is None:
            routers, which = self._routers(place, mac, level)
        else:
            known, position_m, starts = self._given
            routers = transform_points(compose(poses_map_odom[0], inverse(starts[robots[0]])), position_m)
            which = np.clip(np.searchsorted(known, mac), 0, len(known) - 1)
            which = np.where(known[which] == mac, which, -1)
        low = np.floor((np.concatenate([place, routers]).min(axis=0) - _MARGIN_M) / self._resolution_m)
        high = np.ceil((np.concatenate([place, routers]).max(axis=0) + _MARGIN_M) / self._resolution_m)
        columns, rows = (high - low).astype(int).tolist()
        log_odds = np.zeros((rows, columns), np.int16)
        origin = low * self._resolution_m
        told = which >= 0
        _update_all(
            log_odds, origin, 1.0 / self._resolution_m, np.ascontiguousarray(place[told]), routers, which[told],
            level[told], *self._signal(),
        )  # fmt: skip
        log_odds.flags.writeable = False
        return RadioPicture(GridMap(log_odds, origin, self._resolution_m), routers)

    def _signal(self) -> tuple[float, float, float, float]:
        config = self._config
        return config.power_at_1m_dbm, config.path_loss_exponent, config.wall_loss_db, config.noise_std_db

    def _routers(self, place: Array, mac: Array, level: Array) -> tuple[Array, Array]:
        """Places of the transmitters passed nearly (routers, 2), and which of them each reading heard (-1: none)."""
        known, inverse = np.unique(mac, return_inverse=True)
        strongest = np.full(len(known), -np.inf)
        np.maximum.at(strongest, inverse, level)
        is_located = strongest >= self._config.located_from_dbm
        number = np.where(is_located, np.cumsum(is_located) - 1, -1)
        order = np.lexsort((-level, inverse))
        first = np.searchsorted(inverse[order], np.flatnonzero(is_located))
        last = np.searchsorted(inverse[order], np.flatnonzero(is_located), side="right")
        own = [order[a : min(b, a + _PLACED_FROM)] for a, b in zip(first, last, strict=True)]
        routers = [self._placed(place[rows], level[rows]) for rows in own]
        return np.array(routers).reshape(-1, 2), number[inverse]

    def _placed(self, place: Array, level: Array) -> Array:
        """(2,) from where readings (k,) at places (k, 2) that no wall weakens would fall off as these do."""
        config = self._config
        best = place[level >= level.max() - 3.0].mean(axis=0)
        offsets = np.arange(-_SEARCH_REACH, _SEARCH_REACH + 1.0)
        lattice = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
        for step_m in _SEARCH_STEPS_M:
            tried = best + step_m * lattice  # (81, 2)
            distance = np.maximum(np.linalg.norm(tried[:, None] - place, axis=2), 0.5)
            error = level - config.power_at_1m_dbm + 10.0 * config.path_loss_exponent * np.log10(distance)
            spread = (_POWER_STD_DB / config.noise_std_db) ** 2
            power = error.sum(axis=1) * spread / (1.0 + spread * len(level))
            misfit = (np.minimum(np.abs(error - power[:, None]), 3.0 * config.noise_std_db) ** 2).sum(axis=1)
            best = tried[np.argmin(misfit + power**2 / spread)]
        return best


@kernel
def update_reading(log_odds, origin, inverse_m, x, y, router_x, router_y, rssi, power, exponent, loss, noise):
    """One reading at (x, y) of a router: the probability that no wall lies between moves every cell on the ray."""
    rows, columns = log_odds.shape
    dx, dy = x - router_x, y - router_y
    distance = np.sqrt(dx * dx + dy * dy)
    excess = power - 10.0 * exponent * np.log10(max(distance, 0.5)) - rssi
    total, clear, expected = 0.0, 0.0, 0.0
    for k in range(6):
        likelihood = np.exp(-0.5 * ((excess - loss * k) / noise) ** 2) * 0.6**k + 1e-12
        total += likelihood
        expected += k * likelihood
        if k == 0:
            clear = likelihood
    clear, expected = clear / total, expected / total
    steps = int(distance * inverse_m) + 1
    # Walls already found on the ray explain their share of the loss.
    found, before, cells = 0.0, False, 0
    for s in range(steps + 1):
        c = int(np.floor((router_x + dx * s / steps - origin[0]) * inverse_m))
        r = int(np.floor((router_y + dy * s / steps - origin[1]) * inverse_m))
        if 0 <= r < rows and 0 <= c < columns:
            is_wall = log_odds[r, c] > 8
            if is_wall and not before:
                found += 1.0
            before = is_wall
            cells += 1
    share = min(max(expected - found, 0.0) / max(cells, 1), 0.5)
    share = min(max(share * (1.0 - clear), 0.002), 0.5)
    change = np.log(share / (1.0 - share)) - np.log(_WALL_DENSITY / (1.0 - _WALL_DENSITY))
    step = int(np.round(change * _RAY_WEIGHT * LEVELS_PER_NAT))
    for s in range(steps + 1):
        c = int(np.floor((router_x + dx * s / steps - origin[0]) * inverse_m))
        r = int(np.floor((router_y + dy * s / steps - origin[1]) * inverse_m))
        if 0 <= r < rows and 0 <= c < columns:
            log_odds[r, c] = min(max(log_odds[r, c] + step, -_LEVEL_MAX), _LEVEL_MAX)


@kernel
def _update_all(log_odds, origin, inverse_m, places, routers, which, levels, power, exponent, loss, noise):
    for i in range(places.shape[0]):
        j = which[i]
        update_reading(
            log_odds, origin, inverse_m, places[i, 0], places[i, 1], routers[j, 0], routers[j, 1], levels[i], power,
            exponent, loss, noise,
        )  # fmt: skip
