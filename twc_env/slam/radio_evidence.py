"""How well a layout of places explains what was heard at them: the evidence of Gaussian processes over the floor.

All transmitters share one covariance: two squared exponentials, one for how strength falls with distance and one for
walls and shadows, and noise. Their sizes are those under which the layout has most evidence (Rasmussen & Williams 2006,
Eq. 5.8-5.9), so nothing is known beforehand. Unlike a correlation of likeness with distance it tells a map that is
folded at one place from one that is right.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.optimize import minimize

Array = NDArray

VARIANCES, LENGTHS_M, NOISE = (0.8, 0.3), (15.0, 5.0), 0.08
"""Where the search begins; variances are shares of the features' own."""
LOG_BOUNDS = [(-7.0, 3.0)] * 2 + [(0.7, 5.5)] * 2 + [(-6.0, 1.0)]
ITERATIONS = 6
PLACES_MAX = 350
"""Of more places, only every so many judge."""


class FieldEvidence:
    """What features (n, transmitters) say of layouts."""

    def __init__(self, feature: Array):
        self._every = -(-len(feature) // PLACES_MAX)
        chosen = np.asarray(feature[:: self._every], float)
        chosen = chosen - chosen.mean(axis=0)
        likeness = chosen @ chosen.T
        self._likeness = likeness / max(np.trace(likeness) / len(likeness), 1e-12)

    def of(self, positions_m: Array) -> float:
        """Logarithm of the evidence of positions (n, 2), per transmitter, up to a constant."""
        place = positions_m[:: self._every]
        squared = ((place[:, None] - place[None]) ** 2).sum(axis=2)
        start = np.log([*VARIANCES, *LENGTHS_M, NOISE])
        found = minimize(
            self._cost, start, (squared,), "L-BFGS-B", True, bounds=LOG_BOUNDS, options={"maxiter": ITERATIONS}
        )
        return -float(found.fun)

    def _cost(self, logs: Array, squared: Array) -> tuple[float, Array]:
        """Minus the log evidence, and its slopes by the logarithms of variances, lengths and noise."""
        size = np.exp(logs)
        variance, length2, noise = size[:2], size[2:4] ** 2, size[4]
        parts = [v * np.exp(-0.5 * squared / l2) for v, l2 in zip(variance, length2, strict=True)]
        covariance = parts[0] + parts[1]
        covariance[np.diag_indices(len(covariance))] += noise
        factor, _ = dpotrf(covariance, lower=1)
        inverse = np.tril(dpotri(factor, lower=1)[0])
        inverse += np.tril(inverse, -1).T
        explained = inverse @ self._likeness
        slope = 0.5 * (inverse - explained @ inverse)
        slopes = [(slope * part).sum() for part in parts]
        slopes += [(slope * part * squared).sum() / l2 for part, l2 in zip(parts, length2, strict=True)]
        slopes.append(noise * np.trace(slope))
        return float(np.log(np.diag(factor)).sum() + 0.5 * np.trace(explained)), np.array(slopes)
