"""Prior on path directions: segments of a path in a building mostly follow one of two orthogonal wall directions.

Heuristic drift elimination (Borenstein & Ojeda 2010) for a complete path. The axes and the share of segments that
follow them are fitted to each path; a small share makes the prior weak. The standard deviation comes from robots in
real buildings; that of scripted walks, below one degree, is not used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.geometry import wrap_angle

STD_RAD, LENGTH_M = np.radians(5.0), 3.0
"""Standard deviation of the direction of segments at least this long; that of shorter ones is inversely proportional to
their length. Laser logs of five buildings: 2.8 to 5.7 degrees, median 4.9; share 0.28 to 0.91 (measured in
tests/slam/radio/test_building_axes.py)."""
LENGTH_MIN_M = 0.01
"""Shorter segments are treated as this long."""
ITERATIONS = 12
"""Of the fit of the share, and of the fit of the axis for a given share."""


@dataclass(frozen=True, slots=True)
class BuildingAxes:
    """Mixture model of the directions of the segments between positions (p, 2): along a building axis, or uniform."""

    share: float = 0.5
    """Share of the segments that follow an axis."""
    std_rad: float = STD_RAD
    """Standard deviation of their direction from the axis, for segments of `LENGTH_M` or more."""

    def fitted(self, positions: Array) -> BuildingAxes:
        """The model with the share of segments along the axes fitted to positions (n, 2) [m] of a path by expectation
        maximisation."""
        axes = self
        for _ in range(ITERATIONS):
            axes = replace(axes, share=float(axes._fit_axis(positions)[1].mean()))
        return axes

    def cost(self, positions: Array) -> float:
        """Negative log-likelihood ratio of positions (n, 2) [m] under the fitted axes against uniform directions; below
        0 where the path follows the axes."""
        deviation, _, std = self._fit_axis(positions)
        return -float(np.log(1.0 - self.share + self.share * _density(deviation, std)).sum())

    def slopes(self, positions: Array) -> tuple[Array, Array]:
        """Gradient (p, 2) of minus the cost by the positions [1/m], and information (p, 2, p, 2) [1/m2] with the axis
        direction marginalised out.

        The standard deviation's dependence on the length is not differentiated: it would lengthen short segments.
        """
        deviation, probability, std = self._fit_axis(positions)
        weight = probability / std**2
        information = np.diag(weight) - np.outer(weight, weight) / max(weight.sum(), 1e-12)
        segments, count = np.diff(positions, axis=0), len(positions)
        length2 = np.maximum((segments**2).sum(axis=1), LENGTH_MIN_M**2)
        jacobian, k = np.zeros((len(segments), count, 2)), np.arange(len(segments))
        jacobian[k, k + 1] = np.column_stack([-segments[:, 1], segments[:, 0]]) / length2[:, None]
        jacobian[k, k] = -jacobian[k, k + 1]
        flat = jacobian.reshape(len(segments), -1)
        return (-(weight * deviation) @ flat).reshape(count, 2), (flat.T @ information @ flat).reshape(2 * (count, 2))

    def _fit_axis(self, positions: Array) -> tuple[Array, Array, Array]:
        """(p - 1,) of each segment: deviation from the fitted axis [rad], probability of following it, and standard
        deviation of its direction [rad]. The axis is fitted by expectation maximisation."""
        segments = np.diff(positions, axis=0)
        direction = np.arctan2(segments[:, 1], segments[:, 0])
        length = np.maximum(np.hypot(segments[:, 0], segments[:, 1]), LENGTH_MIN_M)
        std = self.std_rad * np.maximum(1.0, LENGTH_M / length)
        axis = float(np.angle(np.exp(4j * direction).sum())) / 4
        for _ in range(ITERATIONS):
            deviation = wrap_angle(4 * (direction - axis)) / 4
            density = self.share * _density(deviation, std)
            probability = density / (1.0 - self.share + density)
            weight = probability / std**2
            axis += float((weight * deviation).sum() / max(weight.sum(), 1e-12))
        return deviation, probability, std


def _density(deviation: Array, std: Array) -> Array:
    """Likelihood ratio of a segment that follows an axis, off by this much, against a uniform direction."""
    return 0.5 * np.pi * np.exp(-0.5 * (deviation / std) ** 2) / (std * np.sqrt(2 * np.pi))
