"""WiFi scans of the robots' radio devices: mean RSSI, fading, device offset, noise and detection."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import RadioConfig
from twc_env.kernels.compiled import borrowing_kernel
from twc_env.records.messages import WifiScan
from twc_env.records.random_streams import random_stream
from twc_env.world.building.crossing_table import crossed_at
from twc_env.world.sensors.mean_rssi import lose_in_bodies, mean_rssi
from twc_env.world.sensors.noise import StepNoise, StepQueue
from twc_env.world.sensors.radio import RadioModel

_LEVEL_MAX_DBM = -1.0
"""Receivers saturate; 0 is what drivers report of what they did not hear, and the engine refuses it."""
CHANGE_PERIOD_S = 60.0
"""How long access points keep a power (`radio.power_change_std_db`)."""
_ROUNDING = 1e-9
"""Bound of rounding errors of numbers of order 1."""


class WifiReceiver:
    """One robot's radio device for one episode."""

    def __init__(self, config: RadioConfig, model: RadioModel, robot: int, seed: int, offset_db: float = 0.0):
        self._config, self._model = config, model
        count = len(model.macs)
        noise, detection = random_stream(seed, "wifi-noise", robot), random_stream(seed, "wifi-detection", robot)
        self.streams = noise, detection, random_stream(seed, "wifi-fading", robot)
        """Random streams of noise, detection and fading; of all transmitters if they are of one kind."""
        cells = int(np.count_nonzero(model.is_cell))
        beside = cells if cells < count else 0
        self._cells_fading = (random_stream(seed, "cell-fading", robot), beside) if beside else None
        """Random stream and number of cells beside WiFi, which do not shift the noise of its readings."""
        self._draws = StepNoise([noise], count - beside)
        if beside:
            self._draws.beside([random_stream(seed, "cell-noise", robot)], beside)
        self._draws.beside([detection], count - beside, "random")
        if beside:
            self._draws.beside([random_stream(seed, "cell-detection", robot)], beside, "random")
        self._sweep = random_stream(seed, "wifi-sweep", robot)
        self._is_partial = config.sweep_share < 1.0 or config.sweep_share_std > 0.0
        is_steady = not (self._is_partial or config.stale_age_max_s or config.power_change_std_db)
        self.is_plain = model.is_indoor and is_steady
        """Whether `hear` computes the same as `scan`: no cells, partial sweeps, stale readings or changes of power."""
        self._seed, self._changes = seed, (-1, np.zeros(count))
        device = random_stream(seed, "wifi-device", robot)
        device_offset_db = config.device_offset_std_db * device.standard_normal() + (
            config.device_offset_db + offset_db
        )
        floors_dbm = model.detection_floors_dbm + config.device_sensitivity_std_db * device.standard_normal()
        self.detection = np.stack([floors_dbm, model.detection_slopes_db, 1.0 - model.miss_probabilities])
        """(3, transmitters) floor [dBm], slope [dB] and maximum of the detection probability."""
        self.constants = np.array([
            device_offset_db, config.noise_std_db, config.quantisation_db, config.fading_length_m, config.fading_std_db
        ])  # fmt: skip
        self.is_fading_shared = config.fading_shared
        self._fading_db = np.zeros(count)
        self._fading_x, self._fading_y = np.inf, np.inf
        self._last_dbm, self._last_time_s = np.zeros(count), np.full(count, -np.inf)

    def scan(self, position_m: Sequence[float] | Array, time_s: float = 0.0, bodies: Array | None = None) -> WifiScan:
        """The scan at a true position (x, y, ...) among people; time_s: for the age of stale readings."""
        x, y = float(position_m[0]), float(position_m[1])
        config, model = self._config, self._model
        if (x - self._fading_x) ** 2 + (y - self._fading_y) ** 2 >= config.fading_length_m**2:
            self._refresh_fading(x, y)
        count = len(model.macs)
        rssi, heard = model.mean_rssi_dbm(np.array([x, y]), bodies), np.empty(count, np.bool_)
        if config.power_change_std_db:
            rssi += self._power_changes_db(int(time_s // CHANGE_PERIOD_S))
        _receive(
            rssi, self._fading_db, self.constants, self._draws.next()[0], self.detection, model.macs, heard,
            np.empty(count, np.int64), np.empty(count),
        )  # fmt: skip
        if config.cells.listed_max:
            self._drop_weakest_cells(rssi, heard)
        if self._is_partial:
            share = config.sweep_share + config.sweep_share_std * self._sweep.standard_normal()
            heard &= (model.sweep_place - self._sweep.random()) % 1.0 < share
        if config.stale_age_max_s > 0.0:
            return self._with_stale_readings(rssi, heard, time_s)
        return WifiScan(model.macs[heard], rssi[heard])

    def _power_changes_db(self, period: int) -> Array:
        """(transmitters,) what each access point adds to its power in a period, the same for all robots; 0 for
        cells."""
        if self._changes[0] != period:
            model = self._model
            stream = random_stream(self._seed, "access point power", period)
            drawn = stream.standard_normal(int(model.access_point_of.max(initial=0)) + 1)
            changes_db = self._config.power_change_std_db * drawn[model.access_point_of]
            self._changes = period, np.where(model.is_cell, 0.0, changes_db)
        return self._changes[1]

    def _drop_weakest_cells(self, rssi: Array, heard: Array) -> None:
        """Keep only the strongest `cells.listed_max` cells: phones list their own and a few neighbours."""
        cells = np.flatnonzero(heard & self._model.is_cell)
        heard[cells[np.argsort(-rssi[cells], kind="stable")[self._config.cells.listed_max :]]] = False

    def _with_stale_readings(self, rssi: Array, heard: Array, time_s: float) -> WifiScan:
        """The new readings, and earlier ones up to the maximum age, with their ages."""
        self._last_dbm[heard], self._last_time_s[heard] = (
            rssi[heard],
            time_s - self._config.sweep_duration_s * self._model.sweep_place[heard],
        )
        age_s = time_s - self._last_time_s
        listed = age_s <= self._config.stale_age_max_s
        return WifiScan(self._model.macs[listed], self._last_dbm[listed], age_s[listed])

    def _refresh_fading(self, x: float, y: float) -> None:
        self._fading_x, self._fading_y = x, y
        model, stream = self._model, self.streams[2]
        count = model.radio_count if self.is_fading_shared else len(model.macs)
        if self._cells_fading is None:
            drawn = stream.standard_normal(count)
        else:  # the cells come last, and each is a radio
            cell_stream, cells = self._cells_fading
            drawn = np.append(stream.standard_normal(count - cells), cell_stream.standard_normal(cells))
        self._fading_db = self._config.fading_std_db * (drawn[model.radio_of] if self.is_fading_shared else drawn)


class WifiReceivers:
    """The arrays of all robots' `WifiReceiver`s for the compiled scan `hear`."""

    def __init__(self, model: RadioModel, devices: Sequence[WifiReceiver]):
        robots, count = len(devices), len(model.macs)
        noise, detection, fading = zip(*(device.streams for device in devices), strict=True)
        self._noise = StepNoise(noise, count).beside(detection, count, "random")
        self._is_fading_shared = devices[0].is_fading_shared
        self._fading = StepQueue(fading, model.radio_count if self._is_fading_shared else count)
        self._model, self._crossings = model, model.crossings
        self._own = (
            np.stack([device.detection for device in devices]), np.stack([device.constants for device in devices]),
            np.zeros((robots, count)), np.full((robots, 2), np.inf), self._fading.numbers, self._fading.used,
            model.radio_of if self._is_fading_shared else np.arange(count), model.macs,
            np.empty(len(self._crossings.arrays[1]), np.int64), np.empty(count), np.empty(count, np.bool_),
        )  # fmt: skip

    def hold(self, number: int) -> None:
        """Draw the random numbers of scan 0, 1, ...; see `StepNoise.hold`."""
        self._noise.hold(number)
        self._fading.hold(number)

    @property
    def arguments(self) -> tuple:
        """Arguments of `hear` between the walls and the readings; of the last one, a row per scan."""
        return *self._crossings.arrays, *self._model.signal, *self._own, self._noise.numbers


@borrowing_kernel
def _is_heard(draw, deficit, chance):
    """Whether draw (1 + exp(deficit)) < chance; a bound of the exponential decides most cases."""
    bound = 1.0 + abs(deficit) + 0.5 * deficit * deficit  # <= exp(|deficit|)
    if draw * (1.0 + (bound if deficit > 0.0 else 0.0)) >= chance + _ROUNDING:
        return False
    if deficit < 0.0 and draw * (1.0 + 1.0 / bound) < chance - _ROUNDING:
        return True
    return draw * (1.0 + np.exp(deficit)) < chance


@borrowing_kernel
def _receive(rssi, fading, constants, draws, detection, all_macs, heard, macs, readings):
    """Replace mean RSSI (transmitters,) by readings, and list those detected in macs and readings; returns their count.

    draws (2 transmitters,): standard normal, then uniform in [0, 1).
    """
    device_offset, noise_std, step = constants[0], constants[1], constants[2]
    transmitters, count = rssi.shape[0], 0
    for t in range(transmitters):
        level = rssi[t] + fading[t] + device_offset + noise_std * draws[t]
        deficit = (detection[0, t] - level) / detection[1, t]
        heard[t] = _is_heard(draws[transmitters + t], deficit, detection[2, t])
        rssi[t] = min(step * np.floor(level / step + 0.5), _LEVEL_MAX_DBM)
        macs[count], readings[count] = all_macs[t], rssi[t]  # overwritten by the next if not heard
        count += int(heard[t])
    return count


@borrowing_kernel
def hear(
    robot, x, y, walls, origin, bucket, rows, columns, first, members, loss, points, low, numbers, certain_counts,
    certain_losses, first_uncertain, uncertain_walls, pose_home_building, boxes, waves, radios, parts, limits, scratch,
    detection, constants, fading, fading_places, fading_numbers, fading_used, fading_of, all_macs, crossed, rssi, heard,
    draws, bodies, macs, readings,
):  # fmt: skip
    """The scan of one robot at (x, y) among people, listed in macs and readings; returns the count.

    bodies (k, 5): what reaches into the line of sight, as of `lose_in_bodies`.
    `CrossingTable.prepare` must have been called for the position. crossed, rssi, heard and scratch are overwritten.
    """
    own, losses = constants[robot], scratch[3:]
    if (x - fading_places[robot, 0]) ** 2 + (y - fading_places[robot, 1]) ** 2 >= own[3] ** 2:
        fading_places[robot, 0], fading_places[robot, 1] = x, y
        number = min(fading_used[robot], fading_numbers.shape[0] - 1)
        fading_used[robot] = number + 1
        for t in range(fading.shape[1]):
            fading[robot, t] = own[4] * fading_numbers[number, robot, fading_of[t]]
    crossed_at(
        x, y, walls, origin, bucket, rows, columns, first, members, loss, points, low, numbers, certain_counts,
        certain_losses, first_uncertain, uncertain_walls, crossed, losses,
    )  # fmt: skip
    if bodies.shape[0] > 0:
        lose_in_bodies(x, y, boxes, crossed, bodies, losses)
    mean_rssi(x, y, losses, pose_home_building, boxes, waves, radios, parts, limits, scratch, rssi)
    return _receive(rssi, fading[robot], own, draws[robot], detection[robot], all_macs, heard, macs, readings)
