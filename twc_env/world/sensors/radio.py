"""RSSI of WiFi and LTE: path loss, walls, ceilings, shadowing, fading, device and noise (papers.md T5, X2).

rssi = P(1 m) - 10 n log10(max(d, d0)) - losses of walls and ceilings + shadowing(position) + fading(visit) +
device(robot) + noise(scan), detected with probability 1 / (1 + exp((floor - rssi) / slope)) and rounded to whole dB.
The loss of walls with a sum of L dB is -10 log10((1 - w) 10^(-L/10) + w), as a share w of the power bypasses them.
Power, exponent, losses, floor and slope belong to the band: 2.4 GHz, 5 GHz, or LTE cells on masts outside (papers.md
R14-R15).
"""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import RadioConfig
from twc_env.records.geometry import inverse, transform_points
from twc_env.world.building.crossing_table import CrossingTable
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.materials import MATERIALS
from twc_env.world.building.wall_index import WallIndex
from twc_env.world.sensors.mean_rssi import lose_in_bodies, mean_rssi

LOW_BAND, HIGH_BAND, CELL_BAND = 0, 1, 2
"""2.4 GHz, 5 GHz, LTE."""
CELL_ID_MIN = 1 << 48
"""Least number of an LTE cell, above all MAC addresses."""
_WAVES = 32
"""Cosines per shadowing field."""
_SECTORS = 3
"""Cells per mast."""
_SECTOR_WIDTH_RAD = np.deg2rad(65.0)
"""Half-power width of a mast's sector antenna (3GPP TR 36.814, table A.2.1.1-2)."""
_SECTOR_BACK_DB = 20.0
"""Greatest loss of that antenna."""
_VIRTUAL_ADDRESS_STEP = 1 << 40
"""Difference between the addresses of an access point's virtual networks."""


@dataclass(frozen=True, slots=True, eq=False)
class _Sources:
    """Signal sources: access points of the plan, then cells; each has one position and one shadowing field."""

    position_m: Array
    """(sources, 2) building frame."""
    height_m: Array
    """(sources,) height difference to the robots' storey."""
    floors: Array
    """(sources,) count of ceilings to the robots' storey."""
    waves: Array
    """(3, waves, sources) x and y frequency [rad/m] and phase of the shadowing field's cosines."""
    shadowing_std_db: Array
    """(sources,)."""


class RadioModel:
    """Mean RSSI of all transmitters at any position; depends on the building only."""

    def __init__(self, config: RadioConfig, plan: Floorplan):
        self._config, self._index = config, plan.wall_index
        self._pose_home_building = inverse(plan.pose_building_home)
        access_points, origin = (plan.access_points if config.wifi else ()), plan.origin
        cells = _place_cells(config, plan)
        self._sources = _sources(config, plan, access_points, cells)
        of_all, whole = _addresses(config, origin.macs), {own: i for i, own in enumerate(origin.macs)}
        numbers = [whole[tuple(access_point.macs)] for access_point in access_points]
        addresses = [of_all[i] for i in numbers]
        addresses += [(CELL_ID_MIN + c,) for c in range(len(cells))]
        numbers += [(len(whole) if config.wifi else 0) + c for c in range(len(cells))]
        macs = np.array([mac for own in addresses for mac in own], np.int64)
        owners = np.array([i for i, own in enumerate(addresses) for _ in own], np.int64)
        bands = [band for own in addresses[: len(access_points)] for band in _bands(len(own), config.high_band.share)]
        bands += [CELL_BAND] * len(cells)
        order = np.argsort(macs)
        self.macs = macs[order]
        """(transmitters,) ascending."""
        self.access_point_of = owners[order]
        """(transmitters,) source of each address: number of the access point, or their count plus that of the cell."""
        self.band_of = np.array(bands, np.int64)[order]
        """(transmitters,) LOW_BAND, HIGH_BAND or CELL_BAND."""
        self.is_cell = self.band_of == CELL_BAND
        """(transmitters,)."""
        draws = [_building_stream(origin.digest, "power", int(mac)).standard_normal() for mac in self.macs]
        boxes_db = self._access_point_offsets_db(plan)
        self._power_offsets_db = config.power_spread_db * np.array(draws) + boxes_db[self.access_point_of]
        self._aim_rad = np.array([aim for _, aim in cells])
        self._index_of_band = [_index_for(config, plan, band) for band in range(3)]
        high, cell = config.high_band, config.cells
        low_floor = config.detection_floor_dbm
        by_band = np.array(
            [
                [config.power_at_1m_dbm, config.path_loss_exponent, low_floor, 1.0],
                [
                    config.power_at_1m_dbm + high.power_offset_db,
                    high.path_loss_exponent,
                    low_floor + high.detection_offset_db,
                    high.floor_loss_factor,
                ],
                [cell.power_at_1m_dbm, cell.path_loss_exponent, cell.detection_floor_dbm, 0.0],
            ]
        )
        power, exponent, self.detection_floors_dbm, floor_factor = by_band[self.band_of].T.copy()
        ceilings = self._sources.floors[self.access_point_of]
        further_db = config.floor_loss_further_db * np.maximum(ceilings - 1, 0)
        self._floor_losses_db = floor_factor * (config.floor_loss_db * (ceilings > 0) + further_db)
        grazing_db = floor_factor * config.floor_loss_grazing_db * (ceilings > 0)
        slope_db = config.detection_slope_db
        self.detection_slopes_db = np.array([slope_db, slope_db * high.detection_slope_factor, slope_db])[self.band_of]
        """(transmitters,) slope of the detection probability."""
        missed = config.miss_probability + high.miss_probability_offset * (self.band_of == HIGH_BAND)
        self.miss_probabilities = np.clip(missed, 0.0, 1.0)
        """(transmitters,)."""
        self._power_dbm, self._exponent = power, exponent
        radios, self.radio_of = np.unique(3 * self.access_point_of + self.band_of, return_inverse=True)
        self.radio_count = len(radios)
        """Count of radios; addresses of one access point and band share a radio."""
        self.sweep_place = np.zeros(len(self.macs))
        """(transmitters,) time from scanning the channel to the end of the sweep, as a share of its duration."""
        if config.sweep_duration_s or config.sweep_share < 1.0 or config.sweep_share_std:
            in_whole = 3 * np.array(numbers, np.int64)[radios // 3] + radios % 3
            self.sweep_place = _sweep_places(origin.digest, in_whole)[self.radio_of]
        self._source_count_wifi = len(access_points)
        self._has_cells = len(cells) > 0
        self._levels_dbm = self._power_dbm - self._floor_losses_db + self._power_offsets_db
        used = 3 if self.band_of.any() else 1
        losses_db = [i.loss_db if i is not None else np.zeros(len(plan.walls_m)) for i in self._index_of_band[:used]]
        self.crossings = CrossingTable(self._index, self._sources.position_m[: len(access_points)], np.array(losses_db))
        """Wall crossings between any position and the access points."""
        self._crossed = np.zeros(len(access_points), np.int64), np.zeros((used, len(access_points)))
        sources = self._sources
        boxes = np.column_stack([sources.position_m, sources.height_m, sources.shadowing_std_db]).T.copy()
        self.signal = (
            self._pose_home_building, boxes, sources.waves, np.stack([self._levels_dbm, self._exponent, grazing_db]),
            np.stack([self.access_point_of, self.band_of]),
            np.array([config.distance_min_m, bypass_share(config.wall_loss_limit_db)]),
            np.empty((3 + used, len(sources.position_m))),
        )  # fmt: skip
        """Arguments of `mean_rssi` after the position and the wall losses."""

    def mean_rssi_dbm(self, position_m: Array, bodies: Array | None = None) -> Array:
        """(transmitters,) RSSI at a position (2,) before fading, device offset and noise; bodies (k, 5): what is in the
        way, as of `lose_in_bodies`."""
        x, y, mean = float(position_m[0]), float(position_m[1]), np.empty(len(self.macs))
        losses = self._wall_losses_db(x, y)
        if bodies is not None:
            lose_in_bodies(x, y, self.signal[1], self._crossed[0], bodies, losses)
        mean_rssi(x, y, losses, *self.signal, mean)
        if self._has_cells:
            mean[self.is_cell] -= self._sector_loss_db(np.array([x, y]))
        return mean

    @property
    def is_indoor(self) -> bool:
        """Whether there are no cells, so that `crossings` has all sources."""
        return not self._has_cells

    def _wall_losses_db(self, x: float, y: float) -> Array:
        """(bands, sources) wall losses; 0 for unused bands."""
        counts, losses = self._crossed
        self.crossings.crossed(x, y, counts, losses)
        if not self._has_cells:
            return losses
        position, count = np.array([x, y]), len(counts)
        outside, index = self._signal_origins(position)[count:], self._index_of_band[CELL_BAND]
        assert index is not None
        among_cells = np.zeros((3, len(outside)))
        among_cells[CELL_BAND] = index.crossing(position, outside)[1]
        return np.concatenate([losses, among_cells], axis=1)

    def _signal_origins(self, position: Array) -> Array:
        """(sources, 2) positions; masts are moved along the line of sight to just outside the building."""
        ends = self._sources.position_m
        if not self._has_cells:
            return ends
        low, high = self._index.walls_m.reshape(-1, 2).min(axis=0), self._index.walls_m.reshape(-1, 2).max(axis=0)
        reach = np.linalg.norm(high - low) + np.linalg.norm(position - (low + high) / 2)
        ends = ends.copy()
        away = ends[self._source_count_wifi :] - position
        share = np.minimum(1.0, reach / np.maximum(np.linalg.norm(away, axis=1), 1e-9))
        ends[self._source_count_wifi :] = position + share[:, None] * away
        return ends

    def _sector_loss_db(self, position: Array) -> Array:
        """(cells,) antenna loss: 12 (angle / width)^2 dB up to `_SECTOR_BACK_DB`."""
        masts = transform_points(self._pose_home_building, self._sources.position_m[self._source_count_wifi :])
        away = transform_points(self._pose_home_building, position[None]) - masts
        off = np.arctan2(away[:, 1], away[:, 0]) - self._aim_rad
        off = (off + np.pi) % (2 * np.pi) - np.pi
        return np.minimum(12.0 * (off / _SECTOR_WIDTH_RAD) ** 2, _SECTOR_BACK_DB)

    def _access_point_offsets_db(self, plan: Floorplan) -> Array:
        """(sources,) deviation of each access point's power from the mean; 0 for cells."""
        offsets = np.zeros(len(self._sources.position_m))
        if self._config.access_point_spread_db and self._config.wifi:
            for i, access_point in enumerate(plan.access_points):
                draw = _building_stream(plan.origin.digest, "access-point", min(access_point.macs)).standard_normal()
                offsets[i] = self._config.access_point_spread_db * draw
        return offsets


def _building_stream(digest: str, what: str, mac: int) -> np.random.Generator:
    return np.random.default_rng([int(digest, 16), zlib.crc32(what.encode()), mac])


def bypass_share(wall_loss_limit_db: float) -> float:
    """Share of the free-space power that bypasses walls."""
    return 10.0 ** (-wall_loss_limit_db / 10.0) if wall_loss_limit_db else 0.0


def _sweep_places(digest: str, radios: Array) -> Array:
    """(radios,) in [0, 1): see `RadioModel.sweep_place`; 5 GHz channels are scanned last.

    radios (radios,): 3 times the number of the source in the whole building, plus the band.
    """
    channel = np.array([_building_stream(digest, "channel", int(radio)).random() for radio in radios])
    return 0.5 * channel + 0.5 * (radios % 3 != HIGH_BAND)


def _shadowing_waves(length_m: float, digest: str, mac: int) -> Array:
    """(waves, 3) x and y frequency [rad/m] and phase of a field with correlation exp(-distance / length).

    The frequencies are sampled from the spectral density of that kernel in 2D, ~ (1 + (k length)^2)^(-3/2).
    """
    random = _building_stream(digest, "shadowing", mac)
    share = (np.arange(_WAVES) + random.random(_WAVES)) / _WAVES
    frequency = np.sqrt(1 / (1 - share) ** 2 - 1) / length_m
    angle, phase = random.uniform(0, 2 * np.pi, (2, _WAVES))
    return np.column_stack([frequency * np.cos(angle), frequency * np.sin(angle), phase])


def _place_cells(config: RadioConfig, plan: Floorplan) -> list[tuple[Array, float]]:
    """Position in the home frame and antenna direction [rad] of each cell; depends on the building only."""
    cells, low_high = config.cells, plan.home.bounds_m
    middle = (low_high[:2] + low_high[2:]) / 2
    placed = []
    for mast in range(-(-cells.count // _SECTORS)):
        random = _building_stream(plan.origin.digest, "mast", mast)
        near2, far2 = cells.distance_min_m**2, cells.distance_max_m**2
        distance_m = np.sqrt(random.uniform(min(near2, far2), max(near2, far2)))
        bearing, aim = random.uniform(-np.pi, np.pi, 2)
        position = middle + distance_m * np.array([np.cos(bearing), np.sin(bearing)])
        placed += [(position, aim + 2 * np.pi * sector / _SECTORS) for sector in range(_SECTORS)]
    return placed[: cells.count]


def _sources(config: RadioConfig, plan: Floorplan, access_points, cells: list[tuple[Array, float]]) -> _Sources:
    masts = transform_points(plan.pose_building_home, np.array([p for p, _ in cells]).reshape(-1, 2))
    positions = np.concatenate([np.array([a.position_m for a in access_points]).reshape(-1, 2), masts])
    floors = np.array([abs(a.floor) for a in access_points] + [0] * len(cells), float)
    digest = plan.origin.digest
    waves = [_shadowing_waves(config.shadowing_length_m, digest, min(a.macs)) for a in access_points]
    # The sectors of a mast share its shadowing.
    length_m = config.cells.shadowing_length_m
    waves += [_shadowing_waves(length_m, digest, CELL_ID_MIN + c // _SECTORS) for c in range(len(cells))]
    stds = [config.shadowing_std_db] * len(access_points) + [config.cells.shadowing_std_db] * len(cells)
    return _Sources(
        position_m=positions,
        height_m=floors * config.floor_height_m,
        floors=floors,
        waves=np.ascontiguousarray(np.array(waves).reshape(-1, _WAVES, 3).T),
        shadowing_std_db=np.array(stds, float),
    )


def _addresses(config: RadioConfig, macs: Sequence[tuple[int, ...]]) -> list[tuple[int, ...]]:
    """The addresses of each access point of the whole building: those of the plan, or as many as configured."""
    wanted = config.bssids_per_access_point
    if wanted == 0:
        return list(macs)
    taken = {mac for given in macs for mac in given}
    addresses = []
    for given in macs:
        own, candidate = list(given[:wanted]), given[0]
        while len(own) < wanted:
            # Virtual networks of access points differ in the leading byte.
            candidate = (candidate + _VIRTUAL_ADDRESS_STEP) % CELL_ID_MIN or 1
            if candidate in taken:
                candidate += 1
                continue
            taken.add(candidate)
            own.append(candidate)
        addresses.append(tuple(own))
    return addresses


def _bands(count: int, high_share: float) -> list[int]:
    """Band of each of an access point's addresses; share 1/2: every second one is 5 GHz."""
    return [HIGH_BAND if int((k + 1) * high_share) > int(k * high_share) else LOW_BAND for k in range(count)]


def _index_for(config: RadioConfig, plan: Floorplan, band: int) -> WallIndex | None:
    """The walls with their losses on a band; None if the band is unused."""
    if band == LOW_BAND:
        if not config.wifi or config.high_band.share == 1.0:
            return None
        return _scaled(plan, config.wall_loss_scale)
    if (band == HIGH_BAND and not (config.wifi and config.high_band.share)) or (
        band == CELL_BAND and not config.cells.count
    ):
        return None
    factor = config.high_band.wall_loss_factor if band == HIGH_BAND else config.cells.wall_loss_factor
    factors = np.full(len(plan.walls_m), factor)
    for i, material in enumerate(plan.wall_materials):
        if material:
            losses_db = MATERIALS[material].losses_db
            factors[i] = losses_db[band] / losses_db[LOW_BAND]
    return _scaled(plan, config.wall_loss_scale * factors)


def _scaled(plan: Floorplan, factor: float | Array) -> WallIndex:
    return dataclasses.replace(plan.wall_index, loss_db=plan.wall_loss_db * factor)
