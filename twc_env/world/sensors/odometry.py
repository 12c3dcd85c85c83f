"""Odometry and gyro models of wheeled, legged and handheld platforms: systematic errors and noise (papers.md T1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import OdometryConfig
from twc_env.kernels.compiled import borrowing_kernel
from twc_env.records.random_streams import random_stream
from twc_env.world.motion.jolts import Jolts
from twc_env.world.sensors.noise import StepNoise


@dataclass(frozen=True, slots=True)
class OdometryPreset:
    """Errors of one platform at drift 1; biases are constant over an episode unless `odometry.variation` says else."""

    scale_std: float
    """Relative bias of distances."""
    heading_bias_std_rad_per_m: float
    """Heading bias per distance."""
    turn_scale_std: float
    """Relative bias of turns."""
    position_std_m: float
    """White noise over 1 m; grows with the square root of the distance."""
    heading_std_rad: float
    """White noise of the heading over 1 m; grows with the square root of the distance."""
    turn_std_rad: float
    """White noise of the heading over a turn of 1 rad; grows with the square root of the turn."""
    slips_per_m: float
    """Rate of slips."""
    slip_share: float
    """Maximum relative excess of the distance measured in a step with a slip."""
    gyro_bias_std_rad_s: float
    """Bias of the gyro's turn rate."""
    gyro_std_rad: float
    """White noise of the gyro's heading change per step."""
    scale_mean: float = 0.0
    """Mean relative bias of distances over episodes: a miscalibrated robot."""
    heading_bias_mean_rad_per_m: float = 0.0
    """Mean heading bias over episodes."""
    turn_scale_mean: float = 0.0
    """Mean relative bias of turns over episodes."""


# Median dead-reckoning error after 60 m through rooms and corridors: about 2 m wheeled, 2.5 m legged, 3.5 m handheld;
# after 60 m straight ahead, about 4.5 m wheeled.
PRESETS = {
    "wheeled": OdometryPreset(0.025, 0.004, 0.02, 0.03, 0.010, 0.02, 0.02, 0.5, 0.004, 0.002),
    "legged": OdometryPreset(0.035, 0.006, 0.025, 0.05, 0.015, 0.025, 0.05, 0.5, 0.006, 0.003),
    "handheld": OdometryPreset(0.045, 0.009, 0.03, 0.07, 0.022, 0.03, 0.0, 0.0, 0.008, 0.004),
    # Four wheels that slip sideways in turns (the Husky of papers.md R14): biases far exceed noise.
    "skid-steer": OdometryPreset(0.02, 0.004, 0.05, 0.03, 0.003, 0.01, 0.0, 0.0, 0.004, 0.002),
    # Raw odometry of the Intel Research Lab log, with a heading bias to the right; `reproduce odometry` compares both.
    "pioneer-intel": OdometryPreset(
        0.01, 0.0015, 0.01, 0.06, 0.025, 0.03, 0.0, 0.0, 0.004, 0.002, 0.012, -0.0645, 0.02
    ),
}


WAVES, PERIODS_S = 8, (20.0, 200.0)
"""A bias that varies is a sum of so many cosines of periods in this range, log-uniform."""


class Odometry:
    """The odometers and gyros of all robots for one episode."""

    def __init__(self, config: OdometryConfig | Sequence[OdometryConfig], time_step_s: float, robots: int, seed: int):
        """config: of all robots, or one for each."""
        own = [config] * robots if isinstance(config, OdometryConfig) else config
        presets, drift = [PRESETS[each.platform] for each in own], np.array([[each.drift] for each in own])
        self._time_step_s = time_step_s
        streams = [random_stream(seed, "odometry", robot) for robot in range(robots)]
        gyro_streams = [random_stream(seed, "gyro", robot) for robot in range(robots)]
        slip_streams = [random_stream(seed, "slip", robot) for robot in range(robots)]
        draws = np.array([stream.standard_normal(3) for stream in streams])
        gyro = np.array([stream.standard_normal() for stream in gyro_streams])
        spreads = [(each.scale_std, each.heading_bias_std_rad_per_m, each.turn_scale_std) for each in presets]
        means = [(each.scale_mean, each.heading_bias_mean_rad_per_m, each.turn_scale_mean, 0.0) for each in presets]
        gyro_spreads = np.array([each.gyro_bias_std_rad_s for each in presets])
        biases = np.column_stack([draws * np.array(spreads), gyro * gyro_spreads])  # (robots, 4)
        self._biases = drift * (biases + np.array(means))
        shares = np.array([[each.variation] for each in own])
        self.varies = bool(shares.any())
        """Whether `vary` changes anything."""
        if self.varies:
            self._spreads = drift * np.column_stack([np.array(spreads), gyro_spreads]) * np.sqrt(shares)
            self._steady = drift * (np.sqrt(1.0 - shares) * biases + np.array(means))
            wave_streams = [random_stream(seed, "odometry variation", robot) for robot in range(robots)]
            drawn = np.array([stream.random((2, WAVES, 4)) for stream in wave_streams])
            low, high = np.log(PERIODS_S)
            self._turns_per_step = time_step_s / np.exp(low + (high - low) * drawn[:, 0])
            self._phases = drawn[:, 1]
        self._slips_per_m = np.array([each.slips_per_m for each in presets]) * (drift[:, 0] > 0)
        white = [
            (each.position_std_m, each.heading_std_rad, each.turn_std_rad, each.slip_share, each.gyro_std_rad)
            for each in presets
        ]
        self._white = drift * np.array(white)
        self.jolts: Jolts | None = None
        """Set where robots have bumps or slip at thresholds."""
        self.noise = StepNoise(streams, 3).beside(gyro_streams, 1).beside(slip_streams, 2, "random")

    def measure(self, poses_before: Array, poses: Array) -> tuple[Array, Array]:
        """True poses (n, 3) at the last frame and now -> odometry (n, 3), gyro turn rate (n,) [rad/s]."""
        odometry, turn_rates = np.empty((len(poses), 3)), np.empty(len(poses))
        if self.varies:
            self.vary(self.noise.taken)
        *arguments, _ = self.arguments
        measure(poses_before, poses, *arguments, self.noise.next(), odometry, turn_rates)
        return odometry, turn_rates

    def vary(self, step: int) -> None:
        """Set the systematic errors to those of a step, in place."""
        waves = np.cos(2 * np.pi * (self._turns_per_step * step + self._phases))
        self._biases[:] = self._steady + self._spreads * np.sqrt(2.0 / WAVES) * waves.sum(axis=1)

    @property
    def arguments(self) -> tuple:
        """Arguments of `measure` between the poses and the outputs; of the last one, a row per step."""
        return self._biases, self._white, self._slips_per_m, self._time_step_s, self.noise.numbers


@borrowing_kernel
def measure(before, now, biases, white, slips_per_m, time_step, noise, odometry, turn_rates):
    """Fill odometry (n, 3) and turn_rates (n,) from true poses (n, 3) before and now.

    Rows of biases (n, 4), white (n, 5) and slips_per_m (n,) are of one robot. Columns of noise (n, 6): three standard
    normal for odometry, one for the gyro, and two uniform for slips.
    """
    for i in range(now.shape[0]):
        c, s = np.cos(before[i, 2]), np.sin(before[i, 2])
        wx, wy = now[i, 0] - before[i, 0], now[i, 1] - before[i, 1]
        dx, dy = c * wx + s * wy, -s * wx + c * wy
        turn = (now[i, 2] - before[i, 2] + np.pi) % (2.0 * np.pi) - np.pi
        distance = np.sqrt(dx * dx + dy * dy)
        scale = 1.0 + biases[i, 0]
        if noise[i, 4] < slips_per_m[i] * distance:
            scale += white[i, 3] * noise[i, 5]
        position_std = white[i, 0] * np.sqrt(distance)
        odometry[i, 0] = scale * dx + position_std * noise[i, 0]
        odometry[i, 1] = scale * dy + 0.5 * position_std * noise[i, 1]
        heading_std = np.sqrt(white[i, 1] * white[i, 1] * distance + white[i, 2] * white[i, 2] * abs(turn))
        odometry[i, 2] = turn * (1.0 + biases[i, 2]) + biases[i, 1] * distance + heading_std * noise[i, 2]
        turn_rates[i] = (turn + white[i, 4] * noise[i, 3]) / time_step + biases[i, 3]
