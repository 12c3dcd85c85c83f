"""Whether the rejected closures of a map agree on another one. That they contradict it says little: rooms that look
alike make many false closures, each of which says something else."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from twc_env.config import PoseGraphConfig
from twc_env.slam.mapping.team_graph import TeamGraph
from twc_env.slam.pose_graph.robust_back_end import EPISODE_KEYS_MAX, solve

Pair = tuple[int, int]


def rival_votes(team: TeamGraph, robots: Sequence[int]) -> dict[Pair, tuple[int, int]]:
    """Per pair of robots in one map (a pair of one robot: its own path), how many closures between them are used, and
    how many rejected ones agree with each other and odometry where those used are left out (the search of `ours`).

    Loose closures fit anywhere along a corridor and do not count.
    """
    nodes, edges, graph, is_used = team.subgraph(robots)
    rest = np.flatnonzero(~(graph.is_closure & is_used))
    without = graph.of(rest)
    config = PoseGraphConfig(robust="ours")
    found = solve(team.poses[nodes], *without.parts, config, 0, EPISODE_KEYS_MAX, without.shared)
    agreeing = edges[rest[found.accepted & without.is_closure]]
    held, rivals = (
        Counter(_pair(closure.candidate.target[0], closure.candidate.source[0]) for closure in closures)
        for closures in (
            [c for c in team.closures_of(edges[graph.is_closure & is_used]) if not c.is_loose],
            [c for c in team.closures_of(agreeing) if not c.is_loose],
        )
    )
    return {pair: (held[pair], count) for pair, count in sorted(rivals.items())}


def _pair(a: int, b: int) -> Pair:
    return min(a, b), max(a, b)
