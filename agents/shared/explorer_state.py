"""Settings of an exploring team, and its state per robot."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.planning import Follower
from twc_env.records.geometry import transform_points


@dataclass(frozen=True, slots=True, kw_only=True)
class ExplorerConfig:
    """Settings of an exploring team."""

    check_s: float = 0.5
    """Period of checking goals and paths against the newest map, and of replanning if they are no longer valid."""
    replan_s: float = 4.0
    door_s: float = 1.0
    """Where there are doors, a robot without a frontier plans this often."""
    frontier_cells_min: int = 5
    """Smaller frontiers are visited only if no other is left."""
    frontier_cells_last: int = 3
    """Smaller frontiers are never visited."""
    small_penalty_m: float = 30.0
    claim_radius_m: float = 3.0
    """A frontier within this distance of a teammate's goal belongs to the teammate."""
    claim_penalty_m: float = 20.0
    change_penalty_m: float = 2.0
    """A robot changes its goal only for one that is this much nearer."""
    arrival_m: float = 0.3
    arrival_patience_s: float = 1.5
    """A frontier that still exists this long after arrival is given up."""
    stuck_s: float = 4.0
    stuck_m: float = 0.45
    """A robot that moved less than this in `stuck_s` is stuck."""
    jam_radius_m: float = 2.0
    """Being stuck again within this distance counts as the same jam ..."""
    jam_count_max: int = 4
    """... in which a robot backs off longer each time, up to this factor."""
    tries: int = 2
    """The team is not finished while a goal that failed less often than this waits for its next try."""
    retry_s: float = 20.0
    """A failed goal is excluded for this time, doubled after each further failure."""
    failed_radius_m: float = 0.8
    tour_spacing_m: float = 2.0
    tour_speed_m_s: float = 0.25
    """Detour on a tour that one second since the last visit is worth."""
    tour_sign_bonus_m: float = 20.0
    tour_arrival_m: float = 0.7
    squeeze: float = 0.6
    """A robot enclosed by its map plans with its radius multiplied by this."""
    finished_s: float = 5.0
    """The team is finished after this time without any goal ..."""
    finished_doors_s: float = 60.0
    """... and where doors open and close after this one: robots look once more into what was shut."""


UNSEEN = (-1, 0)
"""No map yet."""


@dataclass(slots=True, eq=False)
class Failure:
    """A goal that could not be reached."""

    place_m: Array
    until_step: int
    count: int = 1


@dataclass(slots=True, eq=False)
class ExplorerRobot:
    """State of one robot; all positions are in the map frame of its group."""

    follower: Follower
    pose: Array = field(default_factory=lambda: np.zeros(3))
    map_id: tuple[int, int] = UNSEEN
    """Changes whenever the map frame jumps: version of the map and number of teammates in it."""
    goal_m: Array = field(default_factory=lambda: np.zeros(2))
    goal_kind: str = ""
    """"frontier", "tour" (nothing is left to explore), "place" (for another purpose), "wait" (on the spot),
    "elsewhere" (another place of a closed room); "" when there is no goal."""
    goal_step: int = 0
    """Last step at which it had one."""
    step_before: int = -1
    """Step of the belief before."""
    arrived_step: int = -1
    stuck_count: int = 0
    track_m: list[Array] = field(default_factory=list)
    track_step: list[int] = field(default_factory=list)
    anchor: tuple[float, float, int] | None = None
    """Position (x, y) and step of its last progress; it is stuck if it stays there for long."""
    failures: list[Failure] = field(default_factory=list)
    obstacles: list[tuple[Array, int]] = field(default_factory=list)
    """Positions where it got stuck, with the step until which they are avoided."""
    escape_until: int = -1
    escape_bearing: float = 0.0
    replan: bool = True
    jam_m: Array | None = None
    """Position where it was last stuck."""
    jam_count: int = 0
    """How often in a row it was stuck near there."""
    is_idle: bool = False
    """The last plan found no frontier."""

    @property
    def radius_m(self) -> float:
        """Of the robot itself."""
        return self.follower.dynamics.robot_radius_m

    def comes_to_multiple(self, step: int, period: float) -> bool:
        """Whether this step is the first that it knows of at or after a multiple of a period [steps]: where frames are
        lost, beliefs skip steps."""
        whole = max(1, round(period))
        return step // whole > self.step_before // whole

    def move_frame(self, pose_new_old: Array) -> None:
        """After a jump of the map: transform all positions to the new frame, and replan."""

        def moved(place_m: Array) -> Array:
            return transform_points(pose_new_old, place_m[None])[0]

        self.track_m = list(transform_points(pose_new_old, np.array(self.track_m).reshape(-1, 2)))
        for failure in self.failures:
            failure.place_m = moved(failure.place_m)
        self.obstacles = [(moved(place), until) for place, until in self.obstacles]
        if self.anchor is not None:
            x, y = moved(np.array(self.anchor[:2]))
            self.anchor = (float(x), float(y), self.anchor[2])
        self.jam_m = None if self.jam_m is None else moved(self.jam_m)
        self.goal_m = moved(self.goal_m)
        if self.follower.has_path:
            self.follower.start(transform_points(pose_new_old, self.follower.path_m))
        self.replan = True

    def drop_goal(self) -> None:
        """Discard goal and path; the next step replans."""
        self.goal_kind, self.arrived_step, self.replan = "", -1, True
        self.follower.stop()
