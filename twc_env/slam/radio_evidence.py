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
ALONG_VARIANCE, ALONG_LENGTH_M = 0.1, 8.0
"""Likewise, of what scans near along the path share beyond their places."""
LOG_BOUNDS = [(-7.0, 3.0)] * 2 + [(0.7, 5.5)] * 2 + [(-6.0, 1.0), (-7.0, 3.0), (0.7, 5.5)]
ITERATIONS = 6
PLACES_MAX = 350
"""Of more places, only every so many judge."""


class FieldEvidence:
    """What features (n, transmitters) say of layouts.

    With the path length to each place, travel_m (n,), what neighbours along the path have in common (fading, the body's
    shadow, averaging) is told apart from what places have.
    """

    def __init__(self, feature: Array, travel_m: Array | None = None, places_max: int = PLACES_MAX):
        self._every = -(-len(feature) // places_max)
        chosen = np.asarray(feature[:: self._every], float)
        chosen = chosen - chosen.mean(axis=0)
        likeness = chosen @ chosen.T
        self._likeness = likeness / max(np.trace(likeness) / len(likeness), 1e-12)
        self._along = None if travel_m is None else _squared(travel_m[:: self._every, None])

    def of(self, positions_m: Array) -> float:
        """Logarithm of the evidence of positions (n, 2), per transmitter, up to a constant."""
        return self.fitted(positions_m)[0]

    def fitted(
        self, positions_m: Array, start: Array | None = None, iterations: int = ITERATIONS
    ) -> tuple[float, Array]:
        """The evidence, and the covariance's sizes under which it is so: logarithms of variances, lengths and noise,
        then of variance and length along the path.

        `start`: such sizes, from which the search begins.
        """
        start = self._start() if start is None else start
        squared = _squared(positions_m[:: self._every])
        found = minimize(
            lambda logs: self._cost(logs, squared)[:2], start, method="L-BFGS-B", jac=True,
            bounds=LOG_BOUNDS[: len(start)], options={"maxiter": iterations},
        )  # fmt: skip
        return -float(found.fun), found.x

    def slopes(self, positions_m: Array, logs: Array) -> tuple[float, Array]:
        """The evidence under covariances of these sizes, and its slopes (n, 2) by the positions [1/m]."""
        place = positions_m[:: self._every]
        cost, _, pull = self._cost(logs, _squared(place))
        by_place = np.zeros_like(positions_m)
        by_place[:: self._every] = -4 * (pull.sum(axis=1)[:, None] * place - pull @ place)
        return -cost, by_place

    def _start(self) -> Array:
        along = () if self._along is None else (ALONG_VARIANCE, ALONG_LENGTH_M)
        return np.log([*VARIANCES, *LENGTHS_M, NOISE, *along])

    def _cost(self, logs: Array, squared: Array) -> tuple[float, Array, Array]:
        """Minus the log evidence, its slopes by the logarithms of the sizes, and by squared distances (n, n)."""
        size = np.exp(logs)
        variance, length2, noise = size[:2], size[2:4] ** 2, size[4]
        parts = [v * np.exp(-0.5 * squared / l2) for v, l2 in zip(variance, length2, strict=True)]
        covariance = parts[0] + parts[1]
        covariance[np.diag_indices(len(covariance))] += noise
        if self._along is not None:
            along = size[5] * np.exp(-0.5 * self._along / size[6] ** 2)
            covariance += along
        factor, _ = dpotrf(covariance, lower=1)
        inverse = np.tril(dpotri(factor, lower=1)[0])
        inverse += np.tril(inverse, -1).T
        explained = inverse @ self._likeness
        slope = 0.5 * (inverse - explained @ inverse)
        slopes = [(slope * part).sum() for part in parts]
        slopes += [(slope * part * squared).sum() / l2 for part, l2 in zip(parts, length2, strict=True)]
        slopes.append(noise * np.trace(slope))
        if self._along is not None:
            slopes += [(slope * along).sum(), (slope * along * self._along).sum() / size[6] ** 2]
        pull = -0.5 * slope * (parts[0] / length2[0] + parts[1] / length2[1])
        return float(np.log(np.diag(factor)).sum() + 0.5 * np.trace(explained)), np.array(slopes), pull


def _squared(place: Array) -> Array:
    """(n, n) squared distances."""
    return ((place[:, None] - place[None]) ** 2).sum(axis=2)
