"""Evidence of a layout of places given the fingerprints: marginal likelihood of Gaussian processes over the floor.

All transmitters share one covariance: two squared exponentials (distance; walls and shadows) and noise. The
hyperparameters maximise the evidence of the layout (Rasmussen & Williams 2006, Eq. 5.8-5.9), so nothing is assumed
known. Unlike a correlation of similarity with distance, it distinguishes a map folded at one place from a correct one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs
from scipy.optimize import minimize

VARIANCES, LENGTHS_M, NOISE = (0.8, 0.3), (15.0, 5.0), 0.08
"""Initial hyperparameters; variances are shares of the features' variance."""
ALONG_VARIANCE, ALONG_LENGTH_M = 0.1, 8.0
"""Initial values of the term for correlation along the path."""
LOG_BOUNDS = [(-7.0, 3.0)] * 2 + [(0.7, 5.5)] * 2 + [(-6.0, 1.0), (-7.0, 3.0), (0.7, 5.5)]
ITERATIONS = 6
PLACES_MAX = 350
"""With more places, only every n-th is used."""


class FieldEvidence:
    """Evidence of layouts from features (n, transmitters).

    With path lengths travel_m (n,), correlation between neighbours along the path (fading, body shadowing, averaging)
    is modelled separately from correlation by position.
    """

    def __init__(self, feature: Array, travel_m: Array | None = None, places_max: int = PLACES_MAX):
        self._every = -(-len(feature) // places_max)
        chosen = np.asarray(feature[:: self._every], float)
        chosen = chosen - chosen.mean(axis=0)
        likeness = chosen @ chosen.T
        self._likeness = likeness / max(np.trace(likeness) / len(likeness), 1e-12)
        self._along = None if travel_m is None else _squared(travel_m[:: self._every, None])

    def of(self, positions_m: Array) -> float:
        """Log evidence of positions (n, 2), per transmitter, up to a constant."""
        return self.fitted(positions_m)[0]

    def fitted(
        self, positions_m: Array, start: Array | None = None, iterations: int = ITERATIONS
    ) -> tuple[float, Array]:
        """The log evidence and the hyperparameters that maximise it: logs of variances, lengths and noise, then of
        variance and length along the path.

        `start`: initial hyperparameters.
        """
        start = self._start() if start is None else start
        squared = _squared(positions_m[:: self._every])
        found = minimize(
            lambda logs: self._cost(logs, squared), start, method="L-BFGS-B", jac=True,
            bounds=LOG_BOUNDS[: len(start)], options={"maxiter": iterations},
        )  # fmt: skip
        return -float(found.fun), found.x

    def evidence_with(self, positions_m: Array, logs: Array) -> float:
        """The log evidence at given hyperparameters."""
        covariance, _, _ = self._covariance(logs, _squared(positions_m[:: self._every]))
        factor, _ = dpotrf(covariance, lower=1)
        explained, _ = dpotrs(factor, self._likeness, lower=1)
        return -float(np.log(np.diag(factor)).sum() + 0.5 * np.trace(explained))

    def gradient(self, positions_m: Array, logs: Array) -> tuple[Array, Array]:
        """Gradient (n, 2) of the log evidence by positions [1/m] at given hyperparameters, and its Fisher information
        (n, 2, n, 2) [1/m2]."""
        count, place = len(positions_m), positions_m[:: self._every]
        difference = place[:, None] - place  # (m, m, 2)
        slope, inverse, by_squared = self._slope(logs, (difference**2).sum(axis=2))
        pull = slope * by_squared
        by_place, information = np.zeros((count, 2)), np.zeros((count, 2, count, 2))
        by_place[:: self._every] = -4 * (pull.sum(axis=1)[:, None] * place - pull @ place)
        moves = [2 * by_squared * difference[:, :, axis] for axis in range(2)]  # d row i / d place i
        through = [move @ inverse for move in moves]
        every = slice(None, None, self._every)
        for a in range(2):
            for b in range(2):
                information[every, a, every, b] = through[a] * through[b].T + (through[a] @ moves[b].T) * inverse
        return by_place, information

    def _start(self) -> Array:
        along = () if self._along is None else (ALONG_VARIANCE, ALONG_LENGTH_M)
        return np.log([*VARIANCES, *LENGTHS_M, NOISE, *along])

    def _cost(self, logs: Array, squared: Array) -> tuple[float, Array]:
        """Negative log evidence and its gradient by the log hyperparameters; squared distances (n, n)."""
        covariance, parts, along = self._covariance(logs, squared)
        size = np.exp(logs)
        factor, inverse, explained = self._solved(covariance)
        slope = 0.5 * (inverse - explained @ inverse)
        gradient = [(slope * part).sum() for part in parts]
        gradient += [(slope * part * squared).sum() / length**2 for part, length in zip(parts, size[2:4], strict=True)]
        gradient.append(size[4] * np.trace(slope))
        if along is not None:
            gradient += [(slope * along).sum(), (slope * along * self._along).sum() / size[6] ** 2]
        return float(np.log(np.diag(factor)).sum() + 0.5 * np.trace(explained)), np.array(gradient)

    def _slope(self, logs: Array, squared: Array) -> tuple[Array, Array, Array]:
        """(n, n) derivative of the cost by the covariance, the inverse covariance, and the derivative by squared
        distances."""
        covariance, parts, _ = self._covariance(logs, squared)
        _, inverse, explained = self._solved(covariance)
        lengths = np.exp(logs[2:4])
        by_squared = -0.5 * (parts[0] / lengths[0] ** 2 + parts[1] / lengths[1] ** 2)
        return 0.5 * (inverse - explained @ inverse), inverse, by_squared

    def _solved(self, covariance: Array) -> tuple[Array, Array, Array]:
        """(n, n) Cholesky factor and inverse of the covariance, and the inverse times the feature Gram matrix."""
        factor, _ = dpotrf(covariance, lower=1)
        inverse = np.tril(dpotri(factor, lower=1)[0])
        inverse += np.tril(inverse, -1).T
        return factor, inverse, inverse @ self._likeness

    def _covariance(self, logs: Array, squared: Array) -> tuple[Array, list[Array], Array | None]:
        """(n, n) total covariance, its two parts by position, and the part along the path."""
        size = np.exp(logs)
        parts = [v * np.exp(-0.5 * squared / length**2) for v, length in zip(size[:2], size[2:4], strict=True)]
        covariance = parts[0] + parts[1]
        covariance[np.diag_indices(len(covariance))] += size[4]
        if self._along is None:
            return covariance, parts, None
        along = size[5] * np.exp(-0.5 * self._along / size[6] ** 2)
        return covariance + along, parts, along


def _squared(place: Array) -> Array:
    """(n, n) squared distances."""
    return ((place[:, None] - place[None]) ** 2).sum(axis=2)
