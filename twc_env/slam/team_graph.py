"""What one mapper holds of its team: keyframes of all robots as nodes of one pose graph, and the edges between them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twc_env.geometry import compose, inverse
from twc_env.kernels import kernel
from twc_env.messages import Keyframe, KnownSign, LoopClosure
from twc_env.slam.growing import Growing
from twc_env.slam.odometry_filter import invert_symmetric
from twc_env.slam.pose_graph import Graph

Array = NDArray

ODOMETRY = -1
SAME_SIGN_M = 1.0


@kernel
def _places_of_signs(poses, readings, local, robots, text_count, same_m, texts, places):
    """Text and place (in the map) of each known sign, robot by robot; all of one text stand together.

    readings (n, 3): robot, node, text; local (n, 2): place in the frame of the node. Gives how many there are.
    """
    found_text, found = np.empty(readings.shape[0], np.int64), np.empty((readings.shape[0], 2))
    latest, earlier = np.full(text_count, -1), np.empty(readings.shape[0], np.int64)
    order, texts_found, count = np.empty(text_count, np.int64), 0, 0
    for a in range(robots.shape[0]):
        for k in range(readings.shape[0]):
            if readings[k, 0] != robots[a]:
                continue
            x, y, heading = poses[readings[k, 1], 0], poses[readings[k, 1], 1], poses[readings[k, 1], 2]
            c, s = math.cos(heading), math.sin(heading)
            x, y = x + c * local[k, 0] - s * local[k, 1], y + s * local[k, 0] + c * local[k, 1]
            text = readings[k, 2]
            other = latest[text]
            while other >= 0 and math.sqrt((found[other, 0] - x) ** 2 + (found[other, 1] - y) ** 2) >= same_m:
                other = earlier[other]
            if other >= 0:
                continue
            if latest[text] < 0:
                order[texts_found] = text
                texts_found += 1
            found_text[count], found[count, 0], found[count, 1] = text, x, y
            earlier[count] = latest[text]
            latest[text] = count
            count += 1
    end = 0
    for t in range(texts_found):
        first = end
        sign = latest[order[t]]
        while sign >= 0:  # from the latest to the first, then turned round
            texts[end], places[end, 0], places[end, 1] = order[t], found[sign, 0], found[sign, 1]
            end += 1
            sign = earlier[sign]
        for k in range((end - first) // 2):
            i, j = first + k, end - 1 - k
            for axis in range(2):
                places[i, axis], places[j, axis] = places[j, axis], places[i, axis]
    return count


@kernel
def _nearest(poses, nodes, travels, travel_max, x, y):
    best, best_squared = -1, np.inf
    for k in range(nodes.shape[0]):
        if travels[k] >= travel_max:
            break
        dx, dy = poses[nodes[k], 0] - x, poses[nodes[k], 1] - y
        if dx * dx + dy * dy < best_squared:
            best, best_squared = k, dx * dx + dy * dy
    return best, math.sqrt(best_squared)


@kernel
def _part(is_inside, robot_of_node, ends, measured, information, closure_of_edge, is_used):
    """See `TeamGraph.part`; is_inside (robots,) bool."""
    local = np.full(robot_of_node.shape[0], -1)
    count = edge_count = 0
    for n in range(robot_of_node.shape[0]):
        if is_inside[robot_of_node[n]]:
            local[n] = count
            count += 1
    for e in range(ends.shape[0]):
        edge_count += local[ends[e, 0]] >= 0 and local[ends[e, 1]] >= 0
    nodes, edges, inner = np.empty(count, np.int64), np.empty(edge_count, np.int64), np.empty((edge_count, 2), np.int64)
    motions, weights = np.empty((edge_count, 3)), np.empty((edge_count, 3, 3))
    closures, used = np.empty(edge_count, np.bool_), np.empty(edge_count, np.bool_)
    for n in range(robot_of_node.shape[0]):
        if local[n] >= 0:
            nodes[local[n]] = n
    k = 0
    for e in range(ends.shape[0]):
        a, b = local[ends[e, 0]], local[ends[e, 1]]
        if a < 0 or b < 0:
            continue
        edges[k], inner[k, 0], inner[k, 1] = e, a, b
        closures[k], used[k] = closure_of_edge[e] != ODOMETRY, is_used[e]
        for i in range(3):
            motions[k, i] = measured[e, i]
            for j in range(3):
                weights[k, i, j] = information[e, i, j]
        k += 1
    return nodes, edges, inner, motions, weights, closures, used


class TeamGraph:
    """Nodes are keyframes in the order of their arrival, edges odometry and closures; everything is kept in arrays.

    With `keeps_refused`, closures that the map contradicts are edges that are not used, so that they can return.
    """

    def __init__(self, robot_count: int, beam_count: int, keeps_refused: bool = False):
        self._keeps_refused = keeps_refused
        self.changes = [0] * robot_count
        """Of each robot: grows whenever its keyframe arrives, its poses move or its closure is believed or refused."""
        self.last_steps = [-1] * robot_count
        """The step of the newest keyframe of each robot; -1 before the first."""
        self.refusals = 0
        """How often a well measured closure was refused."""
        self._sound: set[int] = set()
        self.keyframes: list[list[Keyframe]] = [[] for _ in range(robot_count)]
        self.closures: list[LoopClosure] = []
        """Every closure that was ever verified, with what became of it."""
        self._poses, self._scans = Growing(3), Growing(beam_count)
        self._robot_of_node, self._step_of_node = Growing(dtype=np.int64), Growing(dtype=np.int64)
        self._nodes: list[list[int]] = [[] for _ in range(robot_count)]
        self._node_rows = [Growing(dtype=np.int64) for _ in range(robot_count)]
        """The same once more, to index with."""
        self._steps = [Growing(dtype=np.int64) for _ in range(robot_count)]
        self._travels = [Growing() for _ in range(robot_count)]
        self._ends, self._measured, self._information = Growing(2, dtype=np.int64), Growing(3), Growing(3, 3)
        self._closure_of_edge, self._is_used = Growing(dtype=np.int64), Growing(dtype=bool)
        self._strains = [Growing(3) for _ in range(robot_count)]
        """Variances [m2, m2, rad2] gathered along each robot's path, keyframe by keyframe."""
        self._tied = [0] * robot_count
        """Each robot's last keyframe with a closure that is used."""
        self.signs_read = [0] * robot_count
        """Texts read by each robot."""
        self._text_numbers: dict[str, int] = {}
        """Each text that was ever read and its number, in order."""
        self._readings, self._reading_places = Growing(3, dtype=np.int64), Growing(2)
        """Robot, node and text of each reading; where it is in the frame of its keyframe."""
        self._edge_of_closure: dict[int, int] = {}
        self._map_odom: list[Array | None] = [np.zeros(3) for _ in range(robot_count)]

    @property
    def poses(self) -> Array:
        """(nodes, 3) of all keyframes, each in its group's map frame."""
        return self._poses.rows

    @property
    def scans(self) -> Array:
        """(nodes, beams) of all keyframes [m]."""
        return self._scans.rows

    @property
    def robot_of_node(self) -> Array:
        """(nodes,) whose keyframe each is."""
        return self._robot_of_node.rows

    @property
    def step_of_node(self) -> Array:
        """(nodes,) the step at which each was taken."""
        return self._step_of_node.rows

    def poses_of(self, robot: int) -> Array:
        """(keyframes, 3) of one robot."""
        return self._poses.rows[self._node_rows[robot].rows]

    def scans_of(self, robot: int) -> Array:
        """(keyframes, beams) of one robot [m]."""
        return self._scans.rows[self._node_rows[robot].rows]

    def steps_of(self, robot: int) -> Array:
        """(keyframes,) the step at which each was taken."""
        return self._steps[robot].rows

    def travels_of(self, robot: int) -> Array:
        """(keyframes,) path length up to each [m]."""
        return self._travels[robot].rows

    def nodes_of(self, robots: Sequence[int]) -> Array:
        """(k,) nodes of some robots, ascending."""
        return np.flatnonzero(self._are(robots)[self._robot_of_node.rows])

    def _are(self, robots: Sequence[int]) -> Array:
        """(robots,) bool: which of all robots these are."""
        chosen = np.zeros(len(self.keyframes), bool)
        chosen[list(robots)] = True
        return chosen

    def node(self, key: tuple[int, int]) -> int:
        """The node of a robot's keyframe."""
        return self._nodes[key[0]][key[1]]

    def keyframe(self, key: tuple[int, int]) -> Keyframe:
        """A robot's keyframe."""
        return self.keyframes[key[0]][key[1]]

    def since_closure(self, robot: int) -> tuple[float, Array]:
        """Path length from the robot's last closure to its last keyframe [m], and (3,) what may have gone astray on it.

        Standard deviations [m, m, rad] by the front end's own covariances; without any closure, since its start.
        """
        if not self.keyframes[robot]:
            return 0.0, np.zeros(3)
        travels, strains, tied = self._travels[robot].rows, self._strains[robot].rows, self._tied[robot]
        x, y, heading = (strains[-1] - strains[tied]).tolist()  # three numbers: root by root, without array functions
        std = math.sqrt(max(x, 0.0)), math.sqrt(max(y, 0.0)), math.sqrt(max(heading, 0.0))
        return float(travels[-1] - travels[tied]), np.array(std)

    def pose_map_odom(self, robot: int) -> Array:
        """(3,) where the robot's odom frame lies in its group's map; a robot without keyframes is its own map."""
        held = self._map_odom[robot]
        if held is None:
            held = compose(self._poses.rows[self._nodes[robot][-1]], inverse(self.keyframes[robot][-1].pose_odom))
            self._map_odom[robot] = held
        return held

    def add_keyframe(self, keyframe: Keyframe) -> int:
        """The node of a new keyframe, put where odometry leads from the robot's last one."""
        robot, nodes = keyframe.robot, self._nodes[keyframe.robot]
        self.changes[robot] += 1
        self.last_steps[robot] = keyframe.step
        node = self._poses.count
        self._poses.append(compose(self._poses.rows[nodes[-1]], keyframe.motion) if nodes else np.zeros(3))
        self._scans.append(keyframe.ranges_m)
        self._robot_of_node.append(robot)
        self._step_of_node.append(keyframe.step)
        if nodes:
            self._add_edge(nodes[-1], node, keyframe.motion, keyframe.motion_covariance, ODOMETRY, True)
        nodes.append(node)
        self._node_rows[robot].append(node)
        self._map_odom[robot] = None
        self.keyframes[robot].append(keyframe)
        self._steps[robot].append(keyframe.step)
        self._travels[robot].append(keyframe.travel_m)
        self._add_strain(robot, keyframe.motion_covariance)
        self.signs_read[robot] += len(keyframe.signs)
        for sign in keyframe.signs:
            text = self._text_numbers.setdefault(sign.text, len(self._text_numbers))
            self._readings.append((robot, node, text))
            self._reading_places.append(sign.position_m)
        return node

    def _add_strain(self, robot: int, motion_covariance: Array) -> None:
        (xx, _, _), (_, yy, _), (_, _, heading) = motion_covariance.tolist()
        before = self._strains[robot].rows[-1].tolist() if self._strains[robot].count else (0.0, 0.0, 0.0)
        across = 0.5 * (xx + yy)
        self._strains[robot].append((before[0] + across, before[1] + across, before[2] + heading))

    def add_closure(self, closure: LoopClosure) -> None:
        """Note a verified closure."""
        closure.number = len(self.closures)
        self.closures.append(closure)

    def accept(self, closure: LoopClosure) -> None:
        """Use a noted closure as an edge."""
        closure.status, closure.reason = "accepted", ""
        for robot, index in (closure.candidate.target, closure.candidate.source):
            self.changes[robot] += 1
            self._tied[robot] = max(self._tied[robot], index)
        self._tie(closure, True)

    def refuse(self, closure: LoopClosure, reason: str) -> None:
        """A noted closure, well measured, contradicts the map: use it no more."""
        closure.status, closure.reason = "rejected", reason
        self._sound.add(closure.number)
        self.refusals += 1
        if self._keeps_refused or closure.number in self._edge_of_closure:
            self._tie(closure, False)
        for robot, index in (closure.candidate.target, closure.candidate.source):
            self.changes[robot] += 1
            if self._tied[robot] == index:
                self._tied[robot] = self._last_tied(robot)

    def _last_tied(self, robot: int) -> int:
        """The robot's last keyframe with an accepted closure; 0 without any."""
        used = [c.candidate for c in self.closures if c.status == "accepted"]
        return max((i for c in used for r, i in (c.target, c.source) if r == robot), default=0)

    def _tie(self, closure: LoopClosure, is_used: bool) -> None:
        number = closure.number
        if number in self._edge_of_closure:
            self._is_used.rows[self._edge_of_closure[number]] = is_used
            return
        self._edge_of_closure[number] = self._ends.count
        ends = self.node(closure.candidate.target), self.node(closure.candidate.source)
        self._add_edge(*ends, closure.pose_target_source, closure.covariance, number, is_used)

    def closures_between(self, a: Sequence[int], b: Sequence[int], status: str) -> list[LoopClosure]:
        """Closures of one status with one end among robots a and the other among b; none that failed verification."""
        out = []
        for closure in self.closures:
            if closure.status != status or (status == "rejected" and closure.number not in self._sound):
                continue
            first, second = closure.candidate.target[0], closure.candidate.source[0]
            if (first in a and second in b) or (first in b and second in a):
                out.append(closure)
        return out

    def _add_edge(self, first: int, second: int, measured: Array, covariance: Array, closure: int, used: bool) -> None:
        self._ends.append((first, second))
        self._measured.append(measured)
        self._information.append(invert_symmetric(covariance))
        self._closure_of_edge.append(closure)
        self._is_used.append(used)

    def nearest(self, robot: int, pose: Array, travel_max_m: float = math.inf) -> tuple[int, float]:
        """The robot's keyframe nearest to a pose among those up to a path length, and how far away it is [m].

        (-1, inf) where there is none.
        """
        return _nearest(
            self._poses.rows, self._node_rows[robot].rows, self._travels[robot].rows, travel_max_m, pose[0], pose[1]
        )

    def place(self, nodes: Sequence[int] | Array, poses: Array, robots: Sequence[int]) -> None:
        """Move nodes, all of these robots, to new poses."""
        self._poses.rows[nodes] = poses
        for robot in robots:
            self.changes[robot] += 1
            self._map_odom[robot] = None

    def part(self, robots: Sequence[int]) -> tuple[Array, Array, Graph, Array]:
        """Nodes (n,) and edges (e,) among some robots, these as a graph of their own, and which edges are used (e,)."""
        nodes, edges, local, measured, information, is_closure, is_used = _part(
            self._are(robots), self._robot_of_node.rows, self._ends.rows, self._measured.rows, self._information.rows,
            self._closure_of_edge.rows, self._is_used.rows,
        )  # fmt: skip
        return nodes, edges, Graph(local, measured, information, is_closure), is_used

    def places_among(self, robots: Sequence[int], nodes: Array) -> dict[tuple[int, int], int]:
        """Where among ascending nodes (n,) each keyframe (robot, index) of some robots is."""
        return {
            (robot, index): place
            for robot in robots
            for index, place in enumerate(np.searchsorted(nodes, self._node_rows[robot].rows).tolist())
        }

    def mark(self, edges: Array, is_used: Array, reasons: dict[int, str]) -> None:
        """Note which edges (e,) are used now; `reasons` by position in `edges` say why closures are not."""
        for k in np.flatnonzero(self._is_used.rows[edges] != is_used).tolist():
            closure = self.closures[self._closure_of_edge.rows[edges[k]]]
            if is_used[k]:
                self.accept(closure)
            else:
                self.refuse(closure, reasons[k])

    def signs(self, robots: Sequence[int]) -> tuple[KnownSign, ...]:
        """The texts read by some robots of one group, each once per place."""
        texts, places = np.empty(self._readings.count, np.int64), np.empty((self._readings.count, 2))
        count = _places_of_signs(
            self._poses.rows, self._readings.rows, self._reading_places.rows, np.array(robots, np.int64),
            len(self._text_numbers), SAME_SIGN_M, texts, places,
        )  # fmt: skip
        names = list(self._text_numbers)
        places.flags.writeable = False  # beliefs show it to planners
        return tuple(
            [KnownSign(names[k], place) for k, place in zip(texts[:count].tolist(), places[:count], strict=True)]
        )

    def as_arrays(self) -> dict[str, Array | list[str]]:
        """The graph of what is used: nodes, node_ids, edges_ij, edges_z, edges_information, edges_kind."""
        ids = np.zeros((self._poses.count, 2), np.int64)
        for robot, nodes in enumerate(self._nodes):
            ids[nodes] = np.stack([np.full(len(nodes), robot), np.arange(len(nodes))], axis=1)
        used = self._is_used.rows
        return {
            "nodes": self._poses.rows.copy(),
            "node_ids": ids,
            "edges_ij": self._ends.rows[used],
            "edges_z": self._measured.rows[used],
            "edges_information": self._information.rows[used],
            "edges_kind": ["odometry" if c == ODOMETRY else "closure" for c in self._closure_of_edge.rows[used]],
        }
