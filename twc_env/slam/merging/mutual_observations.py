"""Test a merge hypothesis by whether the robots see each other where and when it says that they should.

All keyframes have the engine's step at which they were taken (`Keyframe.team_step`). A merge hypothesis therefore
predicts, for each keyframe of one robot, where the robots of the other group stood at that step relative to its scan.
If one stood within range, the scan must contain a robot-sized object there (`teammate_detection` stores such beams as
negative ranges). If instead the beams pass through the predicted place, the hypothesis is wrong; if robots are seen in
many places as predicted, rooms that look alike cannot explain it, and the hypothesis of a single closure is enough for
a merge. Needs robots that explore at the same time, and no identification of a robot: where another one of the
watcher's own group stood near the predicted place, it may be the one that was seen, and nothing is concluded.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, robot_configs
from twc_env.kernels.compiled import kernel
from twc_env.records.geometry import compose
from twc_env.slam.mapping.group_maps import GroupMaps
from twc_env.slam.mapping.segments import NO_ROBOT, Segments
from twc_env.slam.mapping.team_graph import TeamGraph

TOLERANCE_M = 0.4
"""Error of a predicted position across and along the line of sight."""
NEAR_M = 0.6
"""Robots that are predicted closer than this touch each other: nothing is concluded."""
CAUTION_M = 1.5
"""A robot seen this near to the predicted position may be the one that was predicted: the path may have drifted; and
one of the watcher's group that stood this near to it may be the one that was seen."""
GAP_MAX_M = 1.5
"""Between two keyframes further apart than this a robot's position is not interpolated."""
CONTRADICTION_MIN = 2
"""Keyframes that must see through a predicted robot, and more than see one as predicted, to reject a merge."""
CONFIRMATION_MIN = 10
"""Keyframes that must see a robot as predicted, and ten times as many as see through one, to confirm a merge. In
training buildings 300 to 349 none of 143 wrong hypotheses was confirmed and 92 were contradicted; of 168 right ones 126
were confirmed and none was contradicted."""
PLACES_MIN, PLACE_APART_M = 5, 0.5
"""Successive places of a seen robot, this far apart, that prove the hypothesis of a single closure by a sign: what
stands still may be a pillar. Checked on training buildings 350 to 379, by hard settings and without WiFi."""


class ObservationCounts(NamedTuple):
    """Keyframes at whose step a robot of the other group should have been visible."""

    seen: int
    """It was seen."""
    seen_through: int
    """The beams passed through its place, and no robot was seen near it."""
    places: int = 0
    """Successive places, PLACE_APART_M apart, at which it was seen."""

    @property
    def contradict(self) -> bool:
        """Whether the hypothesis is wrong."""
        return self.seen_through >= CONTRADICTION_MIN and self.seen_through > self.seen

    @property
    def confirm(self) -> bool:
        """Whether the hypothesis is right."""
        return self.seen >= CONFIRMATION_MIN and self.seen >= 10 * self.seen_through

    @property
    def prove(self) -> bool:
        """Whether the hypothesis is right, however few closures support it."""
        return self.confirm and self.places >= PLACES_MIN


@kernel
def _is_repeated(steps, k):
    """Whether a neighbour of the k-th of these ascending steps equals it."""
    return (k > 0 and steps[k - 1] == steps[k]) or (k + 1 < steps.shape[0] and steps[k + 1] == steps[k])


@kernel
def _places_at(steps, poses, own_steps):
    """(k, 2) where a robot with keyframes at poses (n, 3) stood at steps (k,); NaN where it does not say.

    steps (k,) and own_steps (n,) ascending, negative if unknown. The robot is interpolated between its keyframes. Those
    with the same step came in belatedly: such a step says nothing.
    """
    places = np.full((steps.shape[0], 2), np.nan)
    after = 0
    for k in range(steps.shape[0]):
        if steps[k] < 0:
            continue
        while after < own_steps.shape[0] and own_steps[after] < steps[k]:
            after += 1
        if after == own_steps.shape[0]:
            break
        before = after if own_steps[after] == steps[k] else after - 1
        if before < 0 or _is_repeated(own_steps, after):
            continue
        dx, dy = poses[after, 0] - poses[before, 0], poses[after, 1] - poses[before, 1]
        if math.hypot(dx, dy) > GAP_MAX_M:
            continue
        part = (steps[k] - own_steps[before]) / max(own_steps[after] - own_steps[before], 1)
        places[k, 0], places[k, 1] = poses[before, 0] + part * dx, poses[before, 1] + part * dy
    return places


@kernel
def _predict(poses, steps, stood, reach_m):
    """The keyframes of a robot (k,) at whose step another one stood within reach, and where in the keyframes' frames
    (k, 2).

    poses (n, 3), steps (n,) and places stood (n, 2) of the other one. Keyframes of one robot with the same step came in
    belatedly: such a step says nothing.
    """
    chosen, places, count = np.empty(poses.shape[0], np.int64), np.empty((poses.shape[0], 2)), 0
    for k in range(poses.shape[0]):
        if math.isnan(stood[k, 0]) or _is_repeated(steps, k):
            continue
        x, y = stood[k, 0] - poses[k, 0], stood[k, 1] - poses[k, 1]
        if NEAR_M <= math.hypot(x, y) <= reach_m:
            c, s = math.cos(poses[k, 2]), math.sin(poses[k, 2])
            chosen[count], places[count, 0], places[count, 1] = k, c * x + s * y, c * y - s * x
            count += 1
    return chosen[:count], places[:count]


@kernel
def _is_beside(stood, fellow):
    """(k,) whether a fellow at places (k, 2), NaN if unknown, was within CAUTION_M of the places stood (k, 2)."""
    found = np.zeros(stood.shape[0], np.bool_)
    for k in range(stood.shape[0]):
        found[k] = math.hypot(stood[k, 0] - fellow[k, 0], stood[k, 1] - fellow[k, 1]) < CAUTION_M
    return found


@kernel
def _count(scans, places, stood, radius):
    """Of scans (k, beams) [m], how many see a robot at the place (k, 2) [m], and how many see through it.

    And at how many successive places PLACE_APART_M apart it stood, in one frame (k, 2) [m], when it was seen.
    """
    seen = through = place_count = 0
    last_x = last_y = math.inf
    beams = scans.shape[1]
    spacing = 2 * math.pi / beams
    for k in range(scans.shape[0]):
        distance = math.hypot(places[k, 0], places[k, 1])
        middle = int(round(math.atan2(places[k, 1], places[k, 0]) / spacing))
        around = int(math.ceil(math.asin(min((radius + CAUTION_M) / distance, 1.0)) / spacing))
        is_clear, is_seen, is_other = True, False, False
        for i in range(-around, around + 1):
            reading = scans[k, (middle + i) % beams]
            across, away = distance * abs(math.sin(i * spacing)), abs(reading) + radius - distance
            if reading < 0.0 and abs(away) < CAUTION_M:
                is_other = True
            if across <= radius + TOLERANCE_M:
                is_seen |= reading < 0.0 and abs(away) <= radius + TOLERANCE_M
                is_clear &= away > 2 * radius + TOLERANCE_M
        seen += is_seen
        if is_seen and not math.hypot(stood[k, 0] - last_x, stood[k, 1] - last_y) < PLACE_APART_M:
            place_count += 1
            last_x, last_y = stood[k, 0], stood[k, 1]
        through += is_clear and not is_other and radius > distance * math.sin(spacing)
    return seen, through, place_count


class MutualObservations:
    """Counts the mutual observations that a merge hypothesis predicts, with the scans that this mapper has."""

    def __init__(self, config: EnvConfig, graph: TeamGraph, maps: GroupMaps, segments: Segments):
        self._graph, self._maps, self._segments = graph, maps, segments
        self._radius_m = config.dynamics.robot_radius_m
        """Of the largest robot ..."""
        self._radii_m = [own.dynamics.robot_radius_m for own in robot_configs(config)] if config.robot else []
        """... and in a mixed team of each."""
        self._reach_m = config.lidar.range_max_m - 2 * self._radius_m - TOLERANCE_M
        slam = config.slam
        self.are_known = slam.merging.mutual_observations_check and slam.keyframe.mask_teammates and slam.cues.lidar
        """Whether robots are looked for in scans at all."""

    def count(self, a: Sequence[int], b: Sequence[int], pose_a_b: Array) -> ObservationCounts:
        """Between the robots of two groups, `pose_a_b` (3,) being the pose of b's frame in a's."""
        counted = np.zeros(3, np.int64)
        if self.are_known:
            for i in a:
                for j in b:
                    for watcher, other, own in ((i, j, a), (j, i, b)):
                        counted += self._between(watcher, other, own, pose_a_b, watcher is j)
        return ObservationCounts(*counted.tolist())

    def are_together(self, a: Sequence[int], b: Sequence[int]) -> bool:
        """Whether robots of two groups explored at the same time, so that they may have seen each other."""
        if not self.are_known:
            return False
        spans = [[(own[0], own[-1]) for robot in side if len(own := self._steps_of(robot))] for side in (a, b)]
        return any(max(i[0], j[0], 0) < min(i[1], j[1]) for i in spans[0] for j in spans[1])

    def _between(
        self, watcher: int, other: int, own: Sequence[int], pose_a_b: Array, is_watcher_b: bool
    ) -> tuple[int, int, int]:
        """What the keyframes of the watcher, one of the group `own`, see of another robot."""
        graph = self._graph
        nodes, others = graph.path_of(watcher), graph.path_of(other)
        poses, other_poses = graph.poses[nodes], graph.poses[others]
        if is_watcher_b:
            poses = compose(pose_a_b, poses)
        else:
            other_poses = compose(pose_a_b, other_poses)
        steps = self._steps_of(watcher)
        stood = _places_at(steps, other_poses, self._steps_of(other))
        for fellow in own:
            if fellow != watcher:
                fellow_poses = graph.poses[graph.path_of(fellow)]
                if is_watcher_b:
                    fellow_poses = compose(pose_a_b, fellow_poses)
                stood[_is_beside(stood, _places_at(steps, fellow_poses, self._steps_of(fellow)))] = np.nan
        chosen, places = _predict(poses, steps, stood, self._reach_m)
        is_here = self._maps.have_scans(nodes[chosen])
        owner = self._segments.owners[other]
        radius_m = self._radii_m[owner] if self._radii_m and owner != NO_ROBOT else self._radius_m
        return _count(graph.rows_of(nodes[chosen][is_here])[1], places[is_here], stood[chosen][is_here], radius_m)

    def _steps_of(self, robot: int) -> Array:
        return np.array([keyframe.team_step for keyframe in self._graph.keyframes[robot]], np.int64)
