"""Walls and free floor beyond the robots' scans, from WiFi signal strength along their paths (papers.md X5, K24c).

Incremental inverse k-visibility: every reading updates the cells on the ray to its router. A router is localised once a
robot has passed close to it; the number of walls crossed follows from the excess loss of a reading.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import KVisibilityConfig
from twc_env.kernels.compiled import kernel
from twc_env.records.geometry import compose, inverse, transform_points
from twc_env.records.messages import GridMap, SensorFrame

LEVELS_PER_NAT = 16.0
"""Log-odds are stored as integers in sixteenths."""
_LEVEL_MAX = 60
_WALL_DENSITY = 0.04
"""Prior probability that a cell is a wall."""
_RAY_WEIGHT = 0.25
"""Weight of one ray, since neighbouring rays are correlated."""
_MARGIN_M = 2.0
_PLACED_FROM = 40
"""Number of strongest readings used to localise a transmitter; few walls lie in front of these."""
_POWER_STD_DB = 3.0
"""Prior standard deviation of a transmitter's power."""
REDRAWN_FACTOR = 1.25
"""Growth factor of the number of scans after which the picture is redrawn completely."""
_SEARCH_STEPS_M = (0.6, 0.15)
_SEARCH_REACH = 4
"""Positions tried on either side of the best one, at each step width."""


@dataclass(frozen=True, slots=True, eq=False)
class RadioPicture:
    """Map from the readings of some robots, in one frame."""

    grid: GridMap
    """Log-odds: below 0 probably free, above 0 probably wall."""
    transmitter_m: Array
    """(k, 2) estimated positions of the localised transmitters, by ascending address."""


@dataclass(slots=True, eq=False)
class _Readings:
    """Readings of one robot, at the poses estimated by its front end."""

    pose_odom: list[Array]
    macs: list[Array]
    rssi_dbm: list[Array]
    scanned_s: float = -math.inf
    """End of its last scan, by its own clock."""


@dataclass(slots=True, eq=False)
class _Drawn:
    """A picture and the data it was drawn from."""

    picture: RadioPicture
    macs: Array
    """(k,) addresses of the picture's transmitters, ascending."""
    version: int
    """Version of the map whose frame it is in."""
    scans: list[int]
    """Number of scans of each robot."""
    scans_at_redraw: int

    @property
    def scan_count(self) -> int:
        """Number of scans of all robots."""
        return sum(self.scans)


class RadioStructure:
    """Readings of a team, and the pictures drawn from them for any set of robots with a common frame."""

    def __init__(self, config: KVisibilityConfig, resolution_m: float, robots: int):
        self._config, self._resolution_m = config, resolution_m
        self._readings = [_Readings([], [], []) for _ in range(robots)]
        self._maps: dict[tuple[int, ...], _Drawn] = {}
        self._given: tuple[Array, Array, Array] | None = None

    def give_transmitters(self, macs: Array, position_m: Array, start_poses: Array) -> None:
        """Use given transmitter positions, in the frame of the given start poses, instead of localising them."""
        order = np.argsort(macs)
        self._given = np.asarray(macs)[order], np.asarray(position_m, float)[order], np.asarray(start_poses, float)

    def add(self, frame: SensorFrame, pose_odom: Array) -> None:
        """Store a frame's WiFi scan, if any, without readings cached from the robot's previous scan."""
        if frame.wifi is None:
            return
        own = self._readings[frame.robot]
        macs, rssi_dbm = np.asarray(frame.wifi.macs), np.asarray(frame.wifi.rssi_dbm)
        if frame.wifi.age_s is not None:
            is_new = np.asarray(frame.wifi.age_s) < frame.time_s - own.scanned_s
            macs, rssi_dbm = macs[is_new], rssi_dbm[is_new]
        own.scanned_s = frame.time_s
        if len(macs):
            own.pose_odom.append(np.asarray(pose_odom, float).copy())
            own.macs.append(macs)
            own.rssi_dbm.append(rssi_dbm)

    def picture_of(self, robots: tuple[int, ...], poses_map_odom: Array, version: int) -> RadioPicture | None:
        """The picture of these robots in a map frame; poses (robots, 3) of their odom frames in it.

        Every `period_scans` scans, new readings are added, and all readings of newly localised transmitters. All are
        redrawn when the map version changed, or when the number of scans has grown by REDRAWN_FACTOR, which improves
        the transmitter positions. None before the first reading.
        """
        scans = [len(self._readings[r].macs) for r in robots]
        count, held = sum(scans), self._maps.get(robots)
        if held is not None and held.version == version:
            if count // self._config.period_scans == held.scan_count // self._config.period_scans:
                return held.picture
            if count < REDRAWN_FACTOR * held.scans_at_redraw:
                return self._extended(held, robots, poses_map_odom, scans)
        if not count:
            return None
        place, mac, level = self._heard(robots, poses_map_odom, [0] * len(robots))
        if self._given is None:
            macs, transmitter_m = self._located(place, mac, level)
        else:
            macs, position_m, starts = self._given
            transmitter_m = transform_points(compose(poses_map_odom[0], inverse(starts[robots[0]])), position_m)
        low = np.floor(place[0] / self._resolution_m) * self._resolution_m
        nothing = GridMap(np.zeros((1, 1), np.int16), low, self._resolution_m)
        picture = self._with(nothing, transmitter_m, place, _places_of(mac, macs), level)
        self._maps[robots] = _Drawn(picture, macs, version, scans, count)
        return picture

    def _extended(self, held: _Drawn, robots: tuple[int, ...], poses_map_odom: Array, scans: list[int]) -> RadioPicture:
        """The picture with the readings since `held` added."""
        place, mac, level = self._heard(robots, poses_map_odom, held.scans)
        macs, transmitter_m = held.macs, held.picture.transmitter_m
        known = _places_of(mac, macs)
        if self._given is None and np.any(level[known < 0] >= self._config.located_from_dbm):
            earlier = self._heard(robots, poses_map_odom, [0] * len(robots))
            others = [part[_places_of(earlier[1], macs) < 0] for part in earlier]
            found, found_m = self._located(*others)
            is_found = _places_of(others[1], found) >= 0
            place, mac, level = (
                np.concatenate([part[known >= 0], other[is_found]])
                for part, other in zip((place, mac, level), others, strict=True)
            )
            order = np.argsort(np.concatenate([macs, found]))
            macs = np.concatenate([macs, found])[order]
            transmitter_m = np.concatenate([transmitter_m, found_m])[order]
        held.picture = self._with(held.picture.grid, transmitter_m, place, _places_of(mac, macs), level)
        held.macs, held.scans = macs, scans
        return held.picture

    def _heard(self, robots: tuple[int, ...], poses_map_odom: Array, since: list[int]) -> tuple[Array, Array, Array]:
        """Readings of these robots from their scans `since` on: positions (n, 2), addresses and levels (n,)."""
        places, macs, levels = [np.zeros((0, 2))], [np.zeros(0, np.int64)], [np.zeros(0)]
        for robot, pose, first in zip(robots, poses_map_odom, since, strict=True):
            own = self._readings[robot]
            if len(own.macs) > first:
                at = compose(pose, np.array(own.pose_odom[first:]))[:, :2]
                places.append(np.repeat(at, [len(m) for m in own.macs[first:]], axis=0))
                macs += own.macs[first:]
                levels += own.rssi_dbm[first:]
        return np.concatenate(places), np.concatenate(macs), np.concatenate(levels)

    def _with(self, before: GridMap, transmitter_m: Array, place: Array, which: Array, level: Array) -> RadioPicture:
        """A grid with readings added: positions (n, 2), transmitter indices (n,), -1 for none, and levels (n,)."""
        cell = self._resolution_m
        ends = np.concatenate([place, transmitter_m])
        held = np.round(np.asarray(before.origin_m) / cell)
        low = np.vstack([np.floor((ends - _MARGIN_M) / cell), held]).min(axis=0).astype(int)
        high = np.vstack([np.ceil((ends + _MARGIN_M) / cell), held + before.log_odds.shape[::-1]]).max(axis=0)
        (columns, rows), (column, row) = (high.astype(int) - low).tolist(), (held.astype(int) - low).tolist()
        log_odds, origin = np.zeros((rows, columns), np.int16), low * cell
        log_odds[row : row + before.log_odds.shape[0], column : column + before.log_odds.shape[1]] = before.log_odds
        told = which >= 0
        _update_all(
            log_odds, origin, 1.0 / cell, np.ascontiguousarray(place[told]), transmitter_m, which[told],
            level[told], *self._signal(),
        )  # fmt: skip
        log_odds.flags.writeable = False
        return RadioPicture(GridMap(log_odds, origin, cell), transmitter_m)

    def _signal(self) -> tuple[float, float, float, float]:
        config = self._config
        return config.power_at_1m_dbm, config.path_loss_exponent, config.wall_loss_db, config.noise_std_db

    def _located(self, place: Array, mac: Array, level: Array) -> tuple[Array, Array]:
        """Addresses (k,), ascending, and positions (k, 2) of transmitters that were passed closely."""
        known, inverse = np.unique(mac, return_inverse=True)
        strongest = np.full(len(known), -np.inf)
        np.maximum.at(strongest, inverse, level)
        located = np.flatnonzero(strongest >= self._config.located_from_dbm)
        order = np.lexsort((-level, inverse))
        first, last = (np.searchsorted(inverse[order], located, side) for side in ("left", "right"))
        own = [order[a : min(b, a + _PLACED_FROM)] for a, b in zip(first, last, strict=True)]
        places = [self._placed(place[rows], level[rows]) for rows in own]
        return known[located], np.array(places).reshape(-1, 2)

    def _placed(self, place: Array, level: Array) -> Array:
        """(2,) position by grid search, assuming readings (k,) at positions (k, 2) without walls in between."""
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


def _places_of(mac: Array, macs: Array) -> Array:
    """Index of each of `mac` (n,) among the ascending addresses (k,); -1 if absent."""
    if not len(macs):
        return np.full(len(mac), -1)
    found = np.clip(np.searchsorted(macs, mac), 0, len(macs) - 1)
    return np.where(macs[found] == mac, found, -1)


@kernel
def update_reading(log_odds, origin, inverse_m, x, y, router_x, router_y, rssi, power, exponent, loss, noise):
    """Update the cells on the ray of one reading at (x, y) by the probability that no wall lies on it.

    A cell that contains several samples of the ray is updated for each.
    """
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
    # Walls already mapped on the ray explain their share of the loss.
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
