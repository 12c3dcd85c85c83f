"""Failures during an episode: robots that start late or stop for good, frames that are lost, outages of the link."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import FailureConfig
from twc_env.records.geometry import compose
from twc_env.records.messages import UNSEEN_M, Contacts, SensorFrame, WifiScan
from twc_env.records.random_streams import random_stream
from twc_env.records.team_messages import TeamFrames

_DEAF = WifiScan(np.zeros(0, np.int64), np.zeros(0))
"""A scan in which nothing was heard."""


class Failures:
    """Which robots work and which can communicate, per step."""

    def __init__(self, config: FailureConfig, starts_s: Sequence[float], time_step_s: float = 0.1):
        """starts_s: when each robot is switched on."""
        self._config, robots = config, len(starts_s)
        self._start_steps = np.round(np.array(starts_s) / time_step_s).astype(int)
        self._last_start = int(self._start_steps.max())
        has_outage = config.link_begin_step < config.link_end_step
        self.is_nothing = not (config.robots or has_outage or self._last_start or config.frame_loss_probability)
        """Whether there are no failures at all."""
        self._everyone = np.ones(robots, np.bool_)
        self._survivors = np.arange(robots) < robots - config.robots
        self._everyone.flags.writeable = self._survivors.flags.writeable = False

    def are_all_alive(self, step: int) -> bool:
        """Whether all robots work in this step."""
        return step >= self._last_start and not self._have_failed(step)

    def _have_failed(self, step: int) -> bool:
        return bool(self._config.robots) and step >= self._config.robots_step

    def is_alive(self, step: int) -> Array:
        """(robots,) bool, read-only: whether each robot moves, measures and communicates."""
        alive = self._survivors if self._have_failed(step) else self._everyone
        return alive if step >= self._last_start else alive & (step >= self._start_steps)

    def failed(self, step: int) -> list[int]:
        """The robots that have failed for good."""
        return np.flatnonzero(~self._survivors).tolist() if self._have_failed(step) else []

    def contacts(self, step: int, contacts: Contacts) -> Contacts:
        """The contacts of a step without those of failed robots; none during an outage of the link."""
        config = self._config
        if config.link_begin_step <= step < config.link_end_step:
            nobody = np.zeros_like(contacts.tried)
            return Contacts(nobody, nobody)
        if self.are_all_alive(step):
            return contacts
        alive = self.is_alive(step)
        talks = alive[None] & (alive[:, None] if len(contacts.tried) == len(alive) else True)
        return Contacts(contacts.tried & talks, contacts.heard & talks)


def silenced(frames: TeamFrames, is_alive: Array) -> TeamFrames:
    """The frames of a step with empty measurements for failed robots; is_alive (robots,) bool.

    A failed robot has an empty scan in every step, so that what it heard before does not count as heard now.
    """
    alive = is_alive.tolist()
    return TeamFrames(
        frames.step,
        frames.time_s,
        np.where(is_alive[:, None], frames.odometry, 0.0),
        np.where(is_alive, frames.turn_rates_rad_s, 0.0),
        np.where(is_alive[:, None], frames.ranges_m, UNSEEN_M),
        [scan if lives else _DEAF for scan, lives in zip(frames.wifi, alive, strict=True)],
        [signs if lives else () for signs, lives in zip(frames.signs, alive, strict=True)],
        frames.scanner,
        frames.has_scan,
        frames.beams,
    )


class OwnClocks:
    """The time of each robot's frames by its own clock, which begins anywhere and runs at a rate of its own."""

    def __init__(self, config: FailureConfig, robots: int, seed: int):
        offsets, rates = random_stream(seed, "clocks").standard_normal((2, robots))
        self._offsets_s, self._rates = (
            config.clock_offset_std_s * offsets,
            1.0 + 1e-6 * config.clock_skew_std_ppm * rates,
        )
        self.are_one = not (config.clock_offset_std_s or config.clock_skew_std_ppm)
        """Whether all robots have the same clock."""

    def timed(self, frames: Sequence[SensorFrame]) -> list[SensorFrame]:
        """The frames with the times that their robots know, and turn rates as the angle per their second."""
        return [
            replace(
                frame,
                time_s=float(self._offsets_s[frame.robot] + self._rates[frame.robot] * frame.time_s),
                turn_rate_rad_s=float(frame.turn_rate_rad_s / self._rates[frame.robot]),
            )
            for frame in frames
        ]


class FrameLoss:
    """Frames that do not reach the engine; the next one of the robot has the odometry since the last that did."""

    def __init__(self, probability: float, robots: int, seed: int):
        self.probability = probability
        self._random = random_stream(seed, "frame-loss")
        self._motions, self._turn_rates, self._steps = np.zeros((robots, 3)), np.zeros(robots), np.zeros(robots, int)
        """Of the frames lost since: odometry, sum of the turn rates, and their number."""

    def arriving(self, frames: Sequence[SensorFrame]) -> list[SensorFrame]:
        """The frames of a step that arrive. Once per step."""
        is_lost, arriving = self._random.random(len(self._motions)) < self.probability, []
        for frame in frames:
            robot = frame.robot
            motion = compose(self._motions[robot], frame.odometry)
            turns, count = self._turn_rates[robot] + frame.turn_rate_rad_s, self._steps[robot] + 1
            if is_lost[robot]:
                self._motions[robot], self._turn_rates[robot], self._steps[robot] = motion, turns, count
                continue
            if count > 1:
                frame = replace(frame, odometry=motion, turn_rate_rad_s=float(turns / count))
            self._motions[robot], self._turn_rates[robot], self._steps[robot] = 0.0, 0.0, 0
            arriving.append(frame)
        return arriving
