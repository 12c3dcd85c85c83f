"""What breaks in mid-episode: robots that stop for good, and a radio link that is down for a while."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twc_env.config import FailureConfig
from twc_env.messages import Contacts

Array = NDArray


class Failures:
    """Knows, step by step, who still works and who can talk."""

    def __init__(self, config: FailureConfig, robots: int):
        self._config = config
        self._is_last = np.arange(robots) >= robots - config.robots

    def is_alive(self, step: int) -> Array:
        """(robots,) bool: whether each still moves, senses and talks."""
        return ~self._is_last | (step < self._config.robots_step)

    def contacts(self, step: int, contacts: Contacts) -> Contacts:
        """What is left of the contacts of a step: the dead neither speak nor hear, and in a cut nobody does."""
        config = self._config
        if config.link_begin_step <= step < config.link_end_step:
            nobody = np.zeros_like(contacts.tried)
            return Contacts(nobody, nobody)
        alive = self.is_alive(step)
        if alive.all():
            return contacts
        talks = alive[None] & (alive[:, None] if len(contacts.tried) == len(alive) else True)
        return Contacts(contacts.tried & talks, contacts.heard & talks)
