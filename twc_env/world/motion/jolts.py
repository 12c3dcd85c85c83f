"""Errors of odometry in single places: bumps that turn a robot, and wheels that slip at thresholds.

Borenstein and Feng, "UMBmark: a method for measuring, comparing, and correcting dead-reckoning errors in mobile
robots", University of Michigan, 1995: a cable of 9 to 10 mm under one wheel turns a robot by 0.44 degrees (quoted from
memory, not looked up: an assumption of that size).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import OdometryConfig
from twc_env.records.random_streams import random_stream

BUMP_RAD = math.radians(0.44)


class Jolts:
    """The jolts of all robots in one episode."""

    def __init__(self, own: Sequence[OdometryConfig], doorways: Array, seed: int):
        """own: of each robot; doorways (d, 4): ends x, y of each."""
        self._bumps_per_m = np.array([each.bumps_per_m for each in own])
        self._slips_m = np.array([each.threshold_slip_m for each in own])
        self._doorways = doorways if self._slips_m.any() else doorways[:0]
        self._streams = [random_stream(seed, "jolts", robot) for robot in range(len(own))]
        self._before: Array | None = None

    def carried(self, robot: int) -> None:
        """A robot was lifted and put down elsewhere: its wheels did not touch the floor on the way."""
        if self._before is not None:
            self._before[robot] = math.nan

    def apply(self, poses: Array, odometry: Array) -> None:
        """Add the errors to odometry (n, 3) of the way to the true poses (n, 3), in each step once."""
        before, self._before = self._before, poses[:, :2].copy()
        if before is None:
            return
        for robot, stream in enumerate(self._streams):
            way_m = math.dist(before[robot], poses[robot, :2])
            chance, side, slip = stream.random(), stream.random() - 0.5, stream.standard_normal()
            if math.isnan(way_m):
                continue
            is_at_sill = self._slips_m[robot] > 0.0 and self._crosses(before[robot], poses[robot, :2])
            if is_at_sill:
                forward = math.copysign(1.0, odometry[robot, 0])
                odometry[robot, 0] += forward * self._slips_m[robot] * abs(slip)
            if is_at_sill or chance < self._bumps_per_m[robot] * way_m:
                odometry[robot, 2] += math.copysign(BUMP_RAD, side)

    def _crosses(self, begin: Array, end: Array) -> bool:
        """Whether the way leads through a doorway."""
        first, last = self._doorways[:, :2], self._doorways[:, 2:]
        return bool(
            (
                (_side(first, last, begin) != _side(first, last, end))
                & (_side(begin, end, first) != _side(begin, end, last))
            ).any()
        )


def _side(begin: Array, end: Array, point: Array) -> Array:
    """Whether a point lies to the left of the line from begin to end."""
    along, to = end - begin, point - begin
    return along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0] > 0.0
