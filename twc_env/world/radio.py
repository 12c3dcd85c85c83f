"""WiFi received strength: path loss, walls crossed, shadowing, fading, device offset, noise, detection (SPEC T5, X2).

rssi = P(1 m) - 10 n log10(max(d, d0)) - wall losses + shadowing(place) + fading(visit) + device(robot) + noise(scan),
heard with probability 1 / (1 + exp((floor - rssi) / slope)) and reported in whole dB.
"""

from __future__ import annotations

import zlib

import numpy as np
from numba import njit
from numpy.typing import NDArray

from twc_env.config import RadioConfig
from twc_env.geometry import inverse
from twc_env.messages import WifiScan
from twc_env.random_streams import random_stream
from twc_env.world.floorplan import Floorplan

Array = NDArray

_WAVES = 32
"""Cosines summed per shadowing field."""
_POWER_SPREAD_DB = 1.0
"""How much the transmitters of one access point differ in power (standard deviation)."""


class RadioModel:
    """What depends on the building alone: the mean strength of every transmitter at a place."""

    def __init__(self, config: RadioConfig, plan: Floorplan):
        self._config, self._index = config, plan.wall_index
        self._positions_m = np.array([a.position_m for a in plan.access_points]).reshape(-1, 2)
        macs = np.array([mac for a in plan.access_points for mac in a.macs], np.int64)
        owners = np.array([i for i, a in enumerate(plan.access_points) for _ in a.macs], np.int64)
        order = np.argsort(macs)
        self.macs = macs[order]
        """(transmitters,) ascending."""
        self.access_point_of = owners[order]
        """(transmitters,) number of the access point that sends under each address."""
        self._power_offsets_db = np.array([_power_offset_db(plan.digest, mac) for mac in self.macs])
        self._waves = np.array([_shadowing_waves(config, plan.digest, a.macs) for a in plan.access_points])
        self._waves = self._waves.reshape(-1, _WAVES, 3)
        self._pose_home_building = inverse(plan.pose_building_home)

    def shadowing_db(self, position_m: Array) -> Array:
        """(access points,) the fixed deviation of each signal at a place (2,) of the building frame."""
        shadowing = np.empty(len(self._positions_m))
        _shadowing(
            np.asarray(position_m, float), self._pose_home_building, self._waves,
            self._config.shadowing_std_db, shadowing,
        )  # fmt: skip
        return shadowing

    def mean_rssi_dbm(self, position_m: Array) -> Array:
        """(transmitters,) strength at a place (2,) before fading, device offset and noise."""
        config = self._config
        losses = self._index.crossing(position_m, self._positions_m)[1]
        mean = np.empty(len(self.macs))
        _mean_rssi(
            np.asarray(position_m, float), self._positions_m, losses, self.shadowing_db(position_m),
            config.power_at_1m_dbm, config.path_loss_exponent, config.distance_min_m,
            self.access_point_of, self._power_offsets_db, mean,
        )  # fmt: skip
        return mean


class WifiReceiver:
    """One robot's WiFi device for one episode."""

    def __init__(self, config: RadioConfig, model: RadioModel, robot: int, seed: int):
        self._config, self._model = config, model
        self._noise = random_stream(seed, "wifi-noise", robot)
        self._detection = random_stream(seed, "wifi-detection", robot)
        self._fading = random_stream(seed, "wifi-fading", robot)
        device = random_stream(seed, "wifi-device", robot)
        self._device_offset_db = config.device_offset_std_db * device.standard_normal()
        self._fading_db = np.zeros(len(model.macs))
        self._fading_place_m: tuple[float, float] | None = None

    def scan(self, position_m: Array) -> WifiScan:
        """Hear what can be heard at a true position (2,)."""
        self._refresh_fading(position_m)
        count = len(self._model.macs)
        rssi = self._model.mean_rssi_dbm(position_m)
        heard = np.empty(count, np.bool_)
        config = self._config
        _receive(
            rssi, self._fading_db, self._device_offset_db, config.noise_std_db, self._noise.standard_normal(count),
            self._detection.random(count), config.detection_floor_dbm, config.detection_slope_db, heard,
        )  # fmt: skip
        return WifiScan(self._model.macs[heard], rssi[heard])

    def _refresh_fading(self, position_m: Array) -> None:
        x, y = float(position_m[0]), float(position_m[1])
        if self._fading_place_m is not None:
            moved2 = (x - self._fading_place_m[0]) ** 2 + (y - self._fading_place_m[1]) ** 2
            if moved2 < self._config.fading_length_m**2:
                return
        self._fading_place_m = (x, y)
        self._fading_db = self._config.fading_std_db * self._fading.standard_normal(len(self._fading_db))


def _building_stream(digest: str, what: str, mac: int) -> np.random.Generator:
    return np.random.default_rng([int(digest, 16), zlib.crc32(what.encode()), mac])


def _power_offset_db(digest: str, mac: int) -> float:
    return _POWER_SPREAD_DB * _building_stream(digest, "power", int(mac)).standard_normal()


def _shadowing_waves(config: RadioConfig, digest: str, macs: tuple[int, ...]) -> Array:
    """(waves, 3) x and y frequency [rad/m] and phase, so that the field's correlation is exp(-distance / length).

    The frequencies follow the spectrum of that kernel in the plane, density ~ (1 + (k length)^2)^(-3/2).
    """
    random = _building_stream(digest, "shadowing", min(macs))
    share = (np.arange(_WAVES) + random.random(_WAVES)) / _WAVES
    frequency = np.sqrt(1 / (1 - share) ** 2 - 1) / config.shadowing_length_m
    angle, phase = random.uniform(0, 2 * np.pi, (2, _WAVES))
    return np.column_stack([frequency * np.cos(angle), frequency * np.sin(angle), phase])


@njit(cache=True, error_model="numpy")
def _shadowing(position, pose_home_building, waves, std, shadowing):
    c, s = np.cos(pose_home_building[2]), np.sin(pose_home_building[2])
    x = pose_home_building[0] + c * position[0] - s * position[1]
    y = pose_home_building[1] + s * position[0] + c * position[1]
    amplitude = std * np.sqrt(2.0 / waves.shape[1])
    for a in range(waves.shape[0]):
        total = 0.0
        for k in range(waves.shape[1]):
            total += np.cos(waves[a, k, 0] * x + waves[a, k, 1] * y + waves[a, k, 2])
        shadowing[a] = amplitude * total


@njit(cache=True, error_model="numpy")
def _mean_rssi(position, sources, losses, shadowing, power, exponent, distance_min, owners, offsets, mean):
    for t in range(owners.shape[0]):
        a = owners[t]
        distance = np.sqrt((sources[a, 0] - position[0]) ** 2 + (sources[a, 1] - position[1]) ** 2)
        path_loss = 10.0 * exponent * np.log10(max(distance, distance_min))
        mean[t] = power - path_loss - losses[a] + shadowing[a] + offsets[t]


@njit(cache=True, error_model="numpy")
def _receive(rssi, fading, device_offset, noise_std, noise, chance, floor, slope, heard):
    """Turn mean strengths into readings, in place."""
    for t in range(rssi.shape[0]):
        level = rssi[t] + fading[t] + device_offset + noise_std * noise[t]
        heard[t] = chance[t] * (1.0 + np.exp((floor - level) / slope)) < 1.0
        rssi[t] = np.floor(level + 0.5)
