"""The engine of `slam.mode = "off"`: odometry is summed up, nothing is mapped, nobody is recognised."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.kernels import BindsAnew, borrowing_kernel, bound
from twc_env.messages import Belief, Contacts, Keyframe, SensorFrame
from twc_env.slam.engine import View
from twc_env.slam.team import TeamMapper
from twc_env.team_messages import TeamBeliefs, TeamFrames, nobody, read_only


class DeadReckoning(BindsAnew):
    """`CooperativeSlam`'s interface with no SLAM behind it, for worlds without an engine and for the cost of one.

    Each robot stays alone in a map frame that is its odom frame; its map stays empty. `team` is a mapper that never
    hears of a keyframe, so whatever judges an episode finds one group per robot, no closure and nothing mapped.
    """

    def __init__(self, config: EnvConfig, robot_count: int):
        self.team = TeamMapper(config, robot_count)
        self.mappers = [self.team]
        self._grid = self.team.grid_of(0)
        self._everyone = np.arange(robot_count)
        self._shape = robot_count, 3, 3
        self._poses = np.zeros(self._shape)
        """(robots, 3, 3) as `TeamBeliefs.poses`."""
        self._ranges_m: list[Array] | Array = [np.zeros(0)] * robot_count
        self._steps: Sequence[int] | int = 0
        """The latest scan of each robot, and when it was taken: one number for all that sensed together."""
        grids = [self._grid] * robot_count
        self._rest = np.zeros(robot_count), grids, [()] * robot_count, *nobody(robot_count)
        """What all beliefs have in common."""
        self._views = [View(self.team, k, group.robots) for k, group in enumerate(self.team.groups)]
        self.bytes_sent: dict[str, int] = {}
        """Nothing is sent."""
        self._alone: _Alone | None = None
        self._run: Callable[..., None] | None = None
        """`_chain` for everyone."""

    def give_transmitters(self, macs: Array, position_m: Array, start_poses: Array) -> None:
        """Nothing is made of transmitters here."""

    def give_starts(self, poses: Array) -> None:
        """Nothing is merged here."""

    def track(self, frames: Sequence[SensorFrame]) -> list[Keyframe]:
        """Sum up the odometry of each frame's robot; there are never keyframes to send."""
        team, robots, before = TeamFrames.of(frames), self._everyone, self._poses
        if len(team.signs) == len(robots):
            self._ranges_m, self._steps = team.ranges_m, team.step
        else:
            robots = np.array([frame.robot for frame in frames])
            steps = self._steps
            self._ranges_m = list(self._ranges_m)
            self._steps = [steps] * len(self._everyone) if isinstance(steps, int) else list(steps)
            for robot, ranges_m in zip(robots.tolist(), team.ranges_m, strict=True):
                self._ranges_m[robot], self._steps[robot] = ranges_m, team.step
        self._poses = np.empty(self._shape)
        moves = team.odometry, before, self._poses
        if robots is not self._everyone:
            _chain(robots, *moves)
        else:
            if self._run is None:
                self._run = bound(_chain, robots, *moves)
            self._run(*moves)
        self._alone = None
        return []

    def mapper_of(self, robot: int) -> TeamMapper:
        """The mapper that maps nothing."""
        return self.team

    def views(self) -> list[View]:
        """One empty map per robot."""
        return self._views

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
        """(robots, 3) dead reckoning of all robots, each in the odom frame where it starts at (0, 0, 0)."""
        return self._poses[:, 2]

    def pose_map_robot(self, robot: int) -> Array:
        """(3,) dead reckoning of a robot, in the frame it started in."""
        return self._poses[robot, 0]

    def beliefs(self) -> TeamBeliefs:
        """Where dead reckoning places the robots, each on an empty map, with no mates and no signs."""
        if self._alone is None:
            self._alone = _Alone(self._poses, self._rest, self._steps, self._ranges_m)
        return self._alone

    def belief(self, robot: int) -> Belief:
        """The same of one robot."""
        return self.beliefs()[robot]


class _Alone(TeamBeliefs):
    """The beliefs of robots that know nobody."""

    __slots__ = ("_ranges_m", "_steps")

    def __init__(self, poses: Array, rest: tuple, steps: Sequence[int] | int, ranges_m: Sequence[Array] | Array):
        # Instead of the parent's: made in every step, which is all that an environment without an engine does here.
        self._records, self.poses = None, poses
        self.since_closure_m, self.grids, self.signs, self.mates, self.mate_poses, self.contact_steps = rest
        self._steps, self._ranges_m = steps, ranges_m

    def _make(self) -> list[Belief]:
        beliefs, poses, all_ranges_m = [], read_only(self.poses), self._ranges_m
        steps = [self._steps] * len(self) if isinstance(self._steps, int) else self._steps
        if isinstance(all_ranges_m, np.ndarray):
            all_ranges_m = read_only(all_ranges_m)
        for robot, (step, ranges_m, grid) in enumerate(zip(steps, all_ranges_m, self.grids, strict=True)):
            in_map, std, in_odom = poses[robot]
            belief = Belief(robot, step, in_map, grid, ranges_m=ranges_m, pose_odom=in_odom, pose_std=std)
            beliefs.append(belief)
        return beliefs


@borrowing_kernel
def _chain(robots, motions, before, poses):
    """Move the poses of robots (k,) in odom and map, which are one here, by motions (k, 3) seen from them."""
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
