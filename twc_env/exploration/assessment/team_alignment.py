"""Alignment of the robots' maps with the building, and the position error of their paths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env import metrics
from twc_env.records.geometry import compose_rows, inverse
from twc_env.slam.modes import Engine
from twc_env.slam.team import TeamMapper


class TeamPaths:
    """Estimated poses of all steps in a mapper's map, each relative to the latest optimised keyframe; cached."""

    def __init__(self, engine: Engine, odom_poses: Array):
        """odom_poses (steps + 1, robots, 3): the front ends' estimates of all steps."""
        self._engine, self._odom_poses = engine, odom_poses
        self._held: dict[tuple[TeamMapper, int], Array] = {}

    def of(self, mapper: TeamMapper, robot: int) -> Array:
        """(steps + 1, 3) poses of one robot in its group's map of one mapper."""
        held = self._held.get((mapper, robot))
        if held is None:
            held = self._held[mapper, robot] = _trajectory(mapper, robot, self._odom_poses[:, robot])
        return held

    def as_seen(self) -> Array:
        """(steps + 1, robots, 3) poses, each in its robot's map."""
        robots = range(self._odom_poses.shape[1])
        return np.stack([self.of(self._engine.mapper_of(r), r) for r in robots], axis=1)

    def alignment(self, true_poses: Array) -> Array:
        """(robots, 3) rigid alignment of each robot's map with the building.

        Over all steps of all robots in the map; for robots that use another mapper, up to their last keyframe in it.
        """
        alignment = np.zeros((true_poses.shape[1], 3))
        for view in self._engine.views():
            estimated, true = [], []
            for robot in view.robots:
                end = len(true_poses)
                if robot not in view.viewers:
                    end = int(view.mapper.keyframe_steps(robot)[-1]) + 1
                estimated.append(self.of(view.mapper, robot)[:end])
                true.append(true_poses[:end, robot])
            alignment[list(view.viewers)] = metrics.align_team(np.concatenate(estimated), np.concatenate(true))
        return alignment


def _trajectory(mapper: TeamMapper, robot: int, odom: Array) -> Array:
    """See `TeamPaths.of`; odom (steps + 1, 3)."""
    steps = mapper.keyframe_steps(robot)
    if len(steps) == 0:
        return odom
    held = np.clip(np.searchsorted(steps, np.arange(len(odom)), side="right") - 1, 0, None)
    return compose_rows(mapper.poses_of(robot), held, compose_rows(inverse(odom[steps]), held, odom))


def team_error_m(engine: Engine, odom_poses: Array, true_poses: Array) -> float:
    """Root mean square position error [m] over all steps and robots, with one alignment per robot's map.

    odom_poses, true_poses (steps + 1, robots, 3).
    """
    paths = TeamPaths(engine, odom_poses)
    return position_error_m(paths.alignment(true_poses), paths.as_seen(), true_poses)


def position_error_m(alignment: Array, estimated: Array, true: Array) -> float:
    """Root mean square position error [m] of poses (steps, robots, 3); alignment (robots, 3) of each robot's map."""
    c, s = np.cos(alignment[:, 2]), np.sin(alignment[:, 2])
    x, y = estimated[..., 0], estimated[..., 1]
    ahead_m = alignment[:, 0] + c * x - s * y - true[..., 0]
    left_m = alignment[:, 1] + s * x + c * y - true[..., 1]
    return float(np.sqrt((ahead_m**2 + left_m**2).mean()))
