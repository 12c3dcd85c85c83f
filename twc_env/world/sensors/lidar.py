"""2D laser scanner model: exact ranges to walls and robots, range noise, dropouts and transparent glass."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import LidarConfig
from twc_env.kernels.compiled import borrowing_kernel
from twc_env.records.random_streams import random_stream
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.materials import MATERIALS
from twc_env.world.building.wall_index import WallIndex, index_walls
from twc_env.world.sensors.near_walls import gather_near
from twc_env.world.sensors.noise import NORMALS_PER_WORD, StepNoise, look_up_normals, normal_quantiles

_LOOK_UP_MARGIN_M = 0.5
"""Walls are looked up for all positions within this distance, and again once the robot has left them."""
_RANGE_MIN_M = 0.001
"""Minimum range of a return: the engine rejects ranges of 0."""
_EDGE_BEAMS = 0.02
"""Margin [beams] around the approximate angles of wall ends, within which beams are tested exactly."""


class Lidar:
    """The scanners of all robots in one building for one episode."""

    def __init__(
        self,
        config: LidarConfig,
        index: WallIndex,
        robot_radius_m: float | Array,
        robots: int,
        seed: int,
        glass: tuple[int, ...] = (),
    ):
        """robot_radius_m: of all robots, or of each (robots,); glass: numbers of the walls that a beam may pass."""
        self.config = config
        """Of the scanner."""
        self._solid = index.buckets()
        self._glass_m = index.walls_m[:0]
        self._sees_through = bool(glass) and config.glass_return_probability < 1.0
        if self._sees_through:
            solid, self._glass_m = _split_glass(index, glass)
            self._solid = solid.buckets()
        angles = 2 * math.pi * np.arange(config.beam_count) / config.beam_count
        self.directions = np.stack([np.cos(angles), np.sin(angles)])
        """(2, beams)."""
        self._quantiles = normal_quantiles()
        words = -(-config.beam_count // NORMALS_PER_WORD)
        self._deviates = np.empty(words * NORMALS_PER_WORD)
        self.noise = StepNoise([random_stream(seed, "lidar", robot) for robot in range(robots)], words, "bits")
        self._fixed = (
            self.directions, np.full(robots, robot_radius_m, float), config.range_max_m,
            *_near_wall_buffers(robots, len(index.walls_m)),
            self._deviates, self._quantiles, 0.0 if self._sees_through else config.range_noise_std_m,
        )  # fmt: skip
        self.is_plain = not self._sees_through and not config.dropout_probability
        """Whether `sweep` alone computes the scan: no transparent glass, no dropouts."""
        self._chance = {
            source: StepNoise(
                [random_stream(seed, source, robot) for robot in range(robots)], config.beam_count, "random"
            )
            for source in ("lidar-glass", "lidar-dropout")
        }

    def scan(self, poses: Array) -> Array:
        """True poses (n, 3) of all robots -> ranges (n, beams) [m]; the maximum range if there is no return."""
        config, ranges = self.config, np.empty((len(poses), self.config.beam_count))
        words = self.noise.next()
        sweep(*self._solid, poses, *self._fixed, words, ranges)
        if self._sees_through:
            _reflect_glass(
                self._glass_m, poses, self.directions, self._chance["lidar-glass"].next(),
                config.glass_return_probability, math.cos(config.glass_incidence_max_rad),
                config.glass_incidence_max_rad, ranges,
            )  # fmt: skip
            _add_noise(ranges, words, self._quantiles, config.range_noise_std_m, config.range_max_m, self._deviates)
        if config.dropout_probability > 0.0:
            ranges[self._chance["lidar-dropout"].next() < config.dropout_probability] = config.range_max_m
        return ranges

    @property
    def arguments(self) -> tuple:
        """Arguments of `sweep` between the poses and the ranges; of the last one, a row per step."""
        return *self._fixed, self.noise.numbers


def _near_wall_buffers(robots: int, walls: int) -> tuple[Array, ...]:
    """Arrays that persist between calls of `sweep`: walls near each robot (robots, 4, walls), their counts, the
    positions (robots, 2) at which they were looked up; scratch."""
    return (
        np.empty((robots, 4, walls)), np.zeros(robots, np.int64), np.full((robots, 2), np.nan),
        np.empty((8, walls)), np.empty(walls, np.bool_),
    )  # fmt: skip


def glass_walls(plan: Floorplan) -> tuple[int, ...]:
    """Numbers of the walls that laser beams may pass."""
    return tuple(i for i, name in enumerate(plan.wall_materials) if name and MATERIALS[name].is_glass)


@lru_cache(maxsize=8)
def _split_glass(index: WallIndex, glass: tuple[int, ...]) -> tuple[WallIndex, Array]:
    """Index of the walls that are not glass, and the glass walls (k, 4)."""
    is_glass = np.zeros(len(index.walls_m), np.bool_)
    is_glass[list(glass)] = True
    solid = index.walls_m[~is_glass] if not is_glass.all() else index.walls_m[:1] + 1e6
    return index_walls(solid.reshape(-1, 2, 2), np.zeros(len(solid))), np.ascontiguousarray(index.walls_m[is_glass])


@borrowing_kernel
def _approximate_angle(x, y):
    """Angle of (x, y) in [-pi, pi] to 1e-5 rad, branch-free (Abramowitz and Stegun 4.4.47)."""
    ax, ay = abs(x), abs(y)
    z = min(ax, ay) / max(max(ax, ay), 1e-300)
    q = z * z
    angle = z * (0.9998660 + q * (-0.3302995 + q * (0.1801410 + q * (-0.0851330 + q * 0.0208351))))
    angle = 0.5 * np.pi - angle if ay > ax else angle
    angle = np.pi - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle


@borrowing_kernel
def _project_walls(near, count, x, y, c, s, per_beam, edge, projected):
    """Fill projected (8, walls) with the walls in the robot frame; branch-free, so that the loop is vectorised.

    Rows: x, y of the begin and of the extent, in counter-clockwise order; the first and last beam that the wall may
    cover; the distances [beams] of these two from the ends of the wall.
    """
    for w in range(count):
        ax, ay, ex, ey = near[0, w] - x, near[1, w] - y, near[2, w], near[3, w]
        is_turned = ax * ey - ay * ex < 0.0
        bx, by = (ax + ex if is_turned else ax), (ay + ey if is_turned else ay)
        ex, ey = (-ex if is_turned else ex), (-ey if is_turned else ey)
        px, py, fx, fy = c * bx + s * by, c * by - s * bx, c * ex + s * ey, c * ey - s * ex
        begin, end = _approximate_angle(px, py), _approximate_angle(px + fx, py + fy)
        is_over = end < begin - 1.0
        end = end + 2.0 * np.pi if is_over else end
        begin = (
            begin + 2.0 * np.pi if (not is_over) & (end > begin + 4.0) else begin
        )  # edge-on, at the discontinuity of the angles
        offset_rad = 2.0 * np.pi if begin < 0.0 else 0.0
        begin, end = (begin + offset_rad) * per_beam, (end + offset_rad) * per_beam
        low, high = np.ceil(begin - edge), np.floor(end + edge)
        projected[0, w], projected[1, w], projected[2, w], projected[3, w] = px, py, fx, fy
        projected[4, w], projected[5, w], projected[6, w], projected[7, w] = low, high, low - begin, end - high


@borrowing_kernel
def _draw(projected, count, directions, edge, buffer):
    """Draw walls into the buffer of inverse ranges (beams,), which keeps the nearest."""
    beams = directions.shape[1]
    for w in range(count):
        px, py, fx, fy = projected[0, w], projected[1, w], projected[2, w], projected[3, w]
        offset = px * fy - py * fx
        if offset < 1e-12:
            continue
        low = int(projected[4, w])
        high = min(int(projected[5, w]), low + beams - 1)
        if projected[6, w] <= edge and low <= high and _side_of_beam(px, py, low, directions) < 0.0:
            low += 1
        if projected[7, w] <= edge and low <= high and _side_of_beam(px + fx, py + fy, high, directions) > 0.0:
            high -= 1
        gx, gy = fx / offset, fy / offset
        _draw_span(low, min(high + 1, beams), gx, gy, directions, buffer)
        if high >= beams:
            _draw_span(max(low - beams, 0), high + 1 - beams, gx, gy, directions, buffer)


@borrowing_kernel
def _draw_span(low, high, gx, gy, directions, buffer):
    """Draw a wall into beams low to high - 1; unsigned indices need no check for negative ones, so that the loop is
    vectorised."""
    ahead, aside = directions[0], directions[1]
    for b in range(np.uint64(low), np.uint64(max(high, low))):
        buffer[b] = max(buffer[b], ahead[b] * gy - aside[b] * gx)


@borrowing_kernel
def sweep(
    walls, origin, bucket, rows, columns, first, members, poses, directions, radii, range_max, near, near_counts,
    anchors, projected, stamps, deviates, quantiles, std, words, ranges,
):  # fmt: skip
    """Fill ranges (n, beams) by an angular z-buffer: each wall near a robot is drawn into the beams that it covers.

    The buffer contains inverse ranges, which along a wall are linear in the beam's direction vector. Approximate angles
    give the beams that a wall covers; the outermost are tested exactly if in doubt. The walls near a robot are looked
    up around its anchor (row of `anchors`) and reused within `_LOOK_UP_MARGIN_M` of it.
    """
    beams = directions.shape[1]
    per_beam = beams / (2.0 * np.pi)
    edge = _EDGE_BEAMS + 2e-5 * per_beam
    for i in range(poses.shape[0]):
        x, y, c, s = poses[i, 0], poses[i, 1], np.cos(poses[i, 2]), np.sin(poses[i, 2])
        if not (x - anchors[i, 0]) ** 2 + (y - anchors[i, 1]) ** 2 < _LOOK_UP_MARGIN_M * _LOOK_UP_MARGIN_M:
            anchors[i, 0], anchors[i, 1] = x, y
            near_counts[i] = gather_near(
                walls,
                origin,
                bucket,
                rows,
                columns,
                first,
                members,
                x,
                y,
                range_max,
                _LOOK_UP_MARGIN_M,
                stamps,
                projected,
                near[i],
            )
        buffer = ranges[i]
        buffer[:] = 1.0 / range_max
        _project_walls(near[i], near_counts[i], x, y, c, s, per_beam, edge, projected)
        _draw(projected, near_counts[i], directions, edge, buffer)
        for b in range(beams):
            buffer[b] = min(1.0 / buffer[b], range_max)
        for j in range(poses.shape[0]):
            if j != i:
                wx, wy = poses[j, 0] - x, poses[j, 1] - y
                _draw_disc(c * wx + s * wy, c * wy - s * wx, radii[j], directions, range_max, buffer)
    if std > 0.0:
        _add_noise(ranges, words, quantiles, std, range_max, deviates)


@borrowing_kernel
def _side_of_beam(x, y, beam, directions):
    """Positive if a beam points to the left of (x, y), negative if to the right, 0 within rounding."""
    b = beam % directions.shape[1]
    dx, dy = directions[0, b], directions[1, b]
    cross = x * dy - y * dx
    return 0.0 if abs(cross) <= 1e-9 * abs(x * dx + y * dy) else cross


@borrowing_kernel
def _draw_disc(px, py, radius, directions, range_max, ranges):
    """Draw another robot with its centre at (px, py) in the robot frame into ranges (beams,)."""
    beams = directions.shape[1]
    per_beam = beams / (2.0 * np.pi)
    distance2 = px * px + py * py
    if distance2 > (range_max + radius) ** 2 or distance2 <= radius * radius:
        return
    middle, half = np.arctan2(py, px), np.arcsin(radius / np.sqrt(distance2))
    for k in range(int(np.ceil((middle - half) * per_beam)), int(np.floor((middle + half) * per_beam)) + 1):
        b = k % beams
        ahead = px * directions[0, b] + py * directions[1, b]
        aside = px * directions[1, b] - py * directions[0, b]
        inside = radius * radius - aside * aside
        if inside >= 0.0:
            ranges[b] = min(ranges[b], ahead - np.sqrt(inside))


@borrowing_kernel
def _reflect_glass(panes, poses, directions, chance, normal_probability, cos_max, incidence_max, ranges):
    """Reduce ranges (n, beams) to the glass panes (k, 4) that reflect.

    The probability falls linearly with the incidence angle, from `normal_probability` to 0 at `incidence_max`; one draw
    per beam is used for all panes.
    """
    for i in range(poses.shape[0]):
        c, s = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        for w in range(panes.shape[0]):
            ax, ay = panes[w, 0] - poses[i, 0], panes[w, 1] - poses[i, 1]
            ex, ey = panes[w, 2] - panes[w, 0], panes[w, 3] - panes[w, 1]
            length = np.sqrt(ex * ex + ey * ey)
            offset = ax * ey - ay * ex
            for b in range(directions.shape[1]):
                dx = c * directions[0, b] - s * directions[1, b]
                dy = s * directions[0, b] + c * directions[1, b]
                closing = dx * ey - dy * ex
                cos_incidence = abs(closing) / length
                if cos_incidence <= cos_max or offset * closing < 0.0:
                    continue
                along = (ax * dy - ay * dx) / closing
                if along < 0.0 or along > 1.0 or offset / closing >= ranges[i, b]:
                    continue
                if chance[i, b] < normal_probability * (1.0 - np.arccos(min(cos_incidence, 1.0)) / incidence_max):
                    ranges[i, b] = offset / closing


@borrowing_kernel
def _add_noise(ranges, words, quantiles, std, range_max, deviates):
    """Add Gaussian noise to ranges (n, beams) below the maximum; deviates (5 words,) is scratch."""
    for i in range(ranges.shape[0]):
        look_up_normals(words[i], quantiles, deviates)
        row = ranges[i]
        for b in range(row.shape[0]):
            noisy = min(max(row[b] + std * deviates[b], _RANGE_MIN_M), range_max)
            row[b] = noisy if row[b] < range_max else range_max
