"""Rao-Blackwellised particle filter with a grid map per particle, similar to GMapping; a baseline only.

Each particle moves by odometry and noise, is aligned to its own map by scan matching, and draws its pose among samples
around the match by the likelihood of scan and motion (improved proposal of Grisetti, Stachniss, Burgard 2007, IEEE T-RO
23(1), with a draw in place of its Gaussian). Particles are resampled when the effective sample size falls below half
(their Eq. 20). The result is the path and the map of the particle with the largest weight at the end.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.records.geometry import beam_directions
from twc_env.records.messages import GridMap, SensorFrame

OCCUPIED_SHARE = 0.25
"""A cell is a wall if at least this share of the beams that reached it ended in it."""
VISITS_MAX = 32_767
"""Maximum beam count per cell (16 bits)."""
NO_WALL_CELLS = 1.5
"""A beam that ends near no wall gets this distance [cells]."""
CLIMB_STEP_M, CLIMB_STEP_RAD, CLIMB_HALVINGS = 0.1, 0.05, 5
SAMPLE_STD = (0.02, 0.02, 0.005)
"""Standard deviation of the samples around a match [m, m, rad]."""
MATCHED_SHARE_MIN = 0.2
"""With a smaller share of beams near mapped walls, the particle follows odometry alone."""

AWAY_MAX = 18.0
"""Upper bound of the squared normalised distance from odometry, since wheels may slip."""
HIT_STD_M = 0.075
"""Standard deviation of a beam's end from its wall."""
STD_PER_M, STD_PER_RAD, STD_MIN = (0.1, 0.05), (0.1, 0.1), 1e-3
"""Standard deviation of a motion [m] and its turn [rad], per metre and per radian, as in GMapping; and the minimum."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ParticleFilterSettings:
    """Parameters of the filter."""

    particles: int = 20
    samples: int = 20
    """Poses sampled around each particle's match."""
    size_m: float = 80.0
    """Side length of the square maps; the robot starts in the centre."""
    cell_m: float = 0.1
    correlation: float = 20.0
    """Number of correlated beams that count as one."""


@kernel
def _is_wall(hits, visits, row, column):
    return hits[row, column] > 0 and hits[row, column] >= OCCUPIED_SHARE * visits[row, column]


@kernel
def _misfit(hits, visits, ends, inverse_m, points, n, x, y, heading):
    """Sum of the beams' squared distances from walls [cells^2], and how many beams ended near one."""
    rows, columns = hits.shape
    c, s = math.cos(heading), math.sin(heading)
    total, near = 0.0, 0
    for i in range(n):
        px, py = (
            (x + c * points[i, 0] - s * points[i, 1]) * inverse_m,
            (y + s * points[i, 0] + c * points[i, 1]) * inverse_m,
        )
        column, row = int(math.floor(px)), int(math.floor(py))
        best = NO_WALL_CELLS**2
        found = False
        if 1 <= row < rows - 1 and 1 <= column < columns - 1:
            for r in range(row - 1, row + 2):
                for k in range(column - 1, column + 2):
                    if _is_wall(hits, visits, r, k):
                        dx, dy = ends[r, k, 0] / hits[r, k] - px, ends[r, k, 1] / hits[r, k] - py
                        squared = dx * dx + dy * dy
                        if squared < best:
                            best, found = squared, True
        total += best
        near += found
    return total, near


@kernel
def _climb(hits, visits, ends, inverse_m, points, n, pose):
    """Coordinate descent of pose (3,) to a local minimum of the misfit, in place; returns it and the beams near
    walls."""
    step_m, step_rad = CLIMB_STEP_M, CLIMB_STEP_RAD
    best, near = _misfit(hits, visits, ends, inverse_m, points, n, pose[0], pose[1], pose[2])
    halvings = 0
    while halvings < CLIMB_HALVINGS:
        is_better = False
        x, y, heading = pose[0], pose[1], pose[2]
        for move in range(6):
            sign = 1.0 if move % 2 == 0 else -1.0
            dx = sign * step_m if move // 2 == 0 else 0.0
            dy = sign * step_m if move // 2 == 1 else 0.0
            turn = sign * step_rad if move // 2 == 2 else 0.0
            value, count = _misfit(hits, visits, ends, inverse_m, points, n, x + dx, y + dy, heading + turn)
            if value < best:
                best, near, is_better = value, count, True
                pose[0], pose[1], pose[2] = x + dx, y + dy, heading + turn
        if not is_better:
            step_m *= 0.5
            step_rad *= 0.5
            halvings += 1
    return best, near


@kernel
def _draw(hits, visits, ends, inverse_m, pose, ranges, range_max, directions):
    """Add a scan to a map: beams that crossed a cell (visits) or ended in it (hits), and the sum of their ends
    [cells]."""
    rows, columns = hits.shape
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x0, y0 = pose[0] * inverse_m, pose[1] * inverse_m
    for i in range(ranges.shape[0]):
        length = min(abs(ranges[i]), range_max) * inverse_m
        dx, dy = c * directions[i, 0] - s * directions[i, 1], s * directions[i, 0] + c * directions[i, 1]
        is_hit = 0.0 <= ranges[i] < range_max
        last_row, last_column = int(math.floor(y0 + length * dy)), int(math.floor(x0 + length * dx))
        steps = int(length / 0.7)
        previous_row = previous_column = -1
        for k in range(steps):
            row, column = int(math.floor(y0 + 0.7 * k * dy)), int(math.floor(x0 + 0.7 * k * dx))
            if row == previous_row and column == previous_column:
                continue
            previous_row, previous_column = row, column
            if is_hit and row == last_row and column == last_column:
                break
            if 0 <= row < rows and 0 <= column < columns:
                visits[row, column] += visits[row, column] < VISITS_MAX
        if not is_hit or not (0 <= last_row < rows and 0 <= last_column < columns):
            continue
        if visits[last_row, last_column] < VISITS_MAX:
            hits[last_row, last_column] += 1
            visits[last_row, last_column] += 1
            ends[last_row, last_column, 0] += x0 + length * dx
            ends[last_row, last_column, 1] += y0 + length * dy


@kernel
def _choose(hits, visits, ends, inverse_m, points, n, told, motion_std, scale, pick, tried, logs):
    """Index of the pose drawn from tried (samples, 3) by likelihood of scan and motion, and the log of their mean."""
    top = -np.inf
    for k in range(tried.shape[0]):
        misfit, _ = _misfit(hits, visits, ends, inverse_m, points, n, tried[k, 0], tried[k, 1], tried[k, 2])
        away = math.hypot(tried[k, 0] - told[0], tried[k, 1] - told[1]) / motion_std[0]
        turned = (tried[k, 2] - told[2]) / motion_std[2]
        logs[k] = -scale * misfit - 0.5 * min(away * away + turned * turned, AWAY_MAX)
        top = max(top, logs[k])
    total = 0.0
    for k in range(tried.shape[0]):
        logs[k] = math.exp(logs[k] - top)
        total += logs[k]
    left, chosen = pick * total, 0
    while chosen < tried.shape[0] - 1 and left >= logs[chosen]:
        left -= logs[chosen]
        chosen += 1
    return chosen, top + math.log(total / tried.shape[0])


@kernel
def _move(pose, motion, out):
    """`geometry.compose`, with the heading left unwrapped."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    out[0] = pose[0] + c * motion[0] - s * motion[1]
    out[1] = pose[1] + s * motion[0] + c * motion[1]
    out[2] = pose[2] + motion[2]


@kernel
def _step(
    poses, log_weights, hits, visits, ends, inverse_m, odometry, motion_std, moves, offsets, picks, ranges, range_max,
    directions, hit_cells, correlation, is_first,
):  # fmt: skip
    """Process one scan for each particle: move, match, draw a pose, update weight and map.

    moves (n, 3) standard normal, offsets (n, samples, 3) [m, m, rad] around the match, picks (n,) in [0, 1).
    """
    points = np.empty((ranges.shape[0], 2))
    n = 0
    for i in range(ranges.shape[0]):
        if 0.0 <= ranges[i] < range_max:
            points[n, 0], points[n, 1] = ranges[i] * directions[i, 0], ranges[i] * directions[i, 1]
            n += 1
    told, pose, tried, logs = np.empty(3), np.empty(3), np.empty(offsets.shape[1:]), np.empty(offsets.shape[1])
    scale = 0.5 / (hit_cells * hit_cells * correlation)
    for p in range(poses.shape[0]):
        if not is_first:
            _move(poses[p], odometry, told)
            _move(poses[p], odometry + motion_std * moves[p], pose)
            poses[p] = pose
            _, near = _climb(hits[p], visits[p], ends[p], inverse_m, points, n, pose)
            if near >= MATCHED_SHARE_MIN * n:
                tried[:] = pose + offsets[p]
                chosen, log_mean = _choose(
                    hits[p], visits[p], ends[p], inverse_m, points, n, told, motion_std, scale, picks[p], tried, logs
                )
                poses[p] = tried[chosen]
                log_weights[p] += log_mean
            else:
                log_weights[p] -= scale * n * NO_WALL_CELLS**2
        _draw(hits[p], visits[p], ends[p], inverse_m, poses[p], ranges, range_max, directions)


class ParticleFilter:
    """The filter for one robot; call `update` with its frames in order."""

    def __init__(self, settings: ParticleFilterSettings, range_max_m: float, rng: np.random.Generator):
        self._settings, self._range_max_m, self._rng = settings, range_max_m, rng
        cells, count = int(round(settings.size_m / settings.cell_m)), settings.particles
        self._hits, self._visits = (np.zeros((count, cells, cells), np.int16) for _ in range(2))
        self._ends = np.zeros((count, cells, cells, 2), np.float32)
        self._poses = np.tile([0.5 * settings.size_m, 0.5 * settings.size_m, 0.0], (count, 1))
        self._log_weights = np.zeros(count)
        self._low_m, self._high_m = np.full(2, np.inf), np.full(2, -np.inf)
        """Bounding box (y, x) of all particle positions so far."""
        self._past: list[Array] = []
        self._parents: list[Array] = []

    def update(self, frame: SensorFrame) -> None:
        """Process the next frame."""
        rule, count = self._settings, self._settings.particles
        moved, turned = float(np.hypot(*frame.odometry[:2])), abs(float(frame.odometry[2]))
        std_m = STD_PER_M[0] * moved + STD_PER_RAD[0] * turned + STD_MIN
        std_rad = STD_PER_M[1] * moved + STD_PER_RAD[1] * turned + STD_MIN
        parents = self._resample() if self._past else np.arange(count)
        _step(
            self._poses, self._log_weights, self._hits, self._visits, self._ends, 1.0 / rule.cell_m,
            np.asarray(frame.odometry, float), np.array([std_m, std_m, std_rad]), self._rng.normal(size=(count, 3)),
            self._rng.normal(size=(count, rule.samples, 3)) * SAMPLE_STD, self._rng.random(count), frame.ranges_m,
            self._range_max_m, beam_directions(len(frame.ranges_m)), HIT_STD_M / rule.cell_m, rule.correlation,
            not self._past,
        )  # fmt: skip
        now = self._poses[:, 1::-1]
        self._low_m, self._high_m = np.minimum(self._low_m, now.min(axis=0)), np.maximum(self._high_m, now.max(axis=0))
        self._past.append(self._poses.copy())
        self._parents.append(parents)

    def _resample(self) -> Array:
        """Resample if the effective sample size is below half; returns the index of each particle's parent."""
        count = len(self._poses)
        weights = np.exp(self._log_weights - self._log_weights.max())
        weights /= weights.sum()
        if 1.0 / (weights**2).sum() >= 0.5 * count:
            return np.arange(count)
        places = (np.arange(count) + self._rng.random()) / count
        parents = _with_survivors_in_place(np.minimum(np.searchsorted(np.cumsum(weights), places), count - 1))
        self._poses = self._poses[parents]
        drawn = self._mapped_area()
        for new in np.flatnonzero(parents != np.arange(count)):
            for maps in (self._hits, self._visits, self._ends):
                maps[new][drawn] = maps[parents[new]][drawn]
        self._log_weights[:] = 0.0
        return parents

    def _mapped_area(self) -> tuple[slice, slice]:
        """Rows and columns of the maps that particles can have changed so far."""
        cell_m, cells = self._settings.cell_m, self._hits.shape[1]
        low = np.maximum((self._low_m - self._range_max_m) / cell_m - 1, 0).astype(int)
        high = np.minimum((self._high_m + self._range_max_m) / cell_m + 2, cells).astype(int)
        return slice(low[0], high[0]), slice(low[1], high[1])

    def path(self) -> Array:
        """(frames, 3) path of the particle with the largest weight, relative to its start."""
        particle = int(np.argmax(self._log_weights))
        poses = np.empty((len(self._past), 3))
        for k in range(len(poses) - 1, -1, -1):
            poses[k] = self._past[k][particle]
            particle = self._parents[k][particle]
        poses[:, :2] -= 0.5 * self._settings.size_m
        return poses

    def grid(self) -> GridMap:
        """The map of the particle with the largest weight: walls above 0, free below."""
        particle, rule = int(np.argmax(self._log_weights)), self._settings
        hits, visits = self._hits[particle], self._visits[particle]
        is_wall = (hits > 0) & (hits >= OCCUPIED_SHARE * visits)
        log_odds = np.where(is_wall, 20, np.where(visits > 0, -20, 0)).astype(np.int16)
        return GridMap(log_odds, np.full(2, -0.5 * rule.size_m), rule.cell_m)


def _with_survivors_in_place(parents: Array) -> Array:
    """The same parents (n,), reordered so that as many particles as possible keep their index."""
    count = len(parents)
    left = np.bincount(parents, minlength=count)
    survives = left > 0
    out = np.where(survives, np.arange(count), -1)
    left[survives] -= 1
    out[~survives] = np.repeat(np.arange(count), left)
    return out


def map_frames(
    frames: Iterable[SensorFrame], settings: ParticleFilterSettings, range_max_m: float, seed: int
) -> tuple[Array, GridMap]:
    """Path (frames, 3) and map from a complete log of one robot."""
    particles = ParticleFilter(settings, range_max_m, np.random.default_rng(seed))
    for frame in frames:
        particles.update(frame)
    return particles.path(), particles.grid()
