"""Failures during an episode: robots that stop permanently, and a temporary outage of the radio link."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import FailureConfig
from twc_env.records.messages import UNSEEN_M, Contacts, WifiScan
from twc_env.records.team_messages import TeamFrames

_DEAF = WifiScan(np.zeros(0, np.int64), np.zeros(0))
"""A scan in which nothing was heard."""


class Failures:
    """Which robots work and which can communicate, per step."""

    def __init__(self, config: FailureConfig, robots: int):
        self._config = config
        self.is_nothing = not config.robots and config.link_begin_step >= config.link_end_step
        """Whether there are no failures at all."""
        self._everyone = np.ones(robots, np.bool_)
        self._survivors = np.arange(robots) < robots - config.robots
        self._everyone.flags.writeable = self._survivors.flags.writeable = False

    def are_all_alive(self, step: int) -> bool:
        """Whether no robot has failed up to this step."""
        return not self._config.robots or step < self._config.robots_step

    def is_alive(self, step: int) -> Array:
        """(robots,) bool, read-only: whether each robot moves, measures and communicates."""
        return self._everyone if self.are_all_alive(step) else self._survivors

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
    )
