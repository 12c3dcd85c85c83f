"""Radio constraints in the pose graph of an episode, from signal strength fields around the keyframes of a map.

Keyframes `spacing_m` apart along each robot's path are places. Whenever a map is optimised, each place is compared with
the field of the places of other visits nearby, of its own and other robots (`radio_field`), and constrained relative to
the nearest of them. Constraints are recomputed from the current poses each time, so the graph does not grow, and one
that contradicts the present estimate has little weight: radio corrects slow drift only.

The constraints reach a few bandwidths and do not help where odometry error is larger. The path of a single robot
without laser is therefore initialised by radio SLAM (`radio_odometry`); its odometry edges stay as measured.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PoseGraphConfig, RadioSlamConfig
from twc_env.records.geometry import compose, poses_along
from twc_env.records.messages import Keyframe
from twc_env.slam.pose_graph.solver import Graph, squared_errors
from twc_env.slam.pose_graph.solver import optimise as graph_fit
from twc_env.slam.radio.radio_field import field_constraints, learn_weight
from twc_env.slam.radio.radio_odometry import RadioOdometry
from twc_env.slam.radio.radio_similarity import feature_rows, split_cues

BANDWIDTH_M = {"wifi": 5.0, "lte": 30.0}
FIT = PoseGraphConfig(robust="dcs")
PLACES_PER_TURN = 5
"""Number of new places after which a map should be optimised."""
FAR_M = 1e5
"""Path length offset between robots, so that places of two robots always count as different visits."""


class RadioConstraints:
    """The places of all robots with their fingerprints, and the constraints between them."""

    def __init__(self, config: RadioSlamConfig, robot_count: int, has_laser: bool):
        self._config = config
        self._odometry = None if has_laser or robot_count > 1 else RadioOdometry(config)
        """None with a laser, whose odometry is more accurate than radio, and in teams, whose merges are evaluated
        against the odometry as measured."""
        self._places: list[list[Keyframe]] = [[] for _ in range(robot_count)]
        self._new_places = [0] * robot_count

    def add(self, keyframe: Keyframe) -> bool:
        """Add a keyframe; returns whether its map should be optimised now."""
        robot, places = keyframe.robot, self._places[keyframe.robot]
        is_due = False
        if self._odometry is not None:
            self._odometry.add(keyframe)
            is_due = self._odometry.is_due
        is_near = places and keyframe.travel_m - places[-1].travel_m < self._config.spacing_m
        if len(keyframe.fingerprint.macs) and not is_near:
            places.append(keyframe)
            self._new_places[robot] += 1
            is_due |= self._new_places[robot] >= PLACES_PER_TURN
        return is_due

    def fit(
        self, robots: tuple[int, ...], graph: Graph, poses: Array, local: dict[tuple[int, int], int], fixed: int,
        is_last: bool = False,
    ) -> Array:  # fmt: skip
        """Poses (n, 3) of a map of some robots, optimised with its graph, all edges accepted, and with radio
        constraints.

        `local` maps a robot's keyframe to its index in poses; pose `fixed` is held. `is_last`: no more keyframes
        follow.
        """
        places = [place for robot in robots for place in self._places[robot]]
        for robot in robots:
            self._new_places[robot] = 0
        if not places:
            return poses
        if self._odometry is not None:
            if is_last or self._odometry.is_due:
                self._odometry.solve(is_last)
            if self._odometry.is_corrected:
                poses = compose(poses[0], poses_along(self._odometry.motions))
        nodes = np.array([local[place.robot, place.index] for place in places])
        for cue in BANDWIDTH_M:
            found = self._constraints(cue, places, poses[nodes])
            if found is not None:
                graph = self._extended(graph, nodes[found[0]], *found[1:], poses)
        return graph_fit(poses, *graph.parts, FIT, fixed, graph.shared)

    def _extended(self, graph: Graph, edges: Array, measured: Array, information: Array, poses: Array) -> Graph:
        """Add constraints, each down-weighted by its deviation from the present estimate."""
        squared = squared_errors(poses, edges, measured, information)
        information = information / (1.0 + squared / self._config.robust_scale**2)[:, None, None]
        return Graph(
            np.concatenate([graph.edges, edges]),
            np.concatenate([graph.measured, measured]),
            np.concatenate([graph.information, information]),
            np.concatenate([graph.is_closure, np.zeros(len(edges), bool)]),
            None if graph.shared is None else graph.shared.and_none(len(edges)),
        )

    def _constraints(self, cue: str, places: list[Keyframe], poses: Array) -> tuple[Array, Array, Array] | None:
        """Pairs (k, 2) of places, relative poses (k, 3) and information (k, 3, 3); None if there are none."""
        rows = feature_rows([split_cues(place.fingerprint)[cue] for place in places], self._config.similarity)
        if rows.nnz == 0:
            return None
        feature, bandwidth_m = rows.toarray(), BANDWIDTH_M[cue]
        robot = np.array([place.robot for place in places])
        travel = np.array([place.travel_m for place in places]) + FAR_M * robot
        reckoned = np.array([place.pose_odom[:2] for place in places]) + FAR_M * robot[:, None]
        weight = learn_weight(feature, reckoned, travel, bandwidth_m)
        found = field_constraints(feature, poses[:, :2], travel, bandwidth_m, self._config.apart_m, weight)
        return (found.pairs, *found.relative(poses)) if len(found.pairs) else None
