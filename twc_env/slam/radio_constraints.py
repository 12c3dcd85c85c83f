"""Radio in the pose graph of an episode: keyframes of one map tied by the fields of signal strength around them.

Some keyframes of every robot, `spacing_m` apart along its path, are places. Whenever a map is optimised, each of its
places is compared with the field that the places of other visits near by span, its own robot's and others'
(`radio_field`), and tied to the nearest of them. Ties are made anew from where the keyframes stand each time, so the
graph does not fill with them, and one that contradicts the present estimate has little weight: radio corrects what
drifts slowly and leaves alone what it cannot explain.

Ties reach a few bandwidths, and find nothing to tie where odometry has bent a path further. The path of a robot alone
without laser is therefore laid first where radio SLAM has it (`radio_odometry`); odometry is weighed as it was read.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PoseGraphConfig, RadioSlamConfig
from twc_env.geometry import compose, poses_along
from twc_env.messages import Keyframe
from twc_env.slam.pose_graph import Graph, squared_errors
from twc_env.slam.pose_graph import optimise as graph_fit
from twc_env.slam.radio_field import learn_worth, ties
from twc_env.slam.radio_odometry import RadioOdometry
from twc_env.slam.radio_similarity import feature_rows, split_cues

BANDWIDTH_M = {"wifi": 5.0, "lte": 30.0}
FIT = PoseGraphConfig(robust="dcs")
PLACES_PER_TURN = 5
"""So many new places make a map worth optimising."""
FAR_M = 1e5
"""Path length put between two robots: whatever one visits is another visit."""


class RadioConstraints:
    """What was heard at the places of all robots, and the ties that follow from it."""

    def __init__(self, config: RadioSlamConfig, robot_count: int, has_laser: bool):
        self._config = config
        self._odometry = None if has_laser or robot_count > 1 else RadioOdometry(config)
        """None with a laser, by which odometry is better than radio knows, and in teams: odometry as it was read judges
        their merges."""
        self._places: list[list[Keyframe]] = [[] for _ in range(robot_count)]
        self._untied = [0] * robot_count

    def add(self, keyframe: Keyframe) -> bool:
        """Remember what was heard at a keyframe; whether its map should be optimised now."""
        robot, places = keyframe.robot, self._places[keyframe.robot]
        is_due = False
        if self._odometry is not None:
            self._odometry.add(keyframe)
            is_due = self._odometry.is_due
        is_near = places and keyframe.travel_m - places[-1].travel_m < self._config.spacing_m
        if len(keyframe.fingerprint.macs) and not is_near:
            places.append(keyframe)
            self._untied[robot] += 1
            is_due |= self._untied[robot] >= PLACES_PER_TURN
        return is_due

    def fit(
        self, robots: tuple[int, ...], graph: Graph, poses: Array, local: dict[tuple[int, int], int], fixed: int,
        is_last: bool = False,
    ) -> Array:  # fmt: skip
        """Poses (n, 3) of a map of some robots by what its graph says, all of which is believed, and by radio.

        `local` says which of the poses a robot's keyframe is; pose `fixed` is held. `is_last`: no more will come.
        """
        places = [place for robot in robots for place in self._places[robot]]
        for robot in robots:
            self._untied[robot] = 0
        if not places:
            return poses
        if self._odometry is not None:
            if is_last or self._odometry.is_due:
                self._odometry.solve(is_last)
            if self._odometry.is_righted:
                poses = compose(poses[0], poses_along(self._odometry.motions))
        nodes = np.array([local[place.robot, place.index] for place in places])
        for cue in BANDWIDTH_M:
            found = self._ties(cue, places, poses[nodes])
            if found is not None:
                graph = self._extended(graph, nodes[found[0]], *found[1:], poses)
        return graph_fit(poses, *graph.parts, FIT, fixed, graph.shared)

    def _extended(self, graph: Graph, edges: Array, measured: Array, information: Array, poses: Array) -> Graph:
        """With ties, each of which weighs the less the further it lies from the present estimate."""
        squared = squared_errors(poses, edges, measured, information)
        information = information / (1.0 + squared / self._config.robust_scale**2)[:, None, None]
        return Graph(
            np.concatenate([graph.edges, edges]),
            np.concatenate([graph.measured, measured]),
            np.concatenate([graph.information, information]),
            np.concatenate([graph.is_closure, np.zeros(len(edges), bool)]),
            None if graph.shared is None else graph.shared.and_none(len(edges)),
        )

    def _ties(self, cue: str, places: list[Keyframe], poses: Array) -> tuple[Array, Array, Array] | None:
        """Pairs (k, 2) of places, relative poses (k, 3) and information (k, 3, 3); None where nothing is told."""
        rows = feature_rows([split_cues(place.fingerprint)[cue] for place in places], self._config.similarity)
        if rows.nnz == 0:
            return None
        feature, bandwidth_m = rows.toarray(), BANDWIDTH_M[cue]
        robot = np.array([place.robot for place in places])
        travel = np.array([place.travel_m for place in places]) + FAR_M * robot
        reckoned = np.array([place.pose_odom[:2] for place in places]) + FAR_M * robot[:, None]
        worth = learn_worth(feature, reckoned, travel, bandwidth_m)
        found = ties(feature, poses[:, :2], travel, bandwidth_m, self._config.apart_m, worth)
        return (found.pairs, *found.relative(poses)) if len(found.pairs) else None
