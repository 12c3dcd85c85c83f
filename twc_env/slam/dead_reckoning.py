"""The engine of `slam.mode = "off"`: odometry is summed up, nothing is mapped, nobody is recognised."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twc_env.config import EnvConfig
from twc_env.messages import Belief, Contacts, Keyframe, SensorFrame
from twc_env.slam.engine import View
from twc_env.slam.team import TeamMapper

Array = NDArray


class Reckoner:
    """Stands where a robot's front end stands: the sum of its odometry since the first frame."""

    __slots__ = ("_pose", "pose_odom", "robot")

    def __init__(self, robot: int):
        self.robot = robot
        self._pose = 0.0, 0.0, 0.0
        self.pose_odom = np.zeros(3)
        """(3,) in the robot's own odom frame (it starts at 0, 0, 0); a new read-only array with every frame."""

    def update(self, frame: SensorFrame) -> None:
        """Add the motion of one frame."""
        x, y, heading = self._pose
        ahead, left, turn = frame.odometry.tolist()
        c, s = math.cos(heading), math.sin(heading)
        heading = (heading + turn + math.pi) % (2 * math.pi) - math.pi
        self._pose = x + c * ahead - s * left, y + s * ahead + c * left, heading
        self.pose_odom = np.array(self._pose)
        self.pose_odom.flags.writeable = False  # beliefs show it to planners


class DeadReckoning:
    """`CooperativeSlam`'s interface with no SLAM behind it, for worlds without an engine and for the cost of one.

    Each robot stays alone in a map frame that is its odom frame; its map stays empty. `team` is a mapper that never
    hears of a keyframe, so whatever judges an episode finds one group per robot, no closure and nothing mapped.
    """

    def __init__(self, config: EnvConfig, robot_count: int):
        self.robots = [Reckoner(robot) for robot in range(robot_count)]
        self.team = TeamMapper(config, robot_count)
        self.mappers = [self.team]
        self._grid = self.team.grid_of(0)
        self._frames: list[SensorFrame | None] = [None] * robot_count

    def give_transmitters(self, macs: Array, position_m: Array, start_poses: Array) -> None:
        """Nothing is made of transmitters here."""

    def give_starts(self, poses: Array) -> None:
        """Nothing is merged here."""

    def track(self, frames: Sequence[SensorFrame]) -> list[Keyframe]:
        """Sum up the odometry of each frame's robot; there are never keyframes to send."""
        for frame in frames:
            self._frames[frame.robot] = frame
            self.robots[frame.robot].update(frame)
        return []

    @property
    def bytes_sent(self) -> dict[str, int]:
        """Nothing is sent."""
        return {}

    def mapper_of(self, robot: int) -> TeamMapper:
        """The mapper that maps nothing."""
        return self.team

    def views(self) -> list[View]:
        """One empty map per robot."""
        return [View(self.team, k, group.robots) for k, group in enumerate(self.team.groups)]

    def lacked(self) -> list[str]:
        """Everything but odometry."""
        return ["no engine: odometry alone"]

    def absorb(self, step: int, contacts: Contacts | None = None) -> None:
        """Nothing arrives."""

    def finish(self) -> None:
        """Nothing waits."""

    def update(self, frames: Sequence[SensorFrame], contacts: Contacts | None = None) -> None:
        """The same as `track`."""
        self.track(frames)

    @property
    def poses_odom(self) -> Array:
        """(robots, 3) dead reckoning of all robots."""
        return np.array([robot.pose_odom for robot in self.robots])

    def pose_map_robot(self, robot: int) -> Array:
        """(3,) dead reckoning of a robot, in the frame it started in."""
        return self.robots[robot].pose_odom

    def belief(self, robot: int, with_signs: bool = True) -> Belief:
        """Where dead reckoning places the robot, on an empty map, with no mates and no signs."""
        frame, pose = self._frames[robot], self.robots[robot].pose_odom
        step, ranges_m = (frame.step, frame.ranges_m) if frame is not None else (0, np.zeros(0))
        return Belief(robot, step, pose, self._grid, ranges_m=ranges_m, pose_odom=pose)
