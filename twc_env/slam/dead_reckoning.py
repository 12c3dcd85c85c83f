"""The engine of `slam.mode = "off"`: integrates odometry; no mapping, no loop closures, no merging."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, shared_config
from twc_env.errors import DataError
from twc_env.kernels.compiled import BindsAnew, borrowing_kernel, bound
from twc_env.records.messages import Belief, Contacts, Keyframe, SensorFrame
from twc_env.records.team_messages import TeamBeliefs, TeamFrames, nobody
from twc_env.slam.engine import View
from twc_env.slam.front_end.scan_intake import ScanIntake
from twc_env.slam.mapping.map_beliefs import HeldMaps, MapBeliefs
from twc_env.slam.team import TeamMapper


class DeadReckoning(BindsAnew):
    """The interface of `CooperativeSlam` without SLAM, for simulation alone and to measure the cost of the engine.

    Each robot is a group of its own whose map frame is its odom frame and whose map is empty. `team` is a mapper
    without keyframes: evaluation finds one group per robot, no closures and an empty map.
    """

    def __init__(self, config: EnvConfig, robot_count: int):
        config = shared_config(config)
        self.team = TeamMapper(config, robot_count)
        self.mappers = [self.team]
        self._everyone, self._intake = np.arange(robot_count), ScanIntake(config, robot_count)
        self._shape = robot_count, 3, 3
        self._poses = np.zeros(self._shape)
        """(robots, 3, 3) as `TeamBeliefs.poses`."""
        self._latest_scans: tuple[list[int], list[Array] | Array] = [0] * robot_count, [np.zeros(0)] * robot_count
        """Step of each robot's latest scan, and that scan."""
        empty, signs = self.team.grid_of(0), self.team.signs_of(0)
        maps: HeldMaps = [empty] * robot_count, [signs] * robot_count, [0] * robot_count, [None] * robot_count
        self._constant = np.zeros(robot_count), maps, *nobody(robot_count)
        """Constant fields of `MapBeliefs`: drift, maps, teammates, their poses and contact steps."""
        self._views = [View(self.team, k, group.robots) for k, group in enumerate(self.team.groups)]
        self.bytes_sent: dict[str, int] = {}
        """Empty: no messages."""
        self._beliefs: MapBeliefs | None = None
        """The beliefs, once requested, until the next frames."""
        self._run: Callable[..., None] | None = None
        """`_integrate` bound to all robots."""

    def give_transmitters(self, macs: Array, position_m: Array, start_poses: Array) -> None:
        """Does nothing."""

    def lasting_map(self) -> NoReturn:
        """Raises DataError: there is no map."""
        raise DataError("slam.mode is 'off': there is no map to save; use the engine")

    @property
    def unsaved_robots(self) -> tuple[int, ...]:
        """Empty: no robot has a map."""
        return ()

    def found_prior(self, robot: int) -> bool:
        """False: no robot shares a map."""
        return False

    def give_starts(self, poses: Array) -> None:
        """Does nothing."""

    def track(self, frames: Sequence[SensorFrame]) -> list[Keyframe]:
        """Integrate the odometry of each frame; returns no keyframes."""
        frames, circles = self._intake.on_circle(frames)
        team, robots, before = TeamFrames.of(frames), self._everyone, self._poses
        if len(team.signs) == len(robots):
            self._latest_scans = [team.step] * len(robots), circles
        else:
            robots = np.array([frame.robot for frame in frames])
            steps, scans = map(list, self._latest_scans)  # copies: earlier beliefs refer to the old lists
            for robot, circle in zip(robots.tolist(), circles, strict=True):
                steps[robot], scans[robot] = team.step, circle
            self._latest_scans = steps, scans
        self._poses = np.empty(self._shape)
        moves = team.odometry, before, self._poses
        if robots is not self._everyone:
            _integrate(robots, *moves)
        else:
            if self._run is None:
                self._run = bound(_integrate, robots, *moves)
            self._run(*moves)
        self._beliefs = None
        return []

    def mapper_of(self, robot: int) -> TeamMapper:
        """The empty mapper."""
        return self.team

    def views(self) -> list[View]:
        """One view of an empty map per robot."""
        return self._views

    def lacked(self) -> list[str]:
        """One line: there is no engine."""
        return ["no engine: odometry alone"]

    def absorb(self, step: int, contacts: Contacts | None = None) -> None:
        """Does nothing: there are no messages."""

    def finish(self) -> None:
        """Does nothing: nothing is queued."""

    def update(self, frames: Sequence[SensorFrame], contacts: Contacts | None = None) -> None:
        """`track`."""
        self.track(frames)

    @property
    def poses_odom(self) -> Array:
        """(robots, 3) integrated odometry, each in the robot's odom frame, where it starts at (0, 0, 0)."""
        return self._poses[:, 2]

    def pose_map_robot(self, robot: int) -> Array:
        """(3,) integrated odometry of a robot; its map frame is its odom frame."""
        return self._poses[robot, 0]

    def beliefs(self) -> TeamBeliefs:
        """Beliefs of all robots: integrated odometry, empty maps, no teammates and no signs."""
        if self._beliefs is None:
            self._beliefs = MapBeliefs(self._poses, *self._constant, *self._latest_scans)
        return self._beliefs

    def belief(self, robot: int) -> Belief:
        """Belief of one robot."""
        return self.beliefs()[robot]


@borrowing_kernel
def _integrate(robots, motions, before, poses):
    """Write poses (all robots, 3, 3) as of `TeamBeliefs.poses`: before, with robots (k,) moved by motions (k, 3).

    Motions are in the robot frame. Odom and map frame coincide.
    """
    for robot in range(poses.shape[0]):
        for row in range(3):
            for axis in range(3):
                poses[robot, row, axis] = before[robot, row, axis]
    for k in range(robots.shape[0]):
        pose = poses[robots[k], 2]
        c, s = math.cos(pose[2]), math.sin(pose[2])
        ahead, left = motions[k, 0], motions[k, 1]
        pose[0] = pose[0] + c * ahead - s * left
        pose[1] = pose[1] + s * ahead + c * left
        pose[2] = (pose[2] + motions[k, 2] + math.pi) % (2.0 * math.pi) - math.pi
        for j in range(3):
            poses[robots[k], 0, j] = pose[j]
