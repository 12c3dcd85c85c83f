"""TWC-SLAM's global mapping of whole walks at once: candidates, scan matching, one frame, one pose graph (T13-T15).

The engine does the same incrementally and with further checks; here recognisers and back ends can be combined freely.
Back ends: `plain` accepts every matched candidate, as in the paper; `robust` weighs them by a Cauchy loss (c = 3);
`pcm` keeps the pairwise consistent ones; `ours` also requires overlap and free space from scan matching, and grows the
map from the most certain closures.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env import metrics
from twc_env.config import EnvConfig, PoseGraphConfig
from twc_env.kernels.small_matrices import invert_symmetric
from twc_env.records.geometry import between, compose, inverse, transform_points
from twc_env.records.messages import Keyframe, LoopCandidate, LoopClosure
from twc_env.reproduce.routes import Walk
from twc_env.slam.matching.loop_verification import LoopVerifier
from twc_env.slam.matching.scan_matching import scan_points
from twc_env.slam.places.place_recognition import ProposalFilter, make_recogniser
from twc_env.slam.pose_graph import robust_back_end as robust_backend

BACKENDS = {
    "plain": PoseGraphConfig(robust="plain", iterations_max=100),
    "robust": PoseGraphConfig(robust="cauchy", robust_scale=9.0, iterations_max=100),
    "pcm": PoseGraphConfig(robust="pcm", iterations_max=100),
    "ours": PoseGraphConfig(robust="ours", iterations_max=100),
}
REPEAT_REACH_M = 2.0
"""A candidate closer than this to an earlier one along both paths is a repetition."""
AGREE_M, AGREE_PER_M = 0.6, 0.02
"""Closures between two robots agree on a frame if they place each other's poses within this distance."""

CELL_M, GHOST_REACH_M = 0.1, 3.0
"""Cell size of a point cloud, and the maximum distance of a ghost from its true wall."""


@dataclass(frozen=True, slots=True, eq=False)
class Matched:
    """A candidate after scan matching, and whether it is correct."""

    closure: LoopClosure
    is_right: bool
    """Within 0.5 m and 10 degrees of the truth."""


@dataclass(frozen=True, slots=True, eq=False)
class OfflineMap:
    """The poses of all keyframes from a back end."""

    poses: tuple[Array, ...]
    """One (keyframes, 3) per robot, in the frame of its group."""
    groups: tuple[tuple[int, ...], ...]
    """Robots that share a frame, the largest group first."""
    accepted: Array
    """(matched,) bool: the accepted closures."""


def candidates(config: EnvConfig, walks: Sequence[Walk]) -> list[LoopCandidate]:
    """Candidates of the configured recogniser for robots that walk simultaneously, without repetitions."""
    recogniser = make_recogniser(config.slam.place_recognition, config.lidar.range_max_m)
    is_news, found = ProposalFilter(), []
    for keyframe in in_time([w.keyframes for w in walks]):
        for candidate in recogniser.propose(keyframe):
            robot, index = candidate.target
            if is_news.is_new(walks[robot].keyframes[index], keyframe, REPEAT_REACH_M):
                found.append(candidate)
    return found


def in_time(paths: Sequence[Sequence[Keyframe]]) -> list[Keyframe]:
    """The keyframes of all robots in order of time."""
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
    """The map of one back end: `ours` gets only candidates confirmed by scan matching, the others get all."""
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
    """Poses (3,) of the odom frames in that of robot 0 (papers.md T14); zeros for a robot without closures.

    Found along a spanning tree of the pairs of robots with most closures that agree on one relative frame.
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
    """The number of closures that agree on the pose of frame b in frame a, and that pose; None without closures."""
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
    """Groups of robots connected by closures, the largest first."""
    group = list(range(robots))
    for closure in closures:
        a, b = group[closure.candidate.target[0]], group[closure.candidate.source[0]]
        group = [min(a, b) if g in (a, b) else g for g in group]
    members = [tuple(robot for robot in range(robots) if group[robot] == g) for g in sorted(set(group))]
    return tuple(sorted(members, key=lambda robots: (-len(robots), robots)))


# --- appearance of the map ---


def point_cloud(walks: Sequence[Walk], built: OfflineMap, range_max_m: float) -> Array:
    """(n, 2) end points of all beams of the largest group, aligned with the building."""
    true = np.concatenate([np.array(walks[robot].poses) for robot in built.groups[0]])
    pose = metrics.align_team(np.concatenate([built.poses[robot] for robot in built.groups[0]]), true)
    clouds = [
        transform_points(at, scan_points(keyframe.ranges_m, range_max_m))
        for robot in built.groups[0]
        for at, keyframe in zip(compose(pose, built.poses[robot]), walks[robot].keyframes, strict=True)
    ]
    return np.concatenate(clouds)


def wall_thickness_m(points_m: Array, walls_m: Array) -> float:
    """Mean wall thickness of a point cloud (n, 2), from cells of 0.1 m with at least two points."""
    origin_m = np.floor(points_m.min(axis=0) / CELL_M) * CELL_M
    column, row = ((points_m - origin_m) / CELL_M).astype(np.int64).T
    counts = np.zeros((row.max() + 1, column.max() + 1), np.int64)
    np.add.at(counts, (row, column), 1)
    return metrics.wall_thickness_m(counts, origin_m, CELL_M, np.zeros(3), walls_m, GHOST_REACH_M, wall_above=1)
