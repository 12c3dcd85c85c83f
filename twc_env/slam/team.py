"""The team's global mapping: keyframes of all robots in, merged maps and corrected poses out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twc_env.config import EnvConfig
from twc_env.geometry import between, compose, inverse, wrap_angle
from twc_env.messages import GridMap, Keyframe, KnownSign, LoopCandidate, LoopClosure
from twc_env.slam import map_merging, robust_backend
from twc_env.slam.loop_verification import LoopVerifier
from twc_env.slam.occupancy_grid import OccupancyGrid
from twc_env.slam.odometry_filter import invert_symmetric
from twc_env.slam.place_recognition import ProposalFilter, make_recogniser

Array = NDArray

REPEAT_REACH_M = 2.0
"""Proposals nearer than this, along both paths, to an earlier one of the same kind are not tried again ..."""
REPEAT_REACH_APART_M = 0.75
"""... while the two robots do not share a map yet, when every closure counts."""
PROXIMITY_PERIOD_M = 1.5
"""Path length between two searches for near keyframes."""
TIED_M = 3.0
"""Inside one map, a robot whose last closure is nearer than this along its path needs no other yet."""
URGENT_SQUARED_ERROR = 1.0
"""A closure that the estimate already meets this well can wait for the next optimisation but `patience` ones."""
PATIENCE_PERIODS = 8
DRIFT_BASE_M, DRIFT_PER_M, DRIFT_RAD = 0.8, 0.03, 0.35
"""A closure inside one map may disagree with the present estimate by this much."""
MOVED_M, MOVED_RAD = 0.04, 0.008
"""The map is drawn anew when a keyframe has moved by more than this from where it was drawn."""
RETRY_STEPS = 50
"""Merges that lacked evidence are tried again this often, whether or not another closure came."""
SAME_SIGN_M = 1.0


class _Growing:
    """Rows of numbers that grow one at a time without copying each time."""

    def __init__(self, *shape: int, dtype: type = np.float64):
        self._data: Array = np.zeros((64, *shape), dtype)
        self.count = 0

    def append(self, row) -> None:
        if self.count == len(self._data):
            self._data = np.concatenate([self._data, np.zeros_like(self._data)])
        self._data[self.count] = row
        self.count += 1

    @property
    def rows(self) -> Array:
        return self._data[: self.count]


@dataclass(slots=True, eq=False)
class Group:
    """Robots that share one map."""

    robots: tuple[int, ...]
    grid: OccupancyGrid
    version: int = 0
    """Grows when the map was drawn anew."""


class TeamMapper:
    """Place recognition, loop closure, map merging and joint optimisation over the keyframes of all robots."""

    def __init__(self, config: EnvConfig, robot_count: int):
        self._config = config.slam
        self._lidar = config.lidar
        self.keyframes: list[list[Keyframe]] = [[] for _ in range(robot_count)]
        self.closures: list[LoopClosure] = []
        """Every closure that was ever verified, with what became of it."""
        self.groups = [Group((r,), self._new_grid()) for r in range(robot_count)]
        self._group_of = list(range(robot_count))
        self._map_odom: list[Array | None] = [np.zeros(3) for _ in range(robot_count)]
        self._poses = _Growing(3)
        self._drawn = _Growing(3)
        """Where each keyframe stands in the map as drawn."""
        self._scans = _Growing(config.lidar.beam_count)
        self._steps = [_Growing(dtype=np.int64) for _ in range(robot_count)]
        self._robot_of_node = _Growing(dtype=np.int64)
        self._nodes: list[list[int]] = [[] for _ in range(robot_count)]
        self._edges = _Growing(2, dtype=np.int64)
        self._measured = _Growing(3)
        self._information = _Growing(3, 3)
        self._is_closure = _Growing(dtype=bool)
        self._recogniser = make_recogniser(config.slam.place_recognition, config.lidar.range_max_m)
        self._filters = {name: ProposalFilter() for name in (self._recogniser.name, "proximity")}
        self._verifier = LoopVerifier(config.slam.verification, config.slam.odometry_filter, config.lidar.range_max_m)
        self._waiting: dict[str, deque[LoopCandidate]] = {name: deque() for name in self._filters}
        self._searched_m = [0.0] * robot_count
        self._tied_m = [-np.inf] * robot_count
        self._dirty: dict[int, bool] = {}
        """Groups with closures that came since the last optimisation; True where one of them is urgent."""
        self._last_optimised_step = self._last_retried_step = 0
        self._travels = [_Growing() for _ in range(robot_count)]
        self._signs_read = [0] * robot_count
        self._signs: dict[int, tuple[tuple[int, int], tuple[KnownSign, ...]]] = {}

    def update(self, step: int, keyframes: list[Keyframe]) -> None:
        """Take in the keyframes that arrived; verify, merge and optimise as far as this step's budget goes."""
        for keyframe in keyframes:
            self._add(keyframe)
            self._propose(keyframe)
        self._verify_some()
        if step - self._last_retried_step >= RETRY_STEPS:
            self._last_retried_step = step
            self._retry_merges()
        waited = step - self._last_optimised_step
        period = self._config.pose_graph.period_steps
        if waited >= period and (any(self._dirty.values()) or (self._dirty and waited >= PATIENCE_PERIODS * period)):
            self._last_optimised_step = step
            for group in sorted(self._dirty):
                self._optimise(group)
            self._dirty.clear()

    def finish(self) -> None:
        """Work off everything that still waits (end of an episode or log)."""
        while any(self._waiting.values()):
            self._verify_some()
        self._retry_merges()
        for group in range(len(self.groups)):
            self._optimise(group)
        self._dirty.clear()

    def group_index(self, robot: int) -> int:
        """Which of `groups` the robot belongs to."""
        return self._group_of[robot]

    def poses_of(self, robot: int) -> Array:
        """(keyframes, 3) of one robot in its group's map frame."""
        return self._poses.rows[self._nodes[robot]]

    def keyframe_steps(self, robot: int) -> Array:
        """(keyframes,) the step at which each was taken."""
        return self._steps[robot].rows

    def pose_map_odom(self, robot: int) -> Array:
        """(3,) where the robot's odom frame lies in its group's map; a robot without keyframes is its own map."""
        held = self._map_odom[robot]
        if held is None:
            held = compose(self._poses.rows[self._nodes[robot][-1]], inverse(self.keyframes[robot][-1].pose_odom))
            self._map_odom[robot] = held
        return held

    def grid_of(self, group: int) -> GridMap:
        """The merged map of a group, as it is now."""
        return self.groups[group].grid.snapshot()

    def signs_of(self, group: int) -> tuple[KnownSign, ...]:
        """The texts read by a group, each once per place."""
        count = sum(self._signs_read[r] for r in self.groups[group].robots)
        key = (count, self.groups[group].version)
        held = self._signs.get(group)
        if held is None or held[0] != key:
            held = (key, self._collect_signs(self.groups[group].robots))
            self._signs[group] = held
        return held[1]

    def graph(self) -> dict[str, Array | list[str]]:
        """The pose graph as arrays: nodes, node_ids, edges_ij, edges_z, edges_information, edges_kind."""
        ids = np.zeros((self._poses.count, 2), np.int64)
        for robot, nodes in enumerate(self._nodes):
            ids[nodes] = np.stack([np.full(len(nodes), robot), np.arange(len(nodes))], axis=1)
        return {
            "nodes": self._poses.rows.copy(),
            "node_ids": ids,
            "edges_ij": self._edges.rows.copy(),
            "edges_z": self._measured.rows.copy(),
            "edges_information": self._information.rows.copy(),
            "edges_kind": ["closure" if c else "odometry" for c in self._is_closure.rows],
        }

    # --- keyframes and proposals ---

    def _new_grid(self) -> OccupancyGrid:
        return OccupancyGrid(self._config.resolution_m, self._lidar.range_max_m, self._lidar.beam_count)

    def _add(self, keyframe: Keyframe) -> None:
        robot, nodes = keyframe.robot, self._nodes[keyframe.robot]
        node = self._poses.count
        pose = compose(self._poses.rows[nodes[-1]], keyframe.motion) if nodes else np.zeros(3)
        self._poses.append(pose)
        self._drawn.append(pose)
        self._scans.append(keyframe.ranges_m)
        self._robot_of_node.append(robot)
        if nodes:
            self._add_edge(nodes[-1], node, keyframe.motion, keyframe.motion_covariance, False)
        nodes.append(node)
        self._map_odom[robot] = None
        self.keyframes[robot].append(keyframe)
        self._steps[robot].append(keyframe.step)
        self._travels[robot].append(keyframe.travel_m)
        self._signs_read[robot] += len(keyframe.signs)
        self.groups[self._group_of[robot]].grid.integrate(pose[None], keyframe.ranges_m[None])

    def _add_edge(self, first: int, second: int, measured: Array, covariance: Array, is_closure: bool) -> None:
        self._edges.append((first, second))
        self._measured.append(measured)
        self._information.append(invert_symmetric(covariance))
        self._is_closure.append(is_closure)

    def _propose(self, keyframe: Keyframe) -> None:
        group = self._group_of[keyframe.robot]
        is_tied = keyframe.travel_m - self._tied_m[keyframe.robot] < TIED_M
        mates = self.groups[group].robots if is_tied else ()
        candidates = self._recogniser.propose(keyframe, skipped_robots=mates)
        near = None if is_tied else self._near_keyframe(keyframe)
        if near is not None:
            candidates.append(near)
        for candidate in candidates:
            target = self.keyframes[candidate.target[0]][candidate.target[1]]
            together = self._group_of[target.robot] == group
            reach = REPEAT_REACH_M if together else REPEAT_REACH_APART_M
            if self._filters[candidate.recogniser].is_new(target, keyframe, reach):
                self._waiting[candidate.recogniser].append(candidate)

    def _near_keyframe(self, keyframe: Keyframe) -> LoopCandidate | None:
        """The nearest keyframe of the same map that the path alone does not tie to this one."""
        rule = self._config.place_recognition
        if rule.proximity_m <= 0 or keyframe.travel_m - self._searched_m[keyframe.robot] < PROXIMITY_PERIOD_M:
            return None
        self._searched_m[keyframe.robot] = keyframe.travel_m
        here = self._poses.rows[self._nodes[keyframe.robot][-1]]
        best, best_m = None, rule.proximity_m
        for robot in self.groups[self._group_of[keyframe.robot]].robots:
            count = len(self.keyframes[robot])
            if robot == keyframe.robot:
                count = int(np.searchsorted(self._travels[robot].rows, keyframe.travel_m - rule.revisit_travel_m))
            if count == 0:
                continue
            away = np.linalg.norm(self.poses_of(robot)[:count, :2] - here[:2], axis=1)
            nearest = int(np.argmin(away))
            if away[nearest] < best_m:
                best, best_m = (robot, nearest), away[nearest]
        if best is None:
            return None
        guess = between(self._poses.rows[self._nodes[best[0]][best[1]]], here)
        return LoopCandidate(best, (keyframe.robot, keyframe.index), guess, "proximity")

    # --- verification and merging ---

    def _verify_some(self) -> None:
        for _ in range(self._config.verification.backlog_per_step):
            queue = self._waiting[self._recogniser.name] or self._waiting["proximity"]
            if not queue:
                return
            candidate = queue.popleft()
            closure = self._verifier.verify(
                candidate, self.keyframes[candidate.target[0]], self.keyframes[candidate.source[0]]
            )
            self.closures.append(closure)
            if closure.status != "accepted":
                continue
            first, second = self._group_of[candidate.target[0]], self._group_of[candidate.source[0]]
            if first == second:
                self._judge_inside_map(closure)
            else:
                closure.status, closure.reason = "pending", "waits for closures that agree"
                self._try_merge(min(first, second), max(first, second))

    def _node(self, key: tuple[int, int]) -> int:
        return self._nodes[key[0]][key[1]]

    def _judge_inside_map(self, closure: LoopClosure) -> None:
        """Take a closure of one map unless it contradicts the estimate by more than drift can explain."""
        target, source = self._node(closure.candidate.target), self._node(closure.candidate.source)
        expected = between(self._poses.rows[target], self._poses.rows[source])
        error = between(expected, closure.pose_target_source)
        travel = self._travel_between(closure.candidate)
        away = float(np.hypot(error[0], error[1]))
        if away > DRIFT_BASE_M + DRIFT_PER_M * travel or abs(error[2]) > DRIFT_RAD:
            closure.status = "rejected"
            closure.reason = f"{away:.1f} m and {abs(error[2]):.2f} rad from the estimate"
            return
        closure.status, closure.reason = "accepted", ""
        self._add_edge(target, source, closure.pose_target_source, closure.covariance, True)
        for robot, index in (closure.candidate.target, closure.candidate.source):
            self._tied_m[robot] = max(self._tied_m[robot], self.keyframes[robot][index].travel_m)
        group = self._group_of[closure.candidate.target[0]]
        is_urgent = error @ np.linalg.solve(closure.covariance, error) > URGENT_SQUARED_ERROR
        self._dirty[group] = self._dirty.get(group, False) or bool(is_urgent)

    def _travel_between(self, candidate: LoopCandidate) -> float:
        """Path length over which drift could have gathered: between the keyframes, or since the robots' last tie."""
        target = self.keyframes[candidate.target[0]][candidate.target[1]]
        source = self.keyframes[candidate.source[0]][candidate.source[1]]
        if target.robot == source.robot:
            return min(abs(source.travel_m - target.travel_m), 40.0)
        return 20.0

    def _try_merge(self, a: int, b: int) -> None:
        """Put group b into the map of group a if enough speaks for it and nothing against."""
        pending = [c for c in self.closures if c.status == "pending" and self._groups_of(c) == {a, b}]
        rule = self._config.merging
        if len(pending) < rule.closures_min:
            return
        proposal = map_merging.largest_agreement(*self._as_a_to_b(pending, a), rule)
        if proposal is None:
            return
        if rule.wifi_check and not self._wifi_agrees(a, b, proposal.pose_a_b):
            return
        contradiction = map_merging.wall_contradiction(self.grid_of(a), self.grid_of(b), proposal.pose_a_b)
        if contradiction > rule.contradiction_max:
            return
        self._merge(a, b, proposal.pose_a_b)
        for closure in pending:
            self._judge_inside_map(closure)
        self._optimise(a)

    def _retry_merges(self) -> None:
        """Try all groups with pending closures: new keyframes, walls or merges may have made the case for them."""
        while True:
            pairs = {tuple(sorted(self._groups_of(c))) for c in self.closures if c.status == "pending"}
            count = len(self.groups)
            for a, b in sorted(pairs):
                self._try_merge(a, b)
                if len(self.groups) < count:
                    break  # the groups were numbered anew
            else:
                return

    def _groups_of(self, closure: LoopClosure) -> set[int]:
        return {self._group_of[closure.candidate.target[0]], self._group_of[closure.candidate.source[0]]}

    def _as_a_to_b(self, closures: list[LoopClosure], a: int) -> tuple[Array, Array, Array, Array]:
        """Keyframe poses in a, in b, the measured pose of the latter in the former (k, 3), and the signs in a (k, 2).

        A sign is placed by the keyframe of a, so that signs are compared in one frame.
        """
        in_a, in_b, measured, signs = [], [], [], []
        for closure in closures:
            target, source, z = closure.candidate.target, closure.candidate.source, closure.pose_target_source
            sign = closure.candidate.sign_m if closure.candidate.sign_m is not None else np.zeros(2)
            if self._group_of[target[0]] != a:
                sign = compose(inverse(z), [*sign, 0.0])[:2]
                target, source, z = source, target, inverse(z)
            signs.append(compose(self._poses.rows[self._node(target)], [*sign, 0.0])[:2])
            in_a.append(self._poses.rows[self._node(target)])
            in_b.append(self._poses.rows[self._node(source)])
            measured.append(z)
        return np.array(in_a), np.array(in_b), np.array(measured), np.array(signs)

    def _wifi_agrees(self, a: int, b: int, pose_a_b: Array) -> bool:
        positions, robots, travels, prints, is_b = [], [], [], [], []
        for group in (a, b):
            for robot in self.groups[group].robots:
                poses = self.poses_of(robot)
                poses = compose(pose_a_b, poses) if group == b else poses
                positions.append(poses[:, :2])
                robots += [robot] * len(poses)
                travels.append(self._travels[robot].rows)
                prints += [k.fingerprint for k in self.keyframes[robot]]
                is_b += [group == b] * len(poses)
        verdict = map_merging.wifi_agrees(
            np.concatenate(positions), np.array(robots), np.concatenate(travels), prints, np.array(is_b)
        )
        return bool(verdict)

    def _merge(self, a: int, b: int, pose_a_b: Array) -> None:
        moved = [node for robot in self.groups[b].robots for node in self._nodes[robot]]
        self._place(moved, compose(pose_a_b, self._poses.rows[moved]), self.groups[b].robots)
        robots = tuple(sorted(self.groups[a].robots + self.groups[b].robots))
        version = self.groups[a].version + self.groups[b].version + 1
        self.groups[a] = Group(robots, self._new_grid(), version)
        del self.groups[b]
        for index, group in enumerate(self.groups):
            for robot in group.robots:
                self._group_of[robot] = index
        self._dirty = {g if g < b else g - 1: urgent for g, urgent in self._dirty.items() if g != b} | {a: True}
        self._signs.clear()
        self._redraw(a)

    # --- optimisation and drawing ---

    def _place(self, nodes: Sequence[int] | Array, poses: Array, robots: Sequence[int]) -> None:
        """Move nodes, all of these robots, to new poses."""
        self._poses.rows[nodes] = poses
        for robot in robots:
            self._map_odom[robot] = None

    def _optimise(self, group: int) -> None:
        robots = self.groups[group].robots
        inside = np.isin(self._robot_of_node.rows, robots)
        nodes = np.flatnonzero(inside)
        if len(nodes) < 2:
            return
        local = np.cumsum(inside) - 1
        kept = inside[self._edges.rows[:, 0]] & inside[self._edges.rows[:, 1]]
        before = self._poses.rows[nodes]
        after = robust_backend.optimise(
            before,
            local[self._edges.rows[kept]],
            self._measured.rows[kept],
            self._information.rows[kept],
            self._is_closure.rows[kept],
            self._config.pose_graph,
            fixed=int(local[self._nodes[robots[0]][0]]),
        )
        self._place(nodes, after, robots)
        moved = np.abs(after - self._drawn.rows[nodes])
        if moved[:, :2].max() > MOVED_M or np.abs(wrap_angle(moved[:, 2])).max() > MOVED_RAD:
            self._redraw(group)

    def _redraw(self, group: int) -> None:
        nodes = np.flatnonzero(np.isin(self._robot_of_node.rows, self.groups[group].robots))
        grid = self.groups[group].grid
        grid.clear()
        grid.integrate(self._poses.rows[nodes], self._scans.rows[nodes])
        self._drawn.rows[nodes] = self._poses.rows[nodes]
        self.groups[group].version += 1

    def _collect_signs(self, robots: tuple[int, ...]) -> tuple[KnownSign, ...]:
        places: dict[str, list[Array]] = {}
        for robot in robots:
            poses = self.poses_of(robot)
            for keyframe in self.keyframes[robot]:
                for sign in keyframe.signs:
                    position = compose(poses[keyframe.index], [*sign.position_m, 0.0])[:2]
                    known = places.setdefault(sign.text, [])
                    if all(math.dist(position, other) >= SAME_SIGN_M for other in known):
                        known.append(position)
        return tuple(KnownSign(text, position) for text, known in places.items() for position in known)
