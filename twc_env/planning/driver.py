"""Drive one robot to a goal on its estimated map, for agents: `Drivers` of a team of one."""

from __future__ import annotations

from collections.abc import Callable

from numpy.typing import NDArray as Array

from twc_env.config import DynamicsConfig
from twc_env.planning.drivers import ARRIVAL_M, Drivers
from twc_env.planning.path_finder import PathFinder
from twc_env.planning.terrain import Terrain
from twc_env.records.messages import Belief


class Driver:
    """Drives one robot to the goal given to `start`; `command` returns the speeds of the next tick."""

    def __init__(
        self, dynamics: DynamicsConfig, finder: PathFinder, waits_for_people: bool = False, feels: bool = False
    ):
        """waits_for_people, feels: as of `Drivers`."""
        self._drivers = Drivers([dynamics], finder, waits_for_people, feels)

    @property
    def status(self) -> str:
        """As `Drivers.status`."""
        return self._drivers.status(0)

    def start(self, goal_m: Array, belief: Belief, kind: str = "place", arrival_m: float = ARRIVAL_M) -> None:
        """As `Drivers.start`."""
        self._drivers.start(0, goal_m, belief, kind, arrival_m)

    def stop(self) -> None:
        """Drop the goal."""
        self._drivers.stop(0)

    def command(self, belief: Belief, terrain_of: Callable[[Belief, float], Terrain]) -> tuple[float, float]:
        """Speed [m/s] and turn rate [rad/s] for the next tick, as `Drivers.commands`."""
        speed, turn_rate = self._drivers.commands([belief], terrain_of)[0].tolist()
        return speed, turn_rate
