"""Nodes and edges of a pose graph in growing arrays; each is added by one compiled call."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import BindsAnew, Lent, borrowing_kernel, bound, kernel, parts_of, rebound
from twc_env.kernels.small_matrices import invert3, squared_error
from twc_env.records.growing_arrays import ROOM, grown, only
from twc_env.records.messages import Keyframe
from twc_env.slam.pose_graph.relative_equations import wrapped

ODOMETRY = -1
"""Closure number of odometry edges."""


@borrowing_kernel
def _write_node(node, previous, robot, step, travel, motion, covariance, poses, robots, steps, travels, variances):
    """Write a node at one motion (3,) from the previous one (-1: first of its robot, at the origin).

    variances (nodes, 3): of x, y and heading accumulated along the robot's odometry.
    """
    x = y = heading = 0.0
    if previous >= 0:
        c, s = math.cos(poses[previous, 2]), math.sin(poses[previous, 2])
        x = poses[previous, 0] + c * motion[0] - s * motion[1]
        y = poses[previous, 1] + s * motion[0] + c * motion[1]
        heading = wrapped(poses[previous, 2] + motion[2])
    poses[node, 0], poses[node, 1], poses[node, 2] = x, y, heading
    robots[node], steps[node], travels[node] = robot, step, travel
    across = 0.5 * (covariance[0, 0] + covariance[1, 1])
    for axis in range(3):
        before = variances[previous, axis] if previous >= 0 else 0.0
        variances[node, axis] = before + (across if axis < 2 else covariance[2, 2])


@borrowing_kernel
def _write_edge(
    edge, first, second, measurement, covariance, closure, is_used, ends, measured, information, kinds, used
):
    ends[edge, 0], ends[edge, 1] = first, second
    for axis in range(3):
        measured[edge, axis] = measurement[axis]
    invert3(covariance, information[edge])
    kinds[edge], used[edge] = closure, is_used


@borrowing_kernel
def _write_closure(graph, edge, first, second, measurement, covariance, closure, is_used):
    """Write an edge between two nodes."""
    _, _, _, _, _, ends, measured, information, kinds, used, _, _, _, _, _ = parts_of(graph)
    _write_edge(
        edge, first, second, measurement, covariance, closure, is_used, ends, measured, information, kinds, used
    )


@borrowing_kernel
def _between(a, b, out):
    """Write the pose of b in the frame of a."""
    c, s = math.cos(a[2]), math.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    out[0], out[1] = c * dx + s * dy, c * dy - s * dx
    out[2] = wrapped(b[2] - a[2])


@borrowing_kernel
def _residual(graph, target, source, measured, covariance):
    """See `GraphArrays.residual`."""
    poses, _, _, _, _, _, _, _, _, _, _, _, _, _, (expected, error, inverse) = parts_of(graph)
    _between(poses[target], poses[source], expected)
    _between(expected, measured, error)
    return math.hypot(error[0], error[1]), abs(error[2]), squared_error(error, covariance, inverse)


@borrowing_kernel
def _append_node(graph, node, edge, robot, step, travel, pose_odom, motion, covariance):
    """Write a robot's next node and the odometry edge to it; False for its first node, which has no edge."""
    (
        poses, robots, steps, travels, variances, ends, measured, information, kinds, used, rows, counts,
        last_closure_node, latest_odom, _,
    ) = parts_of(graph)  # fmt: skip
    count = counts[robot]
    previous = rows[robot, count - 1] if count > 0 else np.int64(-1)
    _write_node(node, previous, robot, step, travel, motion, covariance, poses, robots, steps, travels, variances)
    rows[robot, count], counts[robot] = node, count + 1
    for axis in range(3):
        latest_odom[robot, axis] = pose_odom[axis]
    if previous < 0:
        last_closure_node[robot] = node
        return False
    _write_edge(edge, previous, node, motion, covariance, ODOMETRY, True, ends, measured, information, kinds, used)
    return True


@borrowing_kernel
def _locate(graph, robots, poses_map_odom, std, since_m):
    """See `GraphArrays.locate`."""
    poses, _, _, travels, variances, _, _, _, _, _, rows, counts, last_closure_node, latest_odom, _ = parts_of(graph)
    for k in robots:
        if counts[k] == 0:
            since_m[k] = 0.0
            for axis in range(3):
                poses_map_odom[k, axis] = std[k, axis] = 0.0
            continue
        node, first, pose_odom = rows[k, counts[k] - 1], last_closure_node[k], latest_odom[k]
        c, s = math.cos(pose_odom[2]), math.sin(pose_odom[2])
        x, y = -c * pose_odom[0] - s * pose_odom[1], s * pose_odom[0] - c * pose_odom[1]
        c, s = math.cos(poses[node, 2]), math.sin(poses[node, 2])
        poses_map_odom[k, 0] = poses[node, 0] + c * x - s * y
        poses_map_odom[k, 1] = poses[node, 1] + s * x + c * y
        poses_map_odom[k, 2] = wrapped(poses[node, 2] - pose_odom[2])
        for axis in range(3):
            std[k, axis] = math.sqrt(max(variances[node, axis] - variances[first, axis], 0.0))
        since_m[k] = travels[node] - travels[first]


@borrowing_kernel
def _nearest(graph, robot, here, travel_max):
    """See `GraphArrays.nearest`."""
    poses, _, _, travels, _, _, _, _, _, _, rows, counts, _, _, _ = parts_of(graph)
    pose, best, best_squared = poses[here], -1, np.inf
    for k in range(counts[robot]):
        node = rows[robot, k]
        if travels[node] >= travel_max:
            break
        dx, dy = poses[node, 0] - pose[0], poses[node, 1] - pose[1]
        if dx * dx + dy * dy < best_squared:
            best, best_squared = k, dx * dx + dy * dy
    return best, math.sqrt(best_squared)


@borrowing_kernel
def _is_in_subgraph(ends, is_inside, first, robot_of_node):
    a, b = ends[0], ends[1]
    return max(a, b) >= first and is_inside[robot_of_node[a]] and is_inside[robot_of_node[b]]


@kernel
def subgraph_of(is_inside, first, robot_of_node, ends, measured, information, closure_of_edge, is_used):
    """See `TeamGraph.subgraph`; is_inside (robots,) bool: robots whose keyframes belong to it."""
    is_kept = np.zeros(robot_of_node.shape[0], np.bool_)
    for n in range(first, robot_of_node.shape[0]):
        is_kept[n] = is_inside[robot_of_node[n]]
    edge_count = 0
    for e in range(ends.shape[0]):
        if _is_in_subgraph(ends[e], is_inside, first, robot_of_node):
            is_kept[ends[e, 0]] = is_kept[ends[e, 1]] = True
            edge_count += 1
    local = np.full(robot_of_node.shape[0], -1)
    count = 0
    for n in range(robot_of_node.shape[0]):
        if is_kept[n]:
            local[n] = count
            count += 1
    nodes, edges, inner = np.empty(count, np.int64), np.empty(edge_count, np.int64), np.empty((edge_count, 2), np.int64)
    motions, weights = np.empty((edge_count, 3)), np.empty((edge_count, 3, 3))
    closures, used = np.empty(edge_count, np.bool_), np.empty(edge_count, np.bool_)
    for n in range(robot_of_node.shape[0]):
        if local[n] >= 0:
            nodes[local[n]] = n
    k = 0
    for e in range(ends.shape[0]):
        if not _is_in_subgraph(ends[e], is_inside, first, robot_of_node):
            continue
        a, b = local[ends[e, 0]], local[ends[e, 1]]
        edges[k], inner[k, 0], inner[k, 1] = e, a, b
        closures[k], used[k] = closure_of_edge[e] != ODOMETRY, is_used[e]
        for i in range(3):
            motions[k, i] = measured[e, i]
            for j in range(3):
                weights[k, i, j] = information[e, i, j]
        k += 1
    return nodes, edges, inner, motions, weights, closures, used


class GraphArrays(BindsAnew):
    """Nodes (keyframes in order of arrival) and edges (odometry and closures), one row each."""

    def __init__(self, robot_count: int, beam_count: int):
        self.node_count = self.edge_count = 0
        self._node_rows: list[Array] = [
            np.zeros((ROOM, 3)),
            np.zeros(ROOM, np.int64),
            np.zeros(ROOM, np.int64),
            np.zeros(ROOM),
            np.zeros((ROOM, 3)),
        ]
        self._beam_count = beam_count
        self._scans: list[Array] = []
        """Scan (beams,) of each node: the array of its keyframe, shared with other mappers."""
        self._edge_rows: list[Array] = [
            np.zeros((ROOM, 2), np.int64),
            np.zeros((ROOM, 3)),
            np.zeros((ROOM, 3, 3)),
            np.zeros(ROOM, np.int64),
            np.zeros(ROOM, bool),
        ]
        self._rows = np.zeros((robot_count, ROOM), np.int64)
        """(robots, room) nodes of each robot, the first `_counts` of each row."""
        self._counts = np.zeros(robot_count, np.int64)
        self.last_closure_node = np.zeros(robot_count, np.int64)
        """(robots,) node of each robot's last keyframe with an accepted closure; its first node without any."""
        self._latest_odom = np.zeros((robot_count, 3))
        """(robots, 3) pose of each robot's last keyframe in its odom frame."""
        self._append_node: Callable[..., bool] | None = None
        self._write_closure: Callable[..., None] | None = None
        self._locate: Callable[..., None] | None = None
        self._nearest: Callable[..., tuple[int, float]] | None = None
        self._residual: Callable[..., tuple[float, float, float]] | None = None
        """The kernels of these names, bound to the arrays at the first call."""

    def _rebind(self) -> None:
        """Bind the kernels to the current arrays, after some were replaced."""
        held = self._all()
        self._append_node, self._locate = rebound(self._append_node, held), rebound(self._locate, held)
        self._nearest, self._write_closure = rebound(self._nearest, held), rebound(self._write_closure, held)
        self._residual = rebound(self._residual, held)

    def _all(self) -> Lent:
        robots = self._rows, self._counts, self.last_closure_node, self._latest_odom
        room_for_poses = np.empty(3), np.empty(3), np.empty((3, 3))
        return Lent((*self._node_rows, *self._edge_rows, *robots, room_for_poses))

    def add_robot(self) -> None:
        """Make room for the nodes of one more robot."""
        self._rows, self._latest_odom = (
            np.pad(self._rows, ((0, 1), (0, 0))),
            np.pad(self._latest_odom, ((0, 1), (0, 0))),
        )
        self._counts, self.last_closure_node = np.pad(self._counts, (0, 1)), np.pad(self.last_closure_node, (0, 1))
        self._rebind()

    def add_node(self, keyframe: Keyframe) -> int:
        """Add a keyframe at the end of the robot's odometry; returns its node."""
        node = self.node_count
        if node == len(self._node_rows[0]):
            self._node_rows = [grown(rows) for rows in self._node_rows]
            self._rebind()
        width = self._rows.shape[1]
        if node >= width and self._counts[keyframe.robot] == width:
            self._rows = grown(self._rows.T).T.copy()
            self._rebind()
        self._make_room_for_edge()
        new = (
            node, self.edge_count, keyframe.robot, keyframe.step, keyframe.travel_m, keyframe.pose_odom,
            keyframe.motion, keyframe.motion_covariance,
        )  # fmt: skip
        if self._append_node is None:
            self._append_node = bound(_append_node, self._all(), *new)
        self.edge_count += self._append_node(*new)
        self._scans.append(keyframe.ranges_m)
        self.node_count += 1
        return node

    def add_edge(self, ends: tuple[int, int], measured: Array, covariance: Array, closure: int, is_used: bool) -> None:
        """Add an edge: measured pose (3,) of the second end in the frame of the first; number of its closure."""
        self._make_room_for_edge()
        new = self.edge_count, *ends, measured, covariance, closure, is_used
        if self._write_closure is None:
            self._write_closure = bound(_write_closure, self._all(), *new)
        self._write_closure(*new)
        self.edge_count += 1

    def _make_room_for_edge(self) -> None:
        if self.edge_count == len(self._edge_rows[0]):
            self._edge_rows = [grown(rows) for rows in self._edge_rows]
            self._rebind()

    def _keep(self, kept: Array, edges: tuple[Array, Array, Array, Array, Array]) -> Array:
        """Keep only nodes (k,), ascending, and renumber them; returns the new index of each old node, -1 if removed.

        Each robot's first and last node and those in `last_closure_node` must be among them. edges: the arrays `ends`
        (with old node indices), `measured`, `information`, `closure_of_edge` and `is_used` of all remaining edges.
        """
        number_of = np.full(self.node_count, -1)
        number_of[kept] = np.arange(len(kept))
        for robot, count in enumerate(self._counts.tolist()):
            own = number_of[self._rows[robot, :count]]
            own = own[own >= 0]
            self._rows[robot, : len(own)], self._counts[robot] = own, len(own)
        self.last_closure_node[:] = np.where(self._counts > 0, number_of[self.last_closure_node], 0)
        self._node_rows = [only(rows, kept) for rows in self._node_rows]
        self._scans = [self._scans[node] for node in kept.tolist()]
        self.node_count, self.edge_count = len(kept), len(edges[0])
        self._edge_rows = [only(rows, slice(None)) for rows in (number_of[edges[0]], *edges[1:])]
        self._rebind()
        return number_of

    def locate(self, robots: Array, into: tuple[Array, Array, Array]) -> None:
        """Locate some robots (k,) in the maps of their groups.

        Writes their rows of: odom frame in the map frame (robots, 3); standard deviation of the drift since the last
        closure or the start, by the front end (robots, 3) [m, m, rad]; path length since then (robots,) [m]. Zeros for
        robots without keyframes.
        """
        if self._locate is None:
            self._locate = bound(_locate, self._all(), robots, *into)
        self._locate(robots, *into)

    def residual(self, target: int, source: int, measured: Array, covariance: Array) -> tuple[float, float, float]:
        """Difference of a measured pose (3,) of the source in the target's frame from the estimate: distance [m], angle
        [rad], and squared Mahalanobis length."""
        now = target, source, measured, covariance
        if self._residual is None:
            self._residual = bound(_residual, self._all(), *now)
        return self._residual(*now)

    def nearest(self, robot: int, node: int, travel_max_m: float = math.inf) -> tuple[int, float]:
        """The robot's keyframe nearest to a node, as its position on the robot's path, and its distance [m].

        Only keyframes before a path length count; (-1, inf) if there is none.
        """
        if self._nearest is None:
            self._nearest = bound(_nearest, self._all(), robot, node, travel_max_m)
        return self._nearest(robot, node, travel_max_m)

    def rows_of(self, nodes: Array | slice) -> tuple[Array, Array]:
        """Poses (k, 3) and scans (k, beams) [m] of some nodes."""
        return self._node_rows[0][nodes], self._scans_at(nodes)

    def _scans_at(self, nodes: Array | slice) -> Array:
        """Scans (k, beams) [m] of some nodes."""
        chosen = self._scans[nodes] if isinstance(nodes, slice) else [self._scans[node] for node in nodes.tolist()]
        if not chosen:
            return np.zeros((0, self._beam_count))
        return (chosen[0] if len(chosen) == 1 else np.concatenate(chosen)).reshape(len(chosen), -1)

    def path_of(self, robot: int) -> Array:
        """(keyframes,) the nodes of a robot, ascending."""
        return self._rows[robot, : self._counts[robot]]

    @property
    def paths(self) -> tuple[Array, Array]:
        """Nodes of each robot, ascending (robots, room), and how many there are of each (robots,)."""
        return self._rows, self._counts

    @property
    def poses(self) -> Array:
        """(nodes, 3) pose of each keyframe in its group's map frame; may be written to."""
        return self._node_rows[0][: self.node_count]

    @property
    def robot_of_node(self) -> Array:
        """(nodes,) robot of each keyframe."""
        return self._node_rows[1][: self.node_count]

    @property
    def step_of_node(self) -> Array:
        """(nodes,) step of each keyframe."""
        return self._node_rows[2][: self.node_count]

    @property
    def travels_m(self) -> Array:
        """(nodes,) path length of the robot up to each keyframe."""
        return self._node_rows[3][: self.node_count]

    @property
    def ends(self) -> Array:
        """(edges, 2) nodes of each edge."""
        return self._edge_rows[0][: self.edge_count]

    @property
    def measured(self) -> Array:
        """(edges, 3) pose of the second end in the frame of the first."""
        return self._edge_rows[1][: self.edge_count]

    @property
    def information(self) -> Array:
        """(edges, 3, 3) information matrix of each edge."""
        return self._edge_rows[2][: self.edge_count]

    @property
    def closure_of_edge(self) -> Array:
        """(edges,) number of the closure, or `ODOMETRY`."""
        return self._edge_rows[3][: self.edge_count]

    @property
    def is_used(self) -> Array:
        """(edges,) bool: accepted edges; may be written to."""
        return self._edge_rows[4][: self.edge_count]
