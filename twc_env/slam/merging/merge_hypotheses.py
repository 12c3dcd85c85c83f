"""What the pending closures between two maps say about how they fit together, before it suffices to merge them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.geometry import compose, inverse, transform_points
from twc_env.records.messages import KnownSign, LoopClosure, MergeHypothesis
from twc_env.slam.mapping.group_maps import Group
from twc_env.slam.mapping.team_graph import TeamGraph

AGREE_M, AGREE_RAD = 1.0, 0.2
"""Two closures agree if the poses of the other map that they imply differ by less than this, at the latter's robots."""


def merge_hypotheses(graph: TeamGraph, groups: Sequence[Group], mine: int) -> tuple[MergeHypothesis, ...]:
    """For each other group with pending closures to group `mine`, the pose that most of them agree on, the newest of
    equals."""
    found = []
    for number, other in enumerate(groups):
        if number == mine:
            continue
        pending = graph.waiting.between(groups[mine].robots, other.robots)
        if not pending:
            continue
        poses = np.array([_pose_mine_other(graph, closure, groups[mine].robots) for closure in pending])
        latest = {robot: graph.latest_pose_of(robot) for robot in other.robots}
        where = compose(poses, next(iter(latest.values())))  # (closures, 3): where they put one robot of that group
        apart_m = np.hypot(*(where[:, None, :2] - where[None, :, :2]).T)
        turned = np.abs(np.remainder(where[:, None, 2] - where[None, :, 2] + math.pi, 2 * math.pi) - math.pi)
        support = ((apart_m < AGREE_M) & (turned < AGREE_RAD)).sum(axis=1)
        best = len(pending) - 1 - int(np.argmax(support[::-1]))
        pose, signs = poses[best], graph.signs(other.robots)
        places_m = transform_points(pose, signs.places_m)
        found.append(
            MergeHypothesis(
                tuple(robot for robot in other.robots if robot != graph.prior),
                pose,
                int(support[best]),
                tuple(KnownSign(text, place) for text, place in zip(signs.texts, places_m, strict=True)),
                {robot: compose(pose, at) for robot, at in latest.items() if robot != graph.prior},
            )
        )
    return tuple(found)


def _pose_mine_other(graph: TeamGraph, closure: LoopClosure, mine: Sequence[int]) -> Array:
    """(3,) pose of the other group's map frame in the map of the robots `mine`, as one closure implies it."""
    target, source = closure.candidate.target, closure.candidate.source
    pose_target, pose_source = graph.poses[graph.node(target)], graph.poses[graph.node(source)]
    if target[0] in mine:
        return compose(compose(pose_target, closure.pose_target_source), inverse(pose_source))
    return compose(compose(pose_source, inverse(closure.pose_target_source)), inverse(pose_target))
