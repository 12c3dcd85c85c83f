"""TWC-SLAM's global mapping of whole walks at once: candidates, scan matching, one frame, one pose graph (T13-T15).

The engine does the same step by step and with more caution; here each part stands alone, so that recognisers and back
ends can be exchanged one at a time. Back ends: `plain` believes every matched candidate, as the paper prints it;
`robust` weighs them by a Cauchy loss (c = 3); `pcm` keeps the pairwise consistent ones; `ours` also asks scan matching
for overlap and free space, and grows the map from the surest closures.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env import metrics
from twc_env.config import EnvConfig, PoseGraphConfig
from twc_env.geometry import between, compose, inverse, transform_points
from twc_env.messages import Keyframe, LoopCandidate, LoopClosure
from twc_env.reproduce.routes import Walk
from twc_env.slam import robust_backend
from twc_env.slam.loop_verification import LoopVerifier
from twc_env.slam.place_recognition import ProposalFilter, make_recogniser
from twc_env.slam.scan_matching import scan_points
from twc_env.slam.small_matrices import invert_symmetric

BACKENDS = {
    "plain": PoseGraphConfig(robust="plain", iterations_max=100),
    "robust": PoseGraphConfig(robust="cauchy", robust_scale=9.0, iterations_max=100),
    "pcm": PoseGraphConfig(robust="pcm", iterations_max=100),
    "ours": PoseGraphConfig(robust="ours", iterations_max=100),
}
REPEAT_REACH_M = 2.0
"""A candidate nearer than this, along both paths, to an earlier one says nothing new."""
AGREE_M, AGREE_PER_M = 0.6, 0.02
"""Closures between two robots speak for one common frame when they put each other's places this near."""

CELL_M, GHOST_REACH_M = 0.1, 3.0
"""Cells of a point cloud, and how far from a true wall its ghost may stand."""


@dataclass(frozen=True, slots=True, eq=False)
class Matched:
    """A candidate after scan matching, and whether it is right."""

    closure: LoopClosure
    is_right: bool
    """Within 0.5 m and 10 degrees of the truth."""


@dataclass(frozen=True, slots=True, eq=False)
class OfflineMap:
    """Where a back end puts all keyframes."""

    poses: tuple[Array, ...]
    """One (keyframes, 3) per robot, in the frame of its group."""
    groups: tuple[tuple[int, ...], ...]
    """Robots that share a frame, the largest group first."""
    accepted: Array
    """(matched,) bool: the closures it believes."""


def candidates(config: EnvConfig, walks: Sequence[Walk]) -> list[LoopCandidate]:
    """What the configured recogniser proposes when all robots walk at the same time, without repetitions."""
    recogniser = make_recogniser(config.slam.place_recognition, config.lidar.range_max_m)
    is_news, found = ProposalFilter(), []
    for keyframe in in_time([w.keyframes for w in walks]):
        for candidate in recogniser.propose(keyframe):
            robot, index = candidate.target
            if is_news.is_new(walks[robot].keyframes[index], keyframe, REPEAT_REACH_M):
                found.append(candidate)
    return found


def in_time(paths: Sequence[Sequence[Keyframe]]) -> list[Keyframe]:
    """All robots' keyframes in the order in which they were taken."""
    return sorted(itertools.chain(*paths), key=lambda keyframe: (keyframe.time_s, keyframe.robot))


def match(config: EnvConfig, walks: Sequence[Walk], found: Sequence[LoopCandidate]) -> list[Matched]:
    """Scan matching of every candidate."""
    slam = config.slam
    verifier = LoopVerifier(slam.verification, slam.odometry_filter, config.lidar)
    matched = []
    for candidate in found:
        target, source = (walks[robot].keyframes for robot in (candidate.target[0], candidate.source[0]))
        closure = verifier.verify(candidate, target, source)
        true = between(*(walks[robot].poses[index] for robot, index in (candidate.target, candidate.source)))
        matched.append(Matched(closure, bool(metrics.closures_are_correct(closure.pose_target_source, true))))
    return matched


def build(walks: Sequence[Walk], matched: Sequence[Matched], backend: str) -> OfflineMap:
    """The map by one back end: `ours` gets the candidates only that scan matching confirms, all others get all."""
    offered = np.array([m.closure.status == "accepted" or backend != "ours" for m in matched], bool)
    closures = [m.closure for m, is_offered in zip(matched, offered, strict=True) if is_offered]
    odometry = [np.array([k.pose_odom for k in w.keyframes]) for w in walks]
    frames = common_frames(odometry, closures)
    first = np.cumsum([0, *(len(path) for path in odometry)])
    edges, measured, information = _odometry_edges(walks, first)
    odometry_count = len(edges)
    for closure in closures:
        target, source = closure.candidate.target, closure.candidate.source
        edges.append((first[target[0]] + target[1], first[source[0]] + source[1]))
        measured.append(closure.pose_target_source)
        information.append(invert_symmetric(closure.covariance))
    start = np.concatenate([compose(frame, path) for frame, path in zip(frames, odometry, strict=True)])
    is_closure = np.arange(len(edges)) >= odometry_count
    solved = robust_backend.solve(
        start, np.array(edges), np.array(measured), np.array(information), is_closure, BACKENDS[backend]
    )
    accepted = np.zeros(len(matched), bool)
    accepted[offered] = solved.accepted[odometry_count:]
    poses = tuple(solved.poses[a:b] for a, b in itertools.pairwise(first))
    return OfflineMap(
        poses, _groups(len(walks), [m.closure for m, a in zip(matched, accepted, strict=True) if a]), accepted
    )


def common_frames(odometry: Sequence[Array], closures: Sequence[LoopClosure]) -> list[Array]:
    """(3,) where each robot's odom frame lies in that of robot 0 (papers.md T14); its own where nothing ties it.

    Along a spanning tree whose links are the pairs of robots with most closures that agree on one relative frame.
    """
    links = {}
    for a, b in itertools.permutations(range(len(odometry)), 2):
        link = _agreed_frame(a, b, odometry, closures)
        if link is not None:
            links[a, b] = link
    frames: dict[int, Array] = {}
    while len(frames) < len(odometry):
        open_links = [(votes, -a, -b, a, b) for (a, b), (votes, _) in links.items() if a in frames and b not in frames]
        if open_links:
            _, _, _, a, b = max(open_links)
            frames[b] = compose(frames[a], links[a, b][1])
        else:
            frames[min(set(range(len(odometry))) - set(frames))] = np.zeros(3)
    return [frames[robot] for robot in range(len(odometry))]


def _agreed_frame(
    a: int, b: int, odometry: Sequence[Array], closures: Sequence[LoopClosure]
) -> tuple[int, Array] | None:
    """How many closures agree on where the frame of robot b lies in that of a, and where; None without any."""
    puts, places = [], []
    for closure in closures:
        target, source, z = closure.candidate.target, closure.candidate.source, closure.pose_target_source
        if (target[0], source[0]) == (b, a):
            target, source, z = source, target, inverse(z)
        if (target[0], source[0]) == (a, b):
            places.append(odometry[b][source[1]])
            puts.append(compose(compose(odometry[a][target[1]], z), inverse(places[-1])))
    if not puts:
        return None
    put, place = np.array(puts), np.array(places)
    away = np.linalg.norm((compose(put[:, None], place[None]) - compose(put, place)[None])[..., :2], axis=2)
    reach = AGREE_M + AGREE_PER_M * np.linalg.norm(place[:, None, :2] - place[None, :, :2], axis=2)
    votes = (away < reach).sum(axis=1)
    return int(votes.max()), put[int(np.argmax(votes))]


def _odometry_edges(walks: Sequence[Walk], first: Array) -> tuple[list, list, list]:
    edges, measured, information = [], [], []
    for start, walk in zip(first[:-1], walks, strict=True):
        for keyframe in walk.keyframes[1:]:
            edges.append((start + keyframe.index - 1, start + keyframe.index))
            measured.append(keyframe.motion)
            information.append(invert_symmetric(keyframe.motion_covariance))
    return edges, measured, information


def _groups(robots: int, closures: Sequence[LoopClosure]) -> tuple[tuple[int, ...], ...]:
    """Robots that believed closures tie together."""
    group = list(range(robots))
    for closure in closures:
        a, b = group[closure.candidate.target[0]], group[closure.candidate.source[0]]
        group = [min(a, b) if g in (a, b) else g for g in group]
    members = [tuple(robot for robot in range(robots) if group[robot] == g) for g in sorted(set(group))]
    return tuple(sorted(members, key=lambda robots: (-len(robots), robots)))


# --- what the map looks like ---


def point_cloud(walks: Sequence[Walk], built: OfflineMap, range_max_m: float) -> Array:
    """(n, 2) end points of all beams of the largest group, its map laid on the building."""
    true = np.concatenate([np.array(walks[robot].poses) for robot in built.groups[0]])
    pose = metrics.align_team(np.concatenate([built.poses[robot] for robot in built.groups[0]]), true)
    clouds = [
        transform_points(at, scan_points(keyframe.ranges_m, range_max_m))
        for robot in built.groups[0]
        for at, keyframe in zip(compose(pose, built.poses[robot]), walks[robot].keyframes, strict=True)
    ]
    return np.concatenate(clouds)


def wall_thickness_m(points_m: Array, walls_m: Array) -> float:
    """Mean thickness of the walls of a point cloud (n, 2): cells of 0.1 m that hold at least two points."""
    origin_m = np.floor(points_m.min(axis=0) / CELL_M) * CELL_M
    column, row = ((points_m - origin_m) / CELL_M).astype(np.int64).T
    counts = np.zeros((row.max() + 1, column.max() + 1), np.int64)
    np.add.at(counts, (row, column), 1)
    return metrics.wall_thickness_m(counts, origin_m, CELL_M, np.zeros(3), walls_m, GHOST_REACH_M, wall_above=1)
