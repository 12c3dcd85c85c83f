"""Lay the maps that robots believe in on the building, and say how far their paths are off."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twc_env import metrics
from twc_env.geometry import between, compose
from twc_env.slam.modes import Engine
from twc_env.slam.team import TeamMapper

Array = NDArray


def trajectories(engine: Engine, odom_poses: Array) -> Array:
    """(steps + 1, robots, 3) each step's pose hung on the optimised keyframe before it, in the map that its robot sees.

    odom_poses (steps + 1, robots, 3): the front ends' estimates of all steps.
    """
    robots = range(odom_poses.shape[1])
    return np.stack([_trajectory(engine.mapper_of(r), r, odom_poses[:, r]) for r in robots], axis=1)


def _trajectory(mapper: TeamMapper, robot: int, odom: Array) -> Array:
    """(steps + 1, 3) of one robot in the map of its group in one mapper."""
    steps = mapper.keyframe_steps(robot)
    if len(steps) == 0:
        return odom
    held = np.clip(np.searchsorted(steps, np.arange(len(odom)), side="right") - 1, 0, None)
    anchors = np.array([k.pose_odom for k in mapper.keyframes[robot]])
    return compose(mapper.poses_of(robot)[held], between(anchors[held], odom))


def team_alignment(engine: Engine, odom_poses: Array, true_poses: Array) -> Array:
    """(robots, 3) the one rigid motion that lays the map each robot believes in on the building.

    It weighs all steps of all robots of the map; a mate's steps count up to its last keyframe that the mapper has.
    """
    alignment = np.zeros((true_poses.shape[1], 3))
    for view in engine.views():
        estimated, true = [], []
        for robot in view.robots:
            steps = view.mapper.keyframe_steps(robot)
            end = len(true_poses) if robot in view.viewers else int(steps[-1]) + 1
            estimated.append(_trajectory(view.mapper, robot, odom_poses[:, robot])[:end])
            true.append(true_poses[:end, robot])
        alignment[list(view.viewers)] = metrics.align_team(np.concatenate(estimated), np.concatenate(true))
    return alignment


def team_error_m(engine: Engine, odom_poses: Array, true_poses: Array) -> float:
    """Root mean square position error over all steps and robots, each robot's map aligned once as a whole.

    odom_poses, true_poses (steps + 1, robots, 3).
    """
    return position_error_m(
        team_alignment(engine, odom_poses, true_poses), trajectories(engine, odom_poses), true_poses
    )


def position_error_m(alignment: Array, estimated: Array, true: Array) -> float:
    """Root mean square over estimated poses (steps, robots, 3), each robot's laid on the building by its alignment."""
    aligned = compose(alignment[None], estimated)
    return float(np.sqrt(((aligned[..., :2] - true[..., :2]) ** 2).sum(axis=-1).mean()))
