"""Where a robot goes straight in a building, it mostly goes along one of two directions at right angles: its walls'.

Heuristic drift elimination (Borenstein & Ojeda 2010) for a whole path at once: which directions these are and what part
of the ways follows them is fitted to each path; where few do, little is claimed. How near ways keep to them comes from
robots in real buildings; scripted walks keep far nearer, within a degree, and are given no credit for it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.geometry import wrap_angle

STD_RAD, LENGTH_M = np.radians(5.0), 3.0
"""How far ways of this length or longer are off the walls that they follow. In the laser logs of five buildings it is
2.8 to 5.7 degrees, 4.9 in the middle, and the share 0.28 to 0.91 (`reproduce building-axes`)."""
LENGTH_MIN_M = 0.01
TURNS = 12


@dataclass(frozen=True, slots=True)
class BuildingAxes:
    """The directions of the ways between places (p, 2) as a mixture: along the axes of a building, or anyhow."""

    share: float = 0.5
    """Of the ways that follow axes."""
    std_rad: float = STD_RAD
    """How far these are off, where they are `LENGTH_M` long or longer."""

    def fitted(self, places: Array) -> BuildingAxes:
        """With the share that these places show."""
        axes = self
        for _ in range(TURNS):
            axes = replace(axes, share=float(axes._along(places)[1].mean()))
        return axes

    def strayed_rad(self, places: Array) -> float:
        """How far ways of places at least `LENGTH_M` apart are off the axes that they follow."""
        off, along, _ = self._along(places)
        return float(np.sqrt((along * off**2).sum() / max(along.sum(), 1e-12)))

    def cost(self, places: Array) -> float:
        """Minus the logarithm of the probability of places, by the likeliest axes, against ways anyhow."""
        off, _, std = self._along(places)
        return -float(np.log(1.0 - self.share + self.share * _density(off, std)).sum())

    def slopes(self, places: Array) -> tuple[Array, Array]:
        """Of minus the cost: its slopes (p, 2) by the places [1/m], and the information (p, 2, p, 2) that axes, not
        known beforehand, hold of them [1/m2]. By how ways turn alone: no way shall grow so that it keeps to axes
        more surely, as ways shorter than `LENGTH_M` would."""
        off, along, std = self._along(places)
        weight = along / std**2
        information = np.diag(weight) - np.outer(weight, weight) / max(weight.sum(), 1e-12)
        ways, count = np.diff(places, axis=0), len(places)
        length2 = np.maximum((ways**2).sum(axis=1), LENGTH_MIN_M**2)
        turns, k = np.zeros((len(ways), count, 2)), np.arange(len(ways))
        turns[k, k + 1] = np.column_stack([-ways[:, 1], ways[:, 0]]) / length2[:, None]
        turns[k, k] = -turns[k, k + 1]
        flat = turns.reshape(len(ways), -1)
        return (-(weight * off) @ flat).reshape(count, 2), (flat.T @ information @ flat).reshape(2 * (count, 2))

    def _along(self, places: Array) -> tuple[Array, Array, Array]:
        """(p - 1,) by how much ways are off the likeliest axes, how probably they follow them, and how far off those
        that do are."""
        ways = np.diff(places, axis=0)
        direction = np.arctan2(ways[:, 1], ways[:, 0])
        length = np.maximum(np.hypot(ways[:, 0], ways[:, 1]), LENGTH_MIN_M)
        std = self.std_rad * np.maximum(1.0, LENGTH_M / length)
        axis = float(np.angle(np.exp(4j * direction).sum())) / 4
        for _ in range(TURNS):
            off = wrap_angle(4 * (direction - axis)) / 4
            density = self.share * _density(off, std)
            along = density / (1.0 - self.share + density)
            weight = along / std**2
            axis += float((weight * off).sum() / max(weight.sum(), 1e-12))
        return off, along, std


def _density(off: Array, std: Array) -> Array:
    """How many times as probable as if they went anyhow ways are that follow axes."""
    return 0.5 * np.pi * np.exp(-0.5 * (off / std) ** 2) / (std * np.sqrt(2 * np.pi))
