"""Runs the engine briefly on synthetic frames, so that its kernels are compiled and cached on disk.

`twc_env.exploration.warm_up` begins with this.
"""

from __future__ import annotations

import numpy as np

from twc_env.config import EnvConfig
from twc_env.records.geometry import between
from twc_env.records.messages import SignReading, WifiScan
from twc_env.records.team_messages import TeamFrames
from twc_env.slam.engine import CooperativeSlam
from twc_env.slam.pose_graph.robust_back_end import BackendResult, revise
from twc_env.slam.pose_graph.solver import Graph

ROBOTS, STEPS, BEAMS = 2, 3, 180
DISC_AWAY_M, DISC_RADIUS_M = 1.0, 0.2
PLACES, BACK, FALSE = 40, 4, 6
"""Keyframes of a straight path, distance in keyframes of its closures, and number of false closures."""


def synthetic_frames(step: int) -> TeamFrames:
    """Frames of two robots that move slowly in the middle of a square room, with a disc ahead."""
    angles = 2 * np.pi * np.arange(BEAMS) / BEAMS
    walls_m = 3.0 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    inside = DISC_RADIUS_M**2 - (DISC_AWAY_M * np.sin(angles)) ** 2
    disc_m = DISC_AWAY_M * np.cos(angles) - np.sqrt(np.maximum(inside, 0.0))
    scan_m = np.where((inside > 0) & (np.cos(angles) > 0), disc_m, walls_m)
    odometry = np.zeros((ROBOTS, 3))
    odometry[:, 0] = 0.05 * min(step, 1)
    heard, read = WifiScan(np.arange(1, 5), np.full(4, -60.0)), SignReading("A101", 0.0, 3.0)
    ranges_m = np.repeat(scan_m[None], ROBOTS, axis=0)
    return TeamFrames(step, 0.1 * step, odometry, np.zeros(ROBOTS), ranges_m, [heard] * ROBOTS, [(read,)] * ROBOTS)


def main() -> None:
    """A few steps of the default engine."""
    engine = CooperativeSlam(EnvConfig(), ROBOTS)
    for step in range(STEPS):
        engine.update(synthetic_frames(step))
        engine.beliefs()


def reject_false_closures() -> BackendResult:
    """Evaluate closures of which some are false: many episodes have too few of these to compile all kernels
    involved."""
    path = np.zeros((PLACES, 3))
    path[:, 0] = np.arange(PLACES)
    steps, closures = [[(k, k + apart) for k in range(PLACES - apart)] for apart in (1, BACK)]
    edges = np.array(steps + closures)
    measured = between(path[edges[:, 0]], path[edges[:, 1]])
    measured[-FALSE:, 1] += 3.0
    information = np.tile(100.0 * np.eye(3), (len(edges), 1, 1))
    graph = Graph(edges, measured, information, np.arange(len(edges)) >= len(steps))
    return revise(path, graph, np.ones(len(edges), bool), EnvConfig().slam.pose_graph, is_thorough=True)
