"""The pose graph of one mapper: keyframes of all robots as nodes, odometry and closures as edges."""

from __future__ import annotations

from array import array
from collections.abc import MutableSequence, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.small_matrices import invert_symmetric
from twc_env.records.geometry import between, compose, inverse
from twc_env.records.messages import Keyframe, LoopClosure
from twc_env.records.team_messages import KnownSigns
from twc_env.slam.mapping.pending_closures import WaitingClosures
from twc_env.slam.mapping.removed_keyframes import RemovedKeyframes
from twc_env.slam.places.sign_readings import SignReadings
from twc_env.slam.pose_graph.graph_arrays import ODOMETRY, GraphArrays, subgraph_of
from twc_env.slam.pose_graph.graph_sparsification import Edges, sparsified
from twc_env.slam.pose_graph.held_poses import contracted
from twc_env.slam.pose_graph.keyframe_paths import path_position
from twc_env.slam.pose_graph.odometry_only import OdometryOnlyMotions
from twc_env.slam.pose_graph.solver import Graph
from twc_env.slam.pose_graph.systematic_errors import UNOWNED, shared_errors


class TeamGraph(GraphArrays):
    """Nodes are keyframes in order of arrival; data is stored in arrays.

    keeps_refused: rejected closures stay as unused edges, so that they can be accepted again. odometry_scale_std:
    odometry has a systematic scale error (`shared_errors`), for engines without scan matching.
    """

    prior: int | None = None
    """The robot that stands for a map of an earlier session, whose poses never change; its nodes come first. An
    attribute of the object only where there is one: more than 29 make access to all of them slower."""

    def __init__(
        self,
        robot_count: int,
        beam_count: int,
        keeps_refused: bool = False,
        odometry_scale_std: float | None = None,
    ):
        super().__init__(robot_count, beam_count)
        self._scale_std = odometry_scale_std
        self._keeps_refused = keeps_refused
        self.changes = 0
        """Counter of added keyframes, pose changes, and accepted or rejected closures."""
        self.refusals = 0
        """Number of rejections of verified closures."""
        self._verified_numbers: set[int] = set()
        self.keyframes: list[list[Keyframe]] = [[] for _ in range(robot_count)]
        """Per robot, the keyframes held."""
        self.closures: list[LoopClosure] = []
        """Verified closures with their status, except those between removed keyframes."""
        self.closures_verified = 0
        """Number of closures ever added."""
        self.waiting = WaitingClosures()
        self._nodes: list[MutableSequence[int]] = [array("q") for _ in range(robot_count)]
        """Node index of each of these keyframes."""
        self._removed = RemovedKeyframes()
        self._odometry_only = OdometryOnlyMotions(robot_count)
        self._readings = SignReadings(robot_count)
        self._edge_of_closure: dict[int, int] = {}

    @property
    def sign_news(self) -> list[int]:
        """Per robot, counter of readings that may change the known signs."""
        return self._readings.news

    def add_robot(self) -> None:
        """Make room for one more robot."""
        super().add_robot()
        self.keyframes.append([])
        self._nodes.append(array("q"))
        self._odometry_only.add_robot()
        self._readings.news.append(0)

    def poses_of(self, robot: int) -> Array:
        """(keyframes, 3) poses of one robot, including removed keyframes."""
        poses = self.poses[self.path_of(robot)]
        if not len(self._removed):
            return poses
        return self._removed.poses_among(robot, self._indices_of(robot), poses, self.poses)

    def steps_of(self, robot: int) -> Array:
        """(keyframes,) step at which each was taken."""
        steps = self.step_of_node[self.path_of(robot)]
        if not len(self._removed):
            return steps
        return self._removed.steps_among(robot, self._indices_of(robot), steps)

    def _indices_of(self, robot: int) -> Array:
        """(k,) keyframe indices of a robot's held keyframes."""
        return np.array([keyframe.index for keyframe in self.keyframes[robot]], np.int64)

    @property
    def arrived_count(self) -> int:
        """Number of keyframes ever added."""
        return self.node_count + len(self._removed)

    def latest_pose_of(self, robot: int) -> Array:
        """(3,) pose of the robot's newest keyframe."""
        pose: Array = self.poses[self._nodes[robot][-1]]
        return pose

    def scans_of(self, robot: int) -> list[Array]:
        """(beams,) scan of each of one robot's held keyframes [m]."""
        return [self._scans[node] for node in self.path_of(robot).tolist()]

    def nodes_of(self, robots: Sequence[int]) -> Array:
        """(k,) nodes of some robots, ascending."""
        return np.flatnonzero(self._mask(robots)[self.robot_of_node])

    def _mask(self, robots: Sequence[int]) -> Array:
        """(robots,) bool mask of these robots."""
        chosen = np.zeros(len(self.keyframes), bool)
        chosen[list(robots)] = True
        return chosen

    def node(self, key: tuple[int, int]) -> int:
        """The node of a robot's keyframe, which must be held."""
        return self._nodes[key[0]][path_position(self.keyframes[key[0]], key[1])]

    def keyframe(self, key: tuple[int, int]) -> Keyframe:
        """A robot's keyframe, which must be held."""
        path = self.keyframes[key[0]]
        return path[path_position(path, key[1])]

    def pose_map_odom(self, robot: int) -> Array:
        """(3,) pose of the robot's odom frame in its group's map frame; identity for a robot without keyframes."""
        if not self._nodes[robot]:
            return np.zeros(3)
        return compose(self.poses[self._nodes[robot][-1]], inverse(self.keyframes[robot][-1].pose_odom))

    def add_keyframe(self, keyframe: Keyframe) -> int:
        """Add a keyframe at the pose predicted by odometry; returns its node."""
        robot = keyframe.robot
        self.changes += 1
        node = self.add_node(keyframe)
        self._nodes[robot].append(node)
        self.keyframes[robot].append(keyframe)
        if keyframe.signs:
            self._readings.add(keyframe, node, self.poses)
        self._odometry_only.add(keyframe, self.edge_count - 1)
        return node

    def learn_scale(self, keyframe: Keyframe) -> bool:
        """Correct edges measured by odometry alone with the scale estimate of this keyframe; returns whether any
        changed."""
        corrections = self._odometry_only.corrections(keyframe.robot, keyframe.odometry_scale[0])
        if corrections is None:
            return False
        edges, more_m = corrections
        c, s = np.cos(self.measured[edges, 2]), np.sin(self.measured[edges, 2])
        self.measured[edges, 0] += c * more_m[:, 0] - s * more_m[:, 1]
        self.measured[edges, 1] += s * more_m[:, 0] + c * more_m[:, 1]
        self.changes += 1
        return True

    def add_closure(self, closure: LoopClosure) -> None:
        """Add a verified closure."""
        self.closures_verified += 1
        closure.number = len(self.closures)
        self.closures.append(closure)
        if closure.status == "pending":
            self.waiting.add([closure])

    def set_pending(self, closures: Sequence[LoopClosure]) -> None:
        """Set closures between two maps to pending, until others agree with them."""
        for closure in closures:
            closure.status, closure.reason = "pending", "waits for closures that agree"
        self.waiting.add(closures)

    def accept(self, closure: LoopClosure) -> None:
        """Use an added closure as an edge."""
        closure.status, closure.reason = "accepted", ""
        self.changes += 1
        for key in (closure.candidate.target, closure.candidate.source):
            self.last_closure_node[key[0]] = max(self.last_closure_node[key[0]], self.node(key))
        self._set_edge(closure, True)

    def refuse(self, closure: LoopClosure, reason: str) -> None:
        """Reject a verified closure that contradicts the map; its edge is no longer used."""
        closure.status, closure.reason = "rejected", reason
        self._verified_numbers.add(closure.number)
        self.refusals += 1
        if self._keeps_refused or closure.number in self._edge_of_closure:
            self._set_edge(closure, False)
        self.changes += 1
        for key in (closure.candidate.target, closure.candidate.source):
            if self.last_closure_node[key[0]] == self.node(key):
                self.last_closure_node[key[0]] = self._last_tied(key[0])

    def _last_tied(self, robot: int) -> int:
        """The node of the robot's last keyframe with an accepted closure; its first node without any."""
        used = [c.candidate for c in self.closures if c.status == "accepted"]
        last = max((i for c in used for r, i in (c.target, c.source) if r == robot), default=0)
        return self.node((robot, last))

    def _set_edge(self, closure: LoopClosure, is_used: bool) -> None:
        number = closure.number
        if number in self._edge_of_closure:
            self.is_used[self._edge_of_closure[number]] = is_used
            return
        self._edge_of_closure[number] = self.edge_count
        ends = self.node(closure.candidate.target), self.node(closure.candidate.source)
        self.add_edge(ends, closure.pose_target_source, closure.covariance, number, is_used)

    def disagreement(self, closure: LoopClosure) -> tuple[float, float, float]:
        """Deviation of a closure from the estimate [m] and [rad], and its squared Mahalanobis error."""
        target, source = self.node(closure.candidate.target), self.node(closure.candidate.source)
        return self.residual(target, source, closure.pose_target_source, closure.covariance)

    def closures_between(self, a: Sequence[int], b: Sequence[int], status: str) -> list[LoopClosure]:
        """Closures of one status between robots a and robots b, without those that failed verification."""
        out = []
        for closure in self.closures:
            if closure.status != status or (status == "rejected" and closure.number not in self._verified_numbers):
                continue
            if closure.joins(a, b):
                out.append(closure)
        return out

    def rejected_beside(self, closure: LoopClosure) -> list[LoopClosure]:
        """The verified, rejected closures between the same two robots (or parts of one robot's path)."""
        ends = (closure.candidate.target[0],), (closure.candidate.source[0],)
        return [other for other in self.closures_between(*ends, "rejected") if other is not closure]

    def sparsify(self, nodes: Array, carriers: Array) -> Array:
        """Remove keyframes (k,), each of which is from now on attached to another one (k,) that is held.

        Their closures are removed too, unless transferred to remaining nodes, and so are those that failed
        verification. Returns the remaining nodes by their old indices.
        """
        carrier_of, indices = np.arange(self.node_count), np.empty(self.node_count, np.int64)
        carrier_of[nodes] = carriers
        for robot in range(len(self.keyframes)):
            indices[self.path_of(robot)] = self._indices_of(robot)
        gone = self.robot_of_node[nodes], indices[nodes], self.step_of_node[nodes]
        self._removed.add(gone, nodes, carrier_of, self.poses)
        is_gone = carrier_of != np.arange(self.node_count)
        edges = sparsified(
            Edges(self.ends, self.measured, self.information, self.closure_of_edge, self.is_used), is_gone
        )
        self._update_moved_closures(edges, indices)
        edges = edges.numbered(self._keep_closures(edges))
        for robot, path in enumerate(self.keyframes):
            own = ~is_gone[self.path_of(robot)]
            path[:] = [keyframe for keyframe, stays in zip(path, own.tolist(), strict=True) if stays]
        poses, kept = self.poses, np.flatnonzero(~is_gone)
        number_of = self._keep(kept, edges.parts)
        self._nodes[:] = [array("q", self.path_of(robot).tolist()) for robot in range(len(self.keyframes))]
        self._removed.renumber(number_of)
        self._readings.sparsify(carrier_of, number_of, poses)
        self._odometry_only.clear()
        self.changes += 1
        return kept

    def _update_moved_closures(self, edges: Edges, indices: Array) -> None:
        """Update closures whose ends were transferred to other nodes; indices (nodes,) of the nodes' keyframes."""
        tying = np.flatnonzero(edges.closure != ODOMETRY)
        before = self.ends[[self._edge_of_closure[number] for number in edges.closure[tying].tolist()]]
        for k in np.flatnonzero((edges.ends[tying] != before).any(axis=1)).tolist():
            closure, edge, (target, _) = self.closures[edges.closure[tying[k]]], tying[k], before[k]
            sign_m, ends = closure.candidate.sign_m, edges.ends[edge]
            if sign_m is not None:
                sign_m = between(self.poses[ends[0]], compose(self.poses[target], [*sign_m, 0.0]))[:2]
            first, second = zip(self.robot_of_node[ends].tolist(), indices[ends].tolist(), strict=True)
            measured = edges.measured[edge].copy()
            closure.candidate = replace(
                closure.candidate, target=first, source=second, guess=measured, sign_m=sign_m
            )  # fmt: skip
            closure.pose_target_source, closure.covariance = measured, invert_symmetric(edges.information[edge])

    def _keep_closures(self, edges: Edges) -> Array:
        """Keep only closures that are edges or pending, and renumber them; returns the new numbers (closures,), -1 if
        removed."""
        tying = set(edges.closure.tolist())
        stay = [c for c in self.closures if c.number in tying or c.status == "pending"]
        number_of = np.full(len(self.closures), -1)
        number_of[[closure.number for closure in stay]] = np.arange(len(stay))
        now: list[int] = number_of.tolist()
        self._verified_numbers = {now[number] for number in self._verified_numbers if now[number] >= 0}
        for closure in stay:
            closure.number = now[closure.number]
        self.waiting = WaitingClosures(c for c in stay if c.status == "pending")
        self.closures[:] = stay
        self._edge_of_closure = {now[n]: e for e, n in enumerate(edges.closure.tolist()) if n != ODOMETRY}
        return number_of

    def place(self, nodes: Sequence[int] | Array, poses: Array) -> None:
        """Set the poses of nodes."""
        self.poses[nodes] = poses
        self._readings.note_move()
        self.changes += 1

    def subgraph(self, robots: Sequence[int], first: int = 0) -> tuple[Array, Array, Graph, Array]:
        """Nodes (n,) and edges (e,) among some robots, the subgraph of these, and which edges are used (e,).

        Of the nodes before `first` only those with edges to later ones are included, and no edges among them. A prior
        map is one node, its first, to which all edges of its nodes are moved.
        """
        has_prior = self.prior is not None and self.prior in robots
        if has_prior and first > 0:
            first = max(first, int(self._counts[self.prior]))
        nodes, edges, local, measured, information, is_closure, is_used = subgraph_of(
            self._mask(robots), first, self.robot_of_node, self.ends, self.measured, self.information,
            self.closure_of_edge, self.is_used,
        )  # fmt: skip
        if has_prior and first == 0:
            kept = int(self._counts[self.prior])
            parts = local, measured, information, is_closure, is_used
            is_left, (local, measured, information, is_closure, is_used) = contracted(self.poses[:kept], parts)
            nodes, edges = nodes[kept - 1 :], edges[is_left]
            nodes[0] = 0
        shared = None
        if self._scale_std is not None:
            owner = np.where(is_closure, UNOWNED, self.robot_of_node[nodes[local[:, 1]]])
            length_m = np.diff(self.travels_m[nodes[local]], axis=1)[:, 0]
            shared = shared_errors(owner, measured, length_m, self._scale_std)
        return nodes, edges, Graph(local, measured, information, is_closure, shared), is_used

    def anchor(self, robots: Sequence[int]) -> int:
        """The node that an optimisation of these robots holds: the prior map's, or the first robot's first."""
        if self.prior is not None and self.prior in robots:
            return 0
        return self.node((robots[0], 0)) if self.keyframes[robots[0]] else 0

    def refused_count(self, robots: Sequence[int]) -> int:
        """Number of closures among some robots that are unused edges."""
        refused = self.ends[~self.is_used]
        return int(np.count_nonzero(self._mask(robots)[self.robot_of_node[refused]].all(axis=1)))

    def strain(self, robots: Sequence[int]) -> tuple[float, int]:
        """Sum of squared odometry errors of some robots, and the number of used closures among them."""
        nodes, _, graph, is_used = self.subgraph(robots)
        squared = graph.squared_errors(self.poses[nodes])
        return float(squared[~graph.is_closure].sum()), int(np.count_nonzero(is_used & graph.is_closure))

    def places_among(self, robots: Sequence[int], nodes: Array) -> dict[tuple[int, int], int]:
        """Index among ascending nodes (n,) of each keyframe (robot, index) of some robots."""
        return {
            (robot, keyframe.index): place
            for robot in robots
            for keyframe, place in zip(
                self.keyframes[robot], np.searchsorted(nodes, self.path_of(robot)).tolist(), strict=True
            )
        }

    def closures_of(self, edges: Array) -> list[LoopClosure]:
        """The closures among some edges (e,)."""
        numbers = self.closure_of_edge[edges]
        return [self.closures[number] for number in numbers[numbers != ODOMETRY].tolist()]

    def mark(self, edges: Array, is_used: Array, reasons: dict[int, str]) -> None:
        """Update which edges (e,) are used; `reasons` by position in `edges` state why closures are rejected."""
        for k in np.flatnonzero(self.is_used[edges] != is_used).tolist():
            closure = self.closures[self.closure_of_edge[edges[k]]]
            if is_used[k]:
                self.accept(closure)
            else:
                self.refuse(closure, reasons[k])

    def end_step(self) -> None:
        """See `SignReadings.end_step`."""
        self._readings.end_step()

    def signs(self, robots: Sequence[int]) -> KnownSigns:
        """The texts read by some robots of one group, each once per place."""
        return self._readings.known(self.poses, robots)

    def as_arrays(self) -> dict[str, Array | list[str]]:
        """The graph of used edges: nodes, node_ids, node_steps, node_times_s, edges_ij, edges_z, edges_information,
        edges_kind."""
        ids, times_s = np.zeros((self.node_count, 2), np.int64), np.zeros(self.node_count)
        for robot, path in enumerate(self.keyframes):
            indices, nodes = self._indices_of(robot), self.path_of(robot)
            ids[nodes] = np.stack([np.full(len(indices), robot), indices], axis=1)
            times_s[nodes] = [keyframe.time_s for keyframe in path]
        used = self.is_used
        return {
            "nodes": self.poses,
            "node_ids": ids,
            "node_steps": self.step_of_node,
            "node_times_s": times_s,
            "edges_ij": self.ends[used],
            "edges_z": self.measured[used],
            "edges_information": self.information[used],
            "edges_kind": ["odometry" if c == ODOMETRY else "closure" for c in self.closure_of_edge[used]],
        }
