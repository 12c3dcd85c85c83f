"""The whole cooperative SLAM engine: sensor frames in, beliefs out. It needs no world: recorded frames will do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twc_env.config import EnvConfig
from twc_env.geometry import compose
from twc_env.messages import Belief, Keyframe, SensorFrame
from twc_env.slam.robot import FrontEnds
from twc_env.slam.team import TeamMapper

Array = NDArray


class CooperativeSlam:
    """One front end per robot and the team's mapper.

    `track` runs the front ends and gives the keyframes to send; `absorb` takes in those that arrived. `update` does
    both where nothing lies between.
    """

    def __init__(self, config: EnvConfig, robot_count: int):
        self._front_ends = FrontEnds(config, robot_count)
        self.robots = self._front_ends.robots
        self.team = TeamMapper(config, robot_count)
        self._frames: list[SensorFrame | None] = [None] * robot_count
        self._poses_map_robot = [np.zeros(3)] * robot_count
        self._last_step = 0

    def track(self, frames: Sequence[SensorFrame]) -> list[Keyframe]:
        """Run the front end of each frame's robot; the keyframes that came of it, in order."""
        for frame in frames:
            self._frames[frame.robot] = frame
        return self._front_ends.update(frames)

    def absorb(self, step: int, keyframes: list[Keyframe]) -> None:
        """Take the keyframes that reached the mapper into the team's map."""
        self._last_step = step
        self.team.update(step, keyframes)
        self._poses_map_robot = [
            compose(self.team.pose_map_odom(robot), front_end.pose_odom) for robot, front_end in enumerate(self.robots)
        ]
        for pose in self._poses_map_robot:
            pose.flags.writeable = False  # beliefs show it to planners

    def finish(self) -> None:
        """Work off all that waits in the team's mapper (end of an episode or log)."""
        self.team.finish()
        self.absorb(self._last_step, [])

    def update(self, frames: Sequence[SensorFrame]) -> None:
        """`track` and `absorb` at once, for logs and perfect links."""
        self.absorb(frames[0].step, self.track(frames))

    def pose_map_robot(self, robot: int) -> Array:
        """(3,) estimate of a robot in its group's map frame, as of the last `absorb`."""
        return self._poses_map_robot[robot]

    def belief(self, robot: int, with_signs: bool = True) -> Belief:
        """What this robot knows now; `with_signs=False` leaves out the team's list of signs, which takes a while."""
        team, frame = self.team, self._frames[robot]
        group = team.group_index(robot)
        return Belief(
            robot=robot,
            step=frame.step if frame is not None else 0,
            pose_map_robot=self.pose_map_robot(robot),
            grid=team.grid_of(group),
            mates={mate: self.pose_map_robot(mate) for mate in team.groups[group].robots if mate != robot},
            signs=team.signs_of(group) if with_signs else (),
            ranges_m=frame.ranges_m if frame is not None else np.zeros(0),
            map_version=team.groups[group].version,
        )
