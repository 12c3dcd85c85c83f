"""The engine of `slam.mode = "off"`: odometry is summed up, nothing is mapped, nobody is recognised."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from twc_env.config import EnvConfig
from twc_env.messages import Belief, Contacts, Keyframe, SensorFrame
from twc_env.slam.engine import View
from twc_env.slam.team import TeamMapper

Array = NDArray


class DeadReckoning:
    """`CooperativeSlam`'s interface with no SLAM behind it, for worlds without an engine and for the cost of one.

    Each robot stays alone in a map frame that is its odom frame; its map stays empty. `team` is a mapper that never
    hears of a keyframe, so whatever judges an episode finds one group per robot, no closure and nothing mapped.
    """

    def __init__(self, config: EnvConfig, robot_count: int):
        self.team = TeamMapper(config, robot_count)
        self.mappers = [self.team]
        self._grid = self.team.grid_of(0)
        self._frames: list[SensorFrame | None] = [None] * robot_count
        self._everyone = np.arange(robot_count)
        self._set_poses(np.zeros((robot_count, 3)))

    def _set_poses(self, poses: Array) -> None:
        poses.flags.writeable = False  # beliefs show them to planners
        self.poses_odom = poses
        """(robots, 3) dead reckoning of all robots, each in the odom frame where it starts at (0, 0, 0)."""
        self._rows = list(poses)

    def give_transmitters(self, macs: Array, position_m: Array, start_poses: Array) -> None:
        """Nothing is made of transmitters here."""

    def give_starts(self, poses: Array) -> None:
        """Nothing is merged here."""

    def track(self, frames: Sequence[SensorFrame]) -> list[Keyframe]:
        """Sum up the odometry of each frame's robot; there are never keyframes to send."""
        for frame in frames:
            self._frames[frame.robot] = frame
        is_complete = len(frames) == len(self._everyone)
        robots = self._everyone if is_complete else np.array([frame.robot for frame in frames], np.int64)
        poses = self.poses_odom.copy()
        _chain(robots, np.concatenate([frame.odometry for frame in frames]), poses)
        self._set_poses(poses)
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

    def pose_map_robot(self, robot: int) -> Array:
        """(3,) dead reckoning of a robot, in the frame it started in."""
        return self._rows[robot]

    def belief(self, robot: int, with_signs: bool = True) -> Belief:
        """Where dead reckoning places the robot, on an empty map, with no mates and no signs."""
        frame, pose = self._frames[robot], self._rows[robot]
        step, ranges_m = (frame.step, frame.ranges_m) if frame is not None else (0, _NO_RANGES)
        return Belief(robot, step, pose, self._grid, {}, (), ranges_m, 0, pose, _CERTAIN, 0.0, {}, None, _NO_PLACES)


_CERTAIN, _NO_RANGES, _NO_PLACES = np.zeros(3), np.zeros(0), np.zeros((0, 2))
for _shared in (_CERTAIN, _NO_RANGES, _NO_PLACES):
    _shared.flags.writeable = False


@njit(cache=True, error_model="numpy")
def _chain(robots, motions, poses):
    """Move poses (robots, 3), in place, by the motions (3 numbers for each of `robots`) seen from them."""
    for k in range(robots.shape[0]):
        pose = poses[robots[k]]
        c, s = math.cos(pose[2]), math.sin(pose[2])
        ahead, left = motions[3 * k], motions[3 * k + 1]
        pose[0] = pose[0] + c * ahead - s * left
        pose[1] = pose[1] + s * ahead + c * left
        pose[2] = (pose[2] + motions[3 * k + 2] + math.pi) % (2.0 * math.pi) - math.pi
