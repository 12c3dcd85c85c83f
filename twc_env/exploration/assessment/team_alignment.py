"""Alignment of the robots' maps with the building, and the position error of their paths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env import metrics
from twc_env.records.geometry import between, compose, compose_rows, inverse
from twc_env.slam.modes import Engine
from twc_env.slam.team import TeamMapper


class TeamPaths:
    """Estimated poses of all steps in a mapper's map, each relative to the latest optimised keyframe; cached."""

    def __init__(self, engine: Engine, odom_poses: Array):
        """odom_poses (steps + 1, robots, 3): the front ends' estimates of all steps."""
        self._engine, self._odom_poses = engine, odom_poses
        self._held: dict[tuple[TeamMapper, int], Array] = {}

    def of(self, mapper: TeamMapper, segment: int) -> Array:
        """(steps + 1, 3) poses of one segment's robot in the group's map of one mapper, as if it was never carried."""
        held = self._held.get((mapper, segment))
        if held is None:
            odom = self._odom_poses[:, mapper.segments.owners[segment]]
            held = self._held[mapper, segment] = _trajectory(*mapper.segment_path(segment), odom)
        return held

    def as_seen(self, true_poses: Array | None = None) -> Array:
        """(steps + 1, robots, 3) poses, each in its robot's map.

        Of a robot that was carried and whose earlier segment is in another map, that segment is laid beside it by the
        alignments of both with the building; without true poses, it stays in the frame of its own map.
        """
        robots = range(self._odom_poses.shape[1])
        return np.stack([self._seen(self._engine.mapper_of(r), r, true_poses) for r in robots], axis=1)

    def _seen(self, mapper: TeamMapper, robot: int, true_poses: Array | None) -> Array:
        parts, group = mapper.segments.of(robot), mapper.group_index(robot)
        if len(parts) == 1:
            return self.of(mapper, robot)
        poses = np.empty((len(self._odom_poses), 3))
        for segment in parts:
            span, own = _span(mapper, segment, len(poses)), mapper.group_of_segment(segment)
            poses[span] = self.of(mapper, segment)[span]
            if own != group and true_poses is not None:
                places = [self._aligned(mapper, mapper.groups[g].robots, true_poses) for g in (own, group)]
                poses[span] = compose(between(places[1], places[0]), poses[span])
        return poses

    def _aligned(self, mapper: TeamMapper, segments: tuple[int, ...], true_poses: Array, viewers=None) -> Array:
        """(3,) alignment of a group's map with the building; of robots other than the viewers (None: all robots), up to
        their last keyframe."""
        estimated, true = [], []
        for segment in segments:
            robot, span = mapper.segments.owners[segment], _span(mapper, segment, len(true_poses))
            if viewers is not None and robot not in viewers:
                span = slice(span.start, min(span.stop, int(mapper.segment_path(segment)[1][-1]) + 1))
            estimated.append(self.of(mapper, segment)[span])
            true.append(true_poses[span, robot])
        return metrics.align_team(np.concatenate(estimated), np.concatenate(true))

    def alignment(self, true_poses: Array) -> Array:
        """(robots, 3) rigid alignment of each robot's map with the building.

        Over all steps of all robots in the map; for robots that use another mapper, up to their last keyframe in it.
        """
        alignment = np.zeros((true_poses.shape[1], 3))
        for view in self._engine.views():
            aligned = self._aligned(view.mapper, view.segments, true_poses, view.viewers)
            alignment[list(view.viewers)] = aligned
        return alignment


def _trajectory(poses: Array, steps: Array, odom: Array) -> Array:
    """See `TeamPaths.of`; poses (keyframes, 3) and steps (keyframes,) of the keyframes, odom (steps + 1, 3)."""
    if len(steps) == 0:
        return odom
    held = np.clip(np.searchsorted(steps, np.arange(len(odom)), side="right") - 1, 0, None)
    return compose_rows(poses, held, compose_rows(inverse(odom[steps]), held, odom))


def _span(mapper: TeamMapper, segment: int, count: int) -> slice:
    """The steps, of `count`, at which a robot was on this segment."""
    own = mapper.segments.of(mapper.segments.owners[segment])
    at = own.index(segment)
    begin = 0 if at == 0 else int(mapper.segment_path(segment)[1][0])
    return slice(begin, int(mapper.segment_path(own[at + 1])[1][0]) if at + 1 < len(own) else count)


def true_of_segments(mapper: TeamMapper, true_poses: Array) -> Array:
    """(steps + 1, segments, 3) true poses of the robot of each segment."""
    return true_poses if mapper.segments.is_whole else true_poses[:, mapper.segments.owners].copy()


def team_error_m(engine: Engine, odom_poses: Array, true_poses: Array) -> float:
    """Root mean square position error [m] over all steps and robots, with one alignment per robot's map.

    odom_poses, true_poses (steps + 1, robots, 3).
    """
    paths = TeamPaths(engine, odom_poses)
    return position_error_m(paths.alignment(true_poses), paths.as_seen(true_poses), true_poses)


def position_error_m(alignment: Array, estimated: Array, true: Array) -> float:
    """Root mean square position error [m] of poses (steps, robots, 3); alignment (robots, 3) of each robot's map."""
    c, s = np.cos(alignment[:, 2]), np.sin(alignment[:, 2])
    x, y = estimated[..., 0], estimated[..., 1]
    ahead_m = alignment[:, 0] + c * x - s * y - true[..., 0]
    left_m = alignment[:, 1] + s * x + c * y - true[..., 1]
    return float(np.sqrt((ahead_m**2 + left_m**2).mean()))
