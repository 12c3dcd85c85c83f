"""Keep the wall on the right, at an even distance: the walk of inverse k-visibility's experiments."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.messages import Belief
from twc_env.planning import as_action, drive_to

STANDOFF_M = 0.35
GAIN_RAD_M = 3.0
"""How sharply it turns to or from the wall, per metre that the distance is wrong."""
TURN_MAX_RAD = 0.9
RIGHT_RAD, AHEAD_RAD = -2.6, 0.7
"""The sector in which the wall is looked for: from behind on the right to a little left of ahead."""
AIM_M = 0.5
ROUND_M, LEFT_M = 0.7, 3.0
"""A round is done within this distance of its start, once the robot has been this far from it."""


class WallFollower:
    """Drives straight until there is a wall, then along it; finished when every robot has come round."""

    def __init__(self, config: EnvConfig):
        self._dynamics = config.dynamics
        self.reset(0, ())

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Forget everything."""
        self._start: dict[str, Array] = {}
        self._has_left: set[str] = set()
        self._done: set[str] = set()

    def act(self, beliefs: dict[str, Belief]) -> dict[str, Array]:
        """Along the wall, for every robot."""
        return {agent: self._follow(agent, belief) for agent, belief in beliefs.items()}

    def finished(self, beliefs: dict[str, Belief]) -> bool:
        """Whether all are back where each first met its wall."""
        return bool(beliefs) and all(agent in self._done for agent in beliefs)

    def _follow(self, agent: str, belief: Belief) -> Array:
        bearing, distance_m = nearest_wall(belief.ranges_m)
        if distance_m > 2 * STANDOFF_M and agent not in self._start:
            heading = 0.0 if not math.isfinite(distance_m) else bearing
        else:
            self._note_round(agent, belief)
            turn = np.clip(GAIN_RAD_M * (STANDOFF_M - distance_m), -TURN_MAX_RAD, TURN_MAX_RAD)
            heading = math.remainder(bearing + math.pi / 2 + float(turn), 2 * math.pi)
        speed, turn_rate = drive_to(
            AIM_M * math.cos(heading), AIM_M * math.sin(heading), belief.ranges_m, self._dynamics
        )
        return as_action(speed, turn_rate, self._dynamics)

    def _note_round(self, agent: str, belief: Belief) -> None:
        """Rounds are told by dead reckoning, which never jumps."""
        here = np.asarray(belief.pose_odom[:2], float)
        away_m = math.dist(here, self._start.setdefault(agent, here.copy()))
        if away_m > LEFT_M:
            self._has_left.add(agent)
        elif away_m < ROUND_M and agent in self._has_left:
            self._done.add(agent)


def nearest_wall(ranges_m: Array | None) -> tuple[float, float]:
    """Bearing [rad] and distance [m] of the nearest return on the right or ahead; infinite where there is none."""
    if ranges_m is None or len(ranges_m) == 0:
        return 0.0, math.inf
    bearings = np.arange(len(ranges_m)) * (2 * math.pi / len(ranges_m))
    bearings = np.where(bearings > math.pi, bearings - 2 * math.pi, bearings)
    inside = (bearings >= RIGHT_RAD) & (bearings <= AHEAD_RAD) & (ranges_m > 0)
    if not inside.any():
        return 0.0, math.inf
    nearest = int(np.argmin(np.where(inside, ranges_m, np.inf)))
    return float(bearings[nearest]), float(ranges_m[nearest])
