"""Graduated non-convexity: truncated least squares that begins convex and hardens step by step (Yang 2020)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.slam.pose_graph import GATE, Graph


def graduated(graph: Graph, poses: Array, rounds_max: int = 100) -> tuple[Array, Array]:
    """Graduated non-convexity on truncated least squares, odometry known good (Yang 2020, Eq. 14-15)."""
    poses = graph.fit(poses, np.ones(len(graph.edges)), 30)
    largest = graph.squared_errors(poses)[graph.is_closure].max()
    weight = np.ones(len(graph.edges))
    if 2 * largest <= GATE:
        return poses, weight > 0.5
    mu = 1.0 / (2 * largest / GATE - 1)
    for _ in range(rounds_max):
        squared = graph.squared_errors(poses)
        high, low = (mu + 1) / mu * GATE, mu / (mu + 1) * GATE
        middle = np.sqrt(GATE * mu * (mu + 1) / np.maximum(squared, 1e-12)) - mu
        truncated = np.where(squared >= high, 0.0, np.where(squared <= low, 1.0, middle))
        weight = np.where(graph.is_closure, truncated, 1.0)
        poses = graph.fit(poses, weight, 5)
        if np.all(np.minimum(weight, 1 - weight) < 1e-4):
            break
        mu *= 1.4
    accepted = weight > 0.5
    return graph.fit(poses, accepted.astype(float)), accepted
