"""The communication link: which robots' transmissions reach which listeners in a step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import LinkConfig
from twc_env.records.messages import Contacts
from twc_env.world.building.wall_index import WallIndex


class Link:
    """Contacts from true positions, by range, walls and random loss; the messages are the engine's."""

    def __init__(self, config: LinkConfig, robots: int, walls: WallIndex, random: np.random.Generator):
        self._config, self._walls, self._random = config, walls, random
        listeners = robots if config.topology == "peer" else 1
        self._always = np.ones((listeners, robots), bool)
        if config.topology == "peer":
            np.fill_diagonal(self._always, False)
        is_sure = config.topology != "peer" and config.loss_probability == 0.0
        self.constant = Contacts(self._always, self._always) if is_sure else None
        """The contacts of every step; None if they depend on positions or random loss."""

    def contacts(self, poses: Array) -> Contacts:
        """The contacts of one step at true poses (robots, 2 or 3) in the frame of the walls."""
        config = self._config
        tried = self._in_range(poses[:, :2]) if config.topology == "peer" else self._always
        if config.loss_probability == 0.0:
            return Contacts(tried, tried)
        return Contacts(tried, tried & (self._random.random(tried.shape) >= config.loss_probability))

    def _in_range(self, positions_m: Array) -> Array:
        """(robots, robots) bool, symmetric: distance plus `wall_range_m` per wall is within the range."""
        apart_m = np.hypot(*(positions_m[:, None] - positions_m[None]).T)
        if self._config.wall_range_m > 0.0:
            apart_m = apart_m + self._config.wall_range_m * self._walls_between(positions_m)
        return self._always & (apart_m <= self._config.range_max_m)

    def _walls_between(self, positions_m: Array) -> Array:
        counts = np.zeros((len(positions_m), len(positions_m)))
        for first in range(len(positions_m) - 1):
            later = np.ascontiguousarray(positions_m[first + 1 :])
            counts[first, first + 1 :] = self._walls.crossing(positions_m[first], later)[0]
        return counts + counts.T
