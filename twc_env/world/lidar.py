"""What a 2D laser scanner measures: exact ranges to walls and other robots, range noise, dropouts, unseen glass."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from twc_env.config import LidarConfig
from twc_env.random_streams import random_stream
from twc_env.world.floorplan import Floorplan
from twc_env.world.materials import MATERIALS
from twc_env.world.noise import StepNoise
from twc_env.world.wall_index import WallIndex, index_walls

Array = NDArray

_SWEEP_WALLS_MAX = 300
"""Up to this many walls are swept one by one; with more, each beam walks the buckets of the wall index."""


class Lidar:
    """The scanners of all robots in one building for one episode."""

    def __init__(
        self,
        config: LidarConfig,
        index: WallIndex,
        robot_radius_m: float,
        robots: int,
        seed: int,
        glass: tuple[int, ...] = (),
    ):
        """`glass` names the walls of the index that a beam may pass."""
        self._config, self._index, self._radius_m = config, index, robot_radius_m
        self._solid, self._glass_m = index, index.walls_m[:0]
        if glass and config.glass_return_probability < 1.0:
            self._solid, self._glass_m = _apart(index, glass)
        angles = 2 * math.pi * np.arange(config.beam_count) / config.beam_count
        self._directions = np.column_stack([np.cos(angles), np.sin(angles)])  # (beams, 2)
        self._noise = StepNoise([random_stream(seed, "lidar", robot) for robot in range(robots)], config.beam_count)
        self._chance = {
            source: StepNoise(
                [random_stream(seed, source, robot) for robot in range(robots)], config.beam_count, "random"
            )
            for source in ("lidar-glass", "lidar-dropout")
        }

    def scan(self, poses: Array) -> Array:
        """True poses (n, 3) of all robots -> measured ranges (n, beams) [m]; no return reads the maximum range."""
        config = self._config
        ranges = self._ranges(poses, self._solid)
        if len(self._glass_m):
            _see_glass(
                self._glass_m, poses, self._directions, self._chance["lidar-glass"].next(),
                config.glass_return_probability, math.cos(config.glass_incidence_max_rad),
                config.glass_incidence_max_rad, ranges,
            )  # fmt: skip
        _add_noise(ranges, self._noise.next(), config.range_noise_std_m, config.range_max_m)
        if config.dropout_probability > 0.0:
            ranges[self._chance["lidar-dropout"].next() < config.dropout_probability] = config.range_max_m
        return ranges

    def true_ranges(self, poses: Array) -> Array:
        """True poses (n, 3) -> exact ranges (n, beams) [m], cut at the maximum range; glass counts as wall."""
        return self._ranges(poses, self._index)

    def _ranges(self, poses: Array, i: WallIndex) -> Array:
        ranges = np.empty((len(poses), self._config.beam_count))
        far = self._config.range_max_m
        if len(i.walls_m) <= _SWEEP_WALLS_MAX:
            _sweep_walls(i.walls_m, poses, self._directions, far, ranges)
        else:
            _walk_buckets(
                i.walls_m, i.origin_m, i.bucket_m, *i.shape, i.first, i.members, poses, self._directions, far, ranges
            )
        if len(poses) > 1:
            _sweep_discs(poses, self._radius_m, self._directions, far, ranges)
        return ranges


def glass_walls(plan: Floorplan) -> tuple[int, ...]:
    """Numbers of the walls that a laser may pass."""
    return tuple(i for i, name in enumerate(plan.wall_materials) if name and MATERIALS[name].is_glass)


@lru_cache(maxsize=8)
def _apart(index: WallIndex, glass: tuple[int, ...]) -> tuple[WallIndex, Array]:
    """The walls without the glass ones, and the glass ones (k, 4)."""
    is_glass = np.zeros(len(index.walls_m), np.bool_)
    is_glass[list(glass)] = True
    solid = index.walls_m[~is_glass] if not is_glass.all() else index.walls_m[:1] + 1e6
    return index_walls(solid.reshape(-1, 2, 2), np.zeros(len(solid))), np.ascontiguousarray(index.walls_m[is_glass])


@njit(cache=True, error_model="numpy")
def _sweep_walls(walls, poses, directions, far, ranges):
    """Angular z-buffer: each wall is drawn into the beams it covers, the nearest wins."""
    beams = directions.shape[0]
    per_beam = beams / (2.0 * np.pi)
    for i in range(poses.shape[0]):
        x, y = poses[i, 0], poses[i, 1]
        c, s = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        for b in range(beams):
            ranges[i, b] = far
        for w in range(walls.shape[0]):
            ax, ay = walls[w, 0] - x, walls[w, 1] - y
            ex, ey = walls[w, 2] - walls[w, 0], walls[w, 3] - walls[w, 1]
            t = min(max(-(ax * ex + ay * ey) / (ex * ex + ey * ey), 0.0), 1.0)
            nx, ny = ax + t * ex, ay + t * ey
            if nx * nx + ny * ny > far * far:
                continue
            # Into the robot frame, with the ends in counter-clockwise order.
            px, py = c * ax + s * ay, c * ay - s * ax
            fx, fy = c * ex + s * ey, c * ey - s * ex
            offset = px * fy - py * fx
            if offset < 0.0:
                px, py, fx, fy = px + fx, py + fy, -fx, -fy
                offset = -offset
            begin, end = np.arctan2(py, px), np.arctan2(py + fy, px + fx)
            if end < begin:
                end += 2.0 * np.pi
            if begin < 0.0:
                begin += 2.0 * np.pi
                end += 2.0 * np.pi
            first = int(np.ceil(begin * per_beam - 1e-9))
            last = min(int(np.floor(end * per_beam + 1e-9)), first + beams - 1, 2 * beams - 1)
            for k in range(first, last + 1):
                b = k if k < beams else k - beams
                closing = directions[b, 0] * fy - directions[b, 1] * fx
                if closing > 1e-12:
                    ranges[i, b] = min(ranges[i, b], offset / closing)


@njit(cache=True, error_model="numpy")
def _walk_buckets(walls, origin, bucket, rows, columns, first, members, poses, directions, far, ranges):
    """Each beam visits the buckets on its way until a wall in them is nearer than the next bucket."""
    for i in range(poses.shape[0]):
        gx, gy = (poses[i, 0] - origin[0]) / bucket, (poses[i, 1] - origin[1]) / bucket
        c0, s0 = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        for b in range(directions.shape[0]):
            dx = c0 * directions[b, 0] - s0 * directions[b, 1]
            dy = s0 * directions[b, 0] + c0 * directions[b, 1]
            column, row = int(np.floor(gx)), int(np.floor(gy))
            step_c, step_r = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
            rate_x, rate_y = bucket / max(abs(dx), 1e-12), bucket / max(abs(dy), 1e-12)
            next_x = (column + 1 - gx if dx > 0 else gx - column) * rate_x
            next_y = (row + 1 - gy if dy > 0 else gy - row) * rate_y
            nearest, entered = far, 0.0
            while entered <= nearest and 0 <= column < columns and 0 <= row < rows:
                cell = row * columns + column
                for m in range(first[cell], first[cell + 1]):
                    w = members[m]
                    ax, ay = walls[w, 0] - poses[i, 0], walls[w, 1] - poses[i, 1]
                    ex, ey = walls[w, 2] - walls[w, 0], walls[w, 3] - walls[w, 1]
                    closing = dx * ey - dy * ex
                    if abs(closing) < 1e-12:
                        continue
                    along = (ax * dy - ay * dx) / closing
                    if -1e-9 <= along <= 1.0 + 1e-9:
                        distance = (ax * ey - ay * ex) / closing
                        if 0.0 <= distance < nearest:
                            nearest = distance
                entered = min(next_x, next_y)
                if next_x < next_y:
                    next_x += rate_x
                    column += step_c
                else:
                    next_y += rate_y
                    row += step_r
            ranges[i, b] = nearest


@njit(cache=True, error_model="numpy")
def _sweep_discs(poses, radius, directions, far, ranges):
    """The other robots as discs."""
    beams = directions.shape[0]
    per_beam = beams / (2.0 * np.pi)
    for i in range(poses.shape[0]):
        c, s = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        for j in range(poses.shape[0]):
            wx, wy = poses[j, 0] - poses[i, 0], poses[j, 1] - poses[i, 1]
            distance2 = wx * wx + wy * wy
            if i == j or distance2 > (far + radius) ** 2 or distance2 <= radius * radius:
                continue
            px, py = c * wx + s * wy, c * wy - s * wx
            middle, half = np.arctan2(py, px), np.arcsin(radius / np.sqrt(distance2))
            for k in range(int(np.ceil((middle - half) * per_beam)), int(np.floor((middle + half) * per_beam)) + 1):
                b = k % beams
                ahead = px * directions[b, 0] + py * directions[b, 1]
                aside = px * directions[b, 1] - py * directions[b, 0]
                inside = radius * radius - aside * aside
                if inside >= 0.0:
                    ranges[i, b] = min(ranges[i, b], ahead - np.sqrt(inside))


@njit(cache=True, error_model="numpy")
def _see_glass(panes, poses, directions, chance, head_on, cos_max, incidence_max, ranges):
    """Put the panes that reflect into the ranges: the chance falls evenly from head-on to the largest incidence.

    One draw per beam decides for all panes on its way.
    """
    for i in range(poses.shape[0]):
        c, s = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        for w in range(panes.shape[0]):
            ax, ay = panes[w, 0] - poses[i, 0], panes[w, 1] - poses[i, 1]
            ex, ey = panes[w, 2] - panes[w, 0], panes[w, 3] - panes[w, 1]
            length = np.sqrt(ex * ex + ey * ey)
            offset = ax * ey - ay * ex
            for b in range(directions.shape[0]):
                dx = c * directions[b, 0] - s * directions[b, 1]
                dy = s * directions[b, 0] + c * directions[b, 1]
                closing = dx * ey - dy * ex
                cos_incidence = abs(closing) / length
                if cos_incidence <= cos_max or offset * closing < 0.0:
                    continue
                along = (ax * dy - ay * dx) / closing
                if along < 0.0 or along > 1.0 or offset / closing >= ranges[i, b]:
                    continue
                if chance[i, b] < head_on * (1.0 - np.arccos(min(cos_incidence, 1.0)) / incidence_max):
                    ranges[i, b] = offset / closing


@njit(cache=True, error_model="numpy")
def _add_noise(ranges, noise, std, far):
    for i in range(ranges.shape[0]):
        for b in range(ranges.shape[1]):
            if ranges[i, b] < far:
                ranges[i, b] = min(max(ranges[i, b] + std * noise[i, b], 0.0), far)
