"""Wall following at a constant distance, with the wall on the right, as in the experiments of inverse k-visibility.

In a pocket narrower than twice that distance, the wall ahead and those beside it are nearest in turn. A robot that has
not moved for a while drives to where there is room, and follows what it meets there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, robot_configs
from twc_env.planning import as_action, drive_to
from twc_env.records.messages import Belief

from ..shared.beginning import Beginning
from ..shared.openings import open_bearing

STANDOFF_M = 0.35
GAIN_RAD_M = 3.0
"""Turn towards or away from the wall per metre of distance error."""
TURN_MAX_RAD = 0.9
RIGHT_RAD, AHEAD_RAD = -2.6, 0.7
"""Sector in which the wall is searched: from right behind to slightly left of ahead."""
AIM_M = 0.5
ROUND_M, LEFT_M = 0.7, 3.0
"""A round ends within the first distance of its start, after the robot was farther away than the second."""
STUCK_S, STUCK_M, ESCAPE_S = 8.0, 0.45, 2.0
"""A robot that moved less than this in this time, longer than people usually stand in its way, drives to open floor for
the last one."""


class WallFollower:
    """Drives straight to a wall, then along it; finished when every robot has completed a round."""

    def __init__(self, config: EnvConfig):
        self._own = [own.dynamics for own in robot_configs(config)]
        self._step_s = config.dynamics.time_step_s
        self.reset(0, ())

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Discard all state; the seed is used only by robots that are stuck."""
        self._random = np.random.default_rng(seed)
        self._beginning = Beginning(agents)
        self._anchor: dict[str, tuple[Array, int]] = {}
        self._escape: dict[str, tuple[float, int]] = {}
        self._start: dict[str, Array] = {}
        self._has_left: set[str] = set()
        self._done: set[str] = set()

    def act(self, beliefs: dict[str, Belief]) -> dict[str, Array]:
        """Follow the wall with every robot. Raises TwcError as `Beginning.check`."""
        self._beginning.check(beliefs)
        return {agent: self._follow(agent, belief) for agent, belief in beliefs.items()}

    def finished(self, beliefs: dict[str, Belief]) -> bool:
        """Whether all robots are back where they first reached a wall."""
        return bool(beliefs) and all(agent in self._done for agent in beliefs)

    def _follow(self, agent: str, belief: Belief) -> Array:
        own = self._own[belief.robot]
        if self._is_escaping(agent, belief):
            heading = self._escape[agent][0] - float(belief.pose_odom[2])
        else:
            heading = self._along_wall(agent, belief)
        speed, turn_rate = drive_to(AIM_M * math.cos(heading), AIM_M * math.sin(heading), belief.ranges_m, own)
        return as_action(speed, turn_rate, own)

    def _is_escaping(self, agent: str, belief: Belief) -> bool:
        """Whether the robot drives to open floor; begins to if it is stuck, by dead reckoning."""
        step, here = belief.step, np.asarray(belief.pose_odom[:2], float)
        if step < self._escape.get(agent, (0.0, -1))[1]:
            return True
        anchor = self._anchor.setdefault(agent, (here, step))
        if math.dist(here, anchor[0]) > STUCK_M:
            self._anchor[agent] = here, step
        elif (step - anchor[1]) * self._step_s >= STUCK_S:
            bearing = float(belief.pose_odom[2]) + open_bearing(belief.ranges_m, self._random)
            self._escape[agent] = bearing, step + round(ESCAPE_S / self._step_s)
            del self._anchor[agent]
            return True
        return False

    def _along_wall(self, agent: str, belief: Belief) -> float:
        """Heading [rad] to the wall, or along it."""
        bearing, distance_m = nearest_wall(belief.ranges_m)
        if distance_m > 2 * STANDOFF_M and agent not in self._start:
            return 0.0 if not math.isfinite(distance_m) else bearing
        self._note_round(agent, belief)
        turn = np.clip(GAIN_RAD_M * (STANDOFF_M - distance_m), -TURN_MAX_RAD, TURN_MAX_RAD)
        return math.remainder(bearing + math.pi / 2 + float(turn), 2 * math.pi)

    def _note_round(self, agent: str, belief: Belief) -> None:
        """Update the progress of the round, from dead reckoning, which never jumps."""
        here = np.asarray(belief.pose_odom[:2], float)
        away_m = math.dist(here, self._start.setdefault(agent, here.copy()))
        if away_m > LEFT_M:
            self._has_left.add(agent)
        elif away_m < ROUND_M and agent in self._has_left:
            self._done.add(agent)


def nearest_wall(ranges_m: Array | None) -> tuple[float, float]:
    """Bearing [rad] and distance [m] of the nearest return in the sector; infinite distance if there is none."""
    if ranges_m is None or len(ranges_m) == 0:
        return 0.0, math.inf
    bearings = np.arange(len(ranges_m)) * (2 * math.pi / len(ranges_m))
    bearings = np.where(bearings > math.pi, bearings - 2 * math.pi, bearings)
    inside = (bearings >= RIGHT_RAD) & (bearings <= AHEAD_RAD) & (ranges_m > 0)
    if not inside.any():
        return 0.0, math.inf
    nearest = int(np.argmin(np.where(inside, ranges_m, np.inf)))
    return float(bearings[nearest]), float(ranges_m[nearest])
