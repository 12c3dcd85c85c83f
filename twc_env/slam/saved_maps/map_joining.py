"""Several saved maps in common frames: all pairs are compared, and only placements that agree with the others are used.

Placements of three pairs of maps must close a triangle. Of placements that disagree, those without more agreeing than
disagreeing triangles are left out: nothing tells which of them is wrong. The rest is joined, most evidence first, as
long as no two maps of a frame contradict each other; where placements form loops, least squares spreads the error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.geometry import between, compose, inverse
from twc_env.slam.pose_graph.solver import Graph
from twc_env.slam.saved_maps.placement import CONTRADICTION_MAX, Placement, agreement_at, place
from twc_env.slam.saved_maps.saved_map import SavedMap, cell_of, compared

AGREE_M, AGREE_RAD = 0.5, np.radians(5.0)
"""Placements that lead to the same map on two ways agree within these."""
CONTRADICTING_MIN_M = 4.0
"""Two maps of one frame contradict each other from this length of wall in free floor on."""
PLACE_STD = np.array([0.05, 0.05, np.radians(0.5)])
"""Standard deviations of a placement for least squares; all are taken for equally accurate."""


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two maps, by index, and how the second lies in the first."""

    first: int
    second: int
    placement: Placement


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Maps in one frame, which is that of the first of them."""

    members: tuple[int, ...]
    poses: Array
    """(members, 3) of the maps' frames."""


@dataclass(frozen=True, slots=True, eq=False)
class JoinedMaps:
    """All pairs, and the groups, largest first; a map that fits no other is a group of its own."""

    pairs: tuple[Pair, ...]
    groups: tuple[Group, ...]


def join_maps(maps: list[SavedMap], show: Callable[[int, int], None] = lambda done, total: None) -> JoinedMaps:
    """Compare all pairs of maps and join those that fit; show(done, total) is called after each pair.

    Raises MapError for a map with hardly a wall.
    """
    pairs = []
    every = list(combinations(range(len(maps)), 2))
    for done, (a, b) in enumerate(every, 1):
        pairs.append(Pair(a, b, place(maps[a], maps[b])))
        show(done, len(every))
    return joined(maps, pairs)


def joined(maps: list[SavedMap], pairs: list[Pair]) -> JoinedMaps:
    """The groups of maps that fit; placements left out have a reason."""
    pairs = _without_disagreeing(maps, pairs)
    group_of = list(range(len(maps)))
    poses = [np.zeros(3) for _ in maps]
    used: list[Pair] = []
    order = sorted(range(len(pairs)), key=lambda k: -_evidence_m(pairs[k]))
    for k in order:
        if not pairs[k].placement.is_believed:
            continue
        a, b, pose = pairs[k].first, pairs[k].second, _pose(pairs[k])
        if group_of[a] == group_of[b]:
            if _differs(maps[b], between(poses[a], poses[b]), pose):
                pairs[k] = _left_out(pairs[k], "disagrees with the way through other maps")
                continue
        else:
            shift = compose(compose(poses[a], pose), inverse(poses[b]))
            others = {m: compose(shift, poses[m]) for m in range(len(maps)) if group_of[m] == group_of[b]}
            against = _contradicting(
                maps, {m: poses[m] for m in range(len(maps)) if group_of[m] == group_of[a]}, others
            )
            if against is not None:
                names = " and ".join(maps[m].name for m in against)
                pairs[k] = _left_out(pairs[k], f"would lay {names} so that their walls contradict")
                continue
            old = group_of[b]
            for m, moved in others.items():
                poses[m] = moved
            group_of = [group_of[a] if g == old else g for g in group_of]
        used.append(pairs[k])
    groups = [_group([m for m in range(len(maps)) if group_of[m] == g], poses, used) for g in dict.fromkeys(group_of)]
    return JoinedMaps(tuple(pairs), tuple(sorted(groups, key=lambda group: -len(group.members))))


def _without_disagreeing(maps: list[SavedMap], pairs: list[Pair]) -> list[Pair]:
    """The pairs; those that disagree in as many triangles as they agree in, or more, are not believed."""
    pairs = list(pairs)
    index = {(pair.first, pair.second): k for k, pair in enumerate(pairs)}
    while True:
        balance = np.zeros(len(pairs), int)
        is_disputed = np.zeros(len(pairs), bool)
        for a, b, c in combinations(range(len(maps)), 3):
            edges = [index[a, b], index[b, c], index[a, c]]
            if all(pairs[k].placement.is_believed for k in edges):
                way = compose(_pose(pairs[edges[0]]), _pose(pairs[edges[1]]))
                agrees = not _differs(maps[c], way, _pose(pairs[edges[2]]))
                balance[edges] += 1 if agrees else -1
                is_disputed[edges] |= not agrees
        bad = np.flatnonzero(is_disputed & (balance <= 0))
        if not len(bad):
            return pairs
        for k in bad[balance[bad] == balance[bad].min()]:
            pairs[k] = _left_out(
                pairs[k], "disagrees with the placements of other maps, and nothing tells which is wrong"
            )


def _differs(source: SavedMap, first: Array, second: Array) -> bool:
    """Whether two poses (3,) put the middle of the source's floor at different places."""
    row, column = np.argwhere(source.free).mean(axis=0) + 0.5
    middle = compose(source.origin, np.array([column, row, 0.0]) * source.resolution_m)
    away = between(compose(first, middle), compose(second, middle))
    return bool(np.hypot(away[0], away[1]) > AGREE_M or abs(away[2]) > AGREE_RAD)


def _contradicting(maps: list[SavedMap], left: dict[int, Array], right: dict[int, Array]) -> tuple[int, int] | None:
    """Two maps, one of each side, whose walls contradict each other at these poses."""
    for a, pose_a in left.items():
        for b, pose_b in right.items():
            cell_m = cell_of([maps[a], maps[b]])
            pose = compose(compose(inverse(compose(pose_a, maps[a].origin)), pose_b), maps[b].origin)
            found = agreement_at(compared(maps[a], cell_m), compared(maps[b], cell_m), pose)
            if found.contradicting_m > CONTRADICTING_MIN_M and found.contradiction > CONTRADICTION_MAX:
                return a, b
    return None


def _group(members: list[int], poses: list[Array], used: list[Pair]) -> Group:
    """Poses in the frame of the first member, by least squares where placements form loops."""
    own = np.array([between(poses[members[0]], poses[m]) for m in members])
    inside = [pair for pair in used if pair.first in members]
    if len(inside) >= len(members) > 1:
        edges = np.array([(members.index(pair.first), members.index(pair.second)) for pair in inside], np.int64)
        measured = np.array([_pose(pair) for pair in inside])
        information = np.tile(np.diag(PLACE_STD**-2.0), (len(inside), 1, 1))
        graph = Graph(edges, measured, information, np.zeros(len(inside), bool))
        own = graph.fit(own, np.ones(len(inside)))
    return Group(tuple(members), own)


def _evidence_m(pair: Pair) -> float:
    return pair.placement.best.evidence_m if pair.placement.best is not None else 0.0


def _pose(pair: Pair) -> Array:
    assert pair.placement.best is not None
    return pair.placement.best.pose


def _left_out(pair: Pair, reason: str) -> Pair:
    return replace(pair, placement=replace(pair.placement, reason=reason))
