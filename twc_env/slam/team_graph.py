"""What one mapper holds of its team: keyframes of all robots as nodes of one pose graph, and the edges between them."""

from __future__ import annotations

from array import array
from collections.abc import MutableSequence, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.geometry import between, compose, inverse
from twc_env.messages import Keyframe, LoopClosure
from twc_env.slam.forgotten_paths import ForgottenPaths
from twc_env.slam.graph_arrays import ODOMETRY, GraphArrays, subgraph_of
from twc_env.slam.graph_thinning import Edges, thinned
from twc_env.slam.keyframe_paths import path_position
from twc_env.slam.odometry_only import OdometryOnlyMotions
from twc_env.slam.pose_graph import Graph
from twc_env.slam.shared_errors import UNOWNED, shared_errors
from twc_env.slam.sign_readings import SignReadings
from twc_env.slam.small_matrices import invert_symmetric
from twc_env.slam.waiting_closures import WaitingClosures
from twc_env.team_messages import KnownSigns


class TeamGraph(GraphArrays):
    """Nodes are keyframes in the order of their arrival, edges odometry and closures; everything is kept in arrays.

    With `keeps_refused`, closures that the map contradicts are edges that are not used, so that they can return. With
    `odometry_scale_std` odometry errs all along a path, too (`shared_errors`): where no scans take that out.
    """

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
        """Grows whenever a keyframe arrives, poses move or a closure is believed or refused."""
        self.refusals = 0
        """How often a well measured closure was refused."""
        self._sound: set[int] = set()
        self.keyframes: list[list[Keyframe]] = [[] for _ in range(robot_count)]
        """Of each robot those that are held."""
        self.closures: list[LoopClosure] = []
        """The closures that were verified, with what became of them, but those between keyframes that are forgotten."""
        self.closures_verified = 0
        """How many there ever were."""
        self.waiting = WaitingClosures()
        self._nodes: list[MutableSequence[int]] = [array("q") for _ in range(robot_count)]
        """Of each of these keyframes its node."""
        self._forgotten = ForgottenPaths()
        self._odometry_only = OdometryOnlyMotions(robot_count)
        self._readings = SignReadings(robot_count)
        self._edge_of_closure: dict[int, int] = {}

    @property
    def sign_news(self) -> list[int]:
        """How often each robot read what may change the signs that its group knows."""
        return self._readings.news

    def poses_of(self, robot: int) -> Array:
        """(keyframes, 3) of one robot, with those that are forgotten."""
        poses = self.poses[self.path_of(robot)]
        if not len(self._forgotten):
            return poses
        return self._forgotten.poses_among(robot, self._indices_of(robot), poses, self.poses)

    def steps_of(self, robot: int) -> Array:
        """(keyframes,) the step at which each was taken."""
        steps = self.step_of_node[self.path_of(robot)]
        if not len(self._forgotten):
            return steps
        return self._forgotten.steps_among(robot, self._indices_of(robot), steps)

    def _indices_of(self, robot: int) -> Array:
        """(k,) which of all its keyframes a robot's held ones are."""
        return np.array([keyframe.index for keyframe in self.keyframes[robot]], np.int64)

    @property
    def arrived_count(self) -> int:
        """How many keyframes ever came."""
        return self.node_count + len(self._forgotten)

    def latest_pose_of(self, robot: int) -> Array:
        """(3,) of the robot's newest keyframe."""
        pose: Array = self.poses[self._nodes[robot][-1]]
        return pose

    def scans_of(self, robot: int) -> list[Array]:
        """(beams,) of each of one robot's keyframes that are held [m]."""
        return [self._scans[node] for node in self.path_of(robot).tolist()]

    def nodes_of(self, robots: Sequence[int]) -> Array:
        """(k,) nodes of some robots, ascending."""
        return np.flatnonzero(self._are(robots)[self.robot_of_node])

    def _are(self, robots: Sequence[int]) -> Array:
        """(robots,) bool: which of all robots these are."""
        chosen = np.zeros(len(self.keyframes), bool)
        chosen[list(robots)] = True
        return chosen

    def node(self, key: tuple[int, int]) -> int:
        """The node of a robot's keyframe, one that is held."""
        return self._nodes[key[0]][path_position(self.keyframes[key[0]], key[1])]

    def keyframe(self, key: tuple[int, int]) -> Keyframe:
        """A robot's keyframe, one that is held."""
        path = self.keyframes[key[0]]
        return path[path_position(path, key[1])]

    def pose_map_odom(self, robot: int) -> Array:
        """(3,) where the robot's odom frame lies in its group's map; a robot without keyframes is its own map."""
        if not self._nodes[robot]:
            return np.zeros(3)
        return compose(self.poses[self._nodes[robot][-1]], inverse(self.keyframes[robot][-1].pose_odom))

    def add_keyframe(self, keyframe: Keyframe) -> int:
        """The node of a new keyframe, put where odometry leads from the robot's last one."""
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
        """Put right what odometry alone told by what a robot knows of it at this keyframe; whether anything was."""
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
        """Note a verified closure."""
        self.closures_verified += 1
        closure.number = len(self.closures)
        self.closures.append(closure)
        if closure.status == "pending":
            self.waiting.add([closure])

    def set_pending(self, closures: Sequence[LoopClosure]) -> None:
        """Noted closures between two maps wait for others that agree with them."""
        for closure in closures:
            closure.status, closure.reason = "pending", "waits for closures that agree"
        self.waiting.add(closures)

    def accept(self, closure: LoopClosure) -> None:
        """Use a noted closure as an edge."""
        closure.status, closure.reason = "accepted", ""
        self.changes += 1
        for key in (closure.candidate.target, closure.candidate.source):
            self.last_closure_node[key[0]] = max(self.last_closure_node[key[0]], self.node(key))
        self._tie(closure, True)

    def refuse(self, closure: LoopClosure, reason: str) -> None:
        """A noted closure, well measured, contradicts the map: use it no more."""
        closure.status, closure.reason = "rejected", reason
        self._sound.add(closure.number)
        self.refusals += 1
        if self._keeps_refused or closure.number in self._edge_of_closure:
            self._tie(closure, False)
        self.changes += 1
        for key in (closure.candidate.target, closure.candidate.source):
            if self.last_closure_node[key[0]] == self.node(key):
                self.last_closure_node[key[0]] = self._last_tied(key[0])

    def _last_tied(self, robot: int) -> int:
        """The node of the robot's last keyframe with an accepted closure; its first without any."""
        used = [c.candidate for c in self.closures if c.status == "accepted"]
        last = max((i for c in used for r, i in (c.target, c.source) if r == robot), default=0)
        return self.node((robot, last))

    def _tie(self, closure: LoopClosure, is_used: bool) -> None:
        number = closure.number
        if number in self._edge_of_closure:
            self.is_used[self._edge_of_closure[number]] = is_used
            return
        self._edge_of_closure[number] = self.edge_count
        ends = self.node(closure.candidate.target), self.node(closure.candidate.source)
        self.add_edge(ends, closure.pose_target_source, closure.covariance, number, is_used)

    def disagreement(self, closure: LoopClosure) -> tuple[float, float, float]:
        """How far a closure lies from the estimate [m] and [rad], and the squared error of that by its covariance."""
        target, source = self.node(closure.candidate.target), self.node(closure.candidate.source)
        return self.residual(target, source, closure.pose_target_source, closure.covariance)

    def closures_between(self, a: Sequence[int], b: Sequence[int], status: str) -> list[LoopClosure]:
        """Closures of one status with one end among robots a and the other among b; none that failed verification."""
        out = []
        for closure in self.closures:
            if closure.status != status or (status == "rejected" and closure.number not in self._sound):
                continue
            if closure.joins(a, b):
                out.append(closure)
        return out

    def forget(self, nodes: Array, carriers: Array) -> Array:
        """Let go of keyframes (k,), each of which moves from now on with another one (k,) that is held.

        Closures go with them, but those that the nodes that stay take over; so do those that failed verification.
        Gives those nodes that stay, by their numbers until now.
        """
        carrier_of, indices = np.arange(self.node_count), np.empty(self.node_count, np.int64)
        carrier_of[nodes] = carriers
        for robot in range(len(self.keyframes)):
            indices[self.path_of(robot)] = self._indices_of(robot)
        gone = self.robot_of_node[nodes], indices[nodes], self.step_of_node[nodes]
        self._forgotten.add(gone, nodes, carrier_of, self.poses)
        is_gone = carrier_of != np.arange(self.node_count)
        edges = thinned(Edges(self.ends, self.measured, self.information, self.closure_of_edge, self.is_used), is_gone)
        self._hand_over(edges, indices)
        edges = edges.numbered(self._keep_closures(edges))
        for robot, path in enumerate(self.keyframes):
            own = ~is_gone[self.path_of(robot)]
            path[:] = [keyframe for keyframe, stays in zip(path, own.tolist(), strict=True) if stays]
        poses, kept = self.poses, np.flatnonzero(~is_gone)
        number_of = self._keep(kept, edges.parts)
        self._nodes[:] = [array("q", self.path_of(robot).tolist()) for robot in range(len(self.keyframes))]
        self._forgotten.renumber(number_of)
        self._readings.forget(carrier_of, number_of, poses)
        self._odometry_only.clear()
        self.changes += 1
        return kept

    def _hand_over(self, edges: Edges, indices: Array) -> None:
        """Closures of which other nodes are the ends from now on are told of these; indices (nodes,) of keyframes."""
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
        """Only those closures that are edges or wait for a merge, which are numbered anew; the numbers (closures,)."""
        tying = set(edges.closure.tolist())
        stay = [c for c in self.closures if c.number in tying or c.status == "pending"]
        number_of = np.full(len(self.closures), -1)
        number_of[[closure.number for closure in stay]] = np.arange(len(stay))
        now: list[int] = number_of.tolist()
        self._sound = {now[number] for number in self._sound if now[number] >= 0}
        for closure in stay:
            closure.number = now[closure.number]
        self.waiting = WaitingClosures(c for c in stay if c.status == "pending")
        self.closures[:] = stay
        self._edge_of_closure = {now[n]: e for e, n in enumerate(edges.closure.tolist()) if n != ODOMETRY}
        return number_of

    def place(self, nodes: Sequence[int] | Array, poses: Array) -> None:
        """Move nodes to new poses."""
        self.poses[nodes] = poses
        self._readings.note_move()
        self.changes += 1

    def subgraph(self, robots: Sequence[int], first: int = 0) -> tuple[Array, Array, Graph, Array]:
        """Nodes (n,) and edges (e,) among some robots, these as a graph of their own, and which edges are used (e,).

        Of the nodes before `first` only those with edges to later ones, and none of the edges between them.
        """
        nodes, edges, local, measured, information, is_closure, is_used = subgraph_of(
            self._are(robots), first, self.robot_of_node, self.ends, self.measured, self.information,
            self.closure_of_edge, self.is_used,
        )  # fmt: skip
        shared = None
        if self._scale_std is not None:
            owner = np.where(is_closure, UNOWNED, self.robot_of_node[nodes[local[:, 1]]])
            length_m = np.diff(self.travels_m[nodes[local]], axis=1)[:, 0]
            shared = shared_errors(owner, measured, length_m, self._scale_std)
        return nodes, edges, Graph(local, measured, information, is_closure, shared), is_used

    def refused_count(self, robots: Sequence[int]) -> int:
        """How many closures among some robots are edges that are not used."""
        refused = self.ends[~self.is_used]
        return int(np.count_nonzero(self._are(robots)[self.robot_of_node[refused]].all(axis=1)))

    def strain(self, robots: Sequence[int]) -> tuple[float, int]:
        """Squared error of the odometry of some robots, and for how many closures that are used it pays that."""
        nodes, _, graph, is_used = self.subgraph(robots)
        squared = graph.squared_errors(self.poses[nodes])
        return float(squared[~graph.is_closure].sum()), int(np.count_nonzero(is_used & graph.is_closure))

    def places_among(self, robots: Sequence[int], nodes: Array) -> dict[tuple[int, int], int]:
        """Where among ascending nodes (n,) each keyframe (robot, index) of some robots is."""
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
        """Note which edges (e,) are used now; `reasons` by position in `edges` say why closures are not."""
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
        """The graph of what is used: nodes, node_ids, edges_ij, edges_z, edges_information, edges_kind."""
        ids = np.zeros((self.node_count, 2), np.int64)
        for robot in range(len(self.keyframes)):
            indices = self._indices_of(robot)
            ids[self.path_of(robot)] = np.stack([np.full(len(indices), robot), indices], axis=1)
        used = self.is_used
        return {
            "nodes": self.poses,
            "node_ids": ids,
            "edges_ij": self.ends[used],
            "edges_z": self.measured[used],
            "edges_information": self.information[used],
            "edges_kind": ["odometry" if c == ODOMETRY else "closure" for c in self.closure_of_edge[used]],
        }
