"""Laser scanners with limits and errors of real ones: field of view, mounting, rate, rolling scan, and lost returns.

`lidar.Lidar` simulates the default scanner, which has none of them, faster.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, LidarConfig, robot_configs
from twc_env.kernels.compiled import Lent, borrowing_kernel, bound, parts_of
from twc_env.records.messages import UNSEEN_M
from twc_env.records.random_streams import random_stream
from twc_env.records.scanner import Scanner
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.materials import MATERIALS
from twc_env.world.building.wall_index import WallIndex, index_walls
from twc_env.world.sensors.beam_casting import NOTHING, cast, cast_discs, place_beams
from twc_env.world.sensors.near_walls import gather_near
from twc_env.world.sensors.noise import NORMALS_PER_WORD, StepNoise, look_up_normals, normal_quantiles
from twc_env.world.sensors.scanner_errors import (
    add_noise,
    look_in_mirrors,
    lose_returns,
    mix_pixels,
    reflect_glass,
)

_LOOK_UP_MARGIN_M = 0.5
"""Walls are looked up again when a scanner is further than this from where it was at the last look."""
_FAR_M = 1e6
"""Where a wall stands that replaces none."""
_NOT_OCCLUDED_M = 1e3
"""A margin of `gather_near` with which no wall occludes another."""


class Scanners:
    """The scanners, of one kind, of all robots or some in one building for one episode."""

    def __init__(
        self,
        config: EnvConfig,
        plan: Floorplan,
        seed: int,
        discs: Array | None = None,
        members: Sequence[int] | None = None,
        things: Array | None = None,
    ):
        """plan: in the home frame; discs (k, 3): x, y and radius [m] of what else moves, updated in place; members: the
        robots, in order (None: all); things (k, 4): ends of what the plan does not have, updated in place."""
        robots, own = config.robots, robot_configs(config)
        members = range(robots) if members is None else members
        self.members = np.array(members, np.int64)
        """(m,) the robots that have this scanner."""
        lidar, count = own[members[0]].lidar, len(self.members)
        self._config = lidar
        scanner = lidar.scanner
        self.scanner = scanner or Scanner(0.0, 2 * math.pi / lidar.beam_count, range_max_m=lidar.range_max_m)
        """Geometry of the scans."""
        self.beams: tuple[int, ...] | None = None
        """As of `MixedScanners`: all have the same number."""
        step_s = config.dynamics.time_step_s
        self.period_steps = max(1, round(1.0 / (lidar.rate_hz * step_s))) if lidar.rate_hz else 1
        """Time steps from one scan to the next."""
        taus = self.scanner.sweep_s / step_s * (1.0 - np.arange(lidar.beam_count) / max(lidar.beam_count - 1, 1))
        taus = taus + lidar.delay_s / step_s
        self._discs = np.zeros((0, 3)) if discs is None else discs
        self._things = np.zeros((0, 4)) if things is None else things
        self._cast_things = np.zeros((4, len(self._things)))
        """x, y of the begin and of the extent of each."""
        self._paths = np.full((math.ceil(taus.max()) + 2, robots + len(self._discs), 3), np.nan)
        """True poses of all robots, and places of the discs, in the last steps, the latest first."""
        solid, self._panes, self._mirrors = _split(plan, lidar)
        self._walls, walls = solid.buckets(), len(solid.walls_m)
        mount = np.array(self.scanner.mount)
        speed_max_m_s = max(own[robot].dynamics.speed_max_m_s for robot in members)
        reach_m = speed_max_m_s * self.scanner.sweep_s + 2.0 * math.hypot(*mount[:2]) + 0.05
        # A mirror shows walls that the robot itself does not see.
        margin_m = _NOT_OCCLUDED_M if len(self._mirrors) else _LOOK_UP_MARGIN_M + reach_m
        self._near = np.empty((count, 4, walls)), np.zeros(count, np.int64), np.full((count, 2), np.nan)
        self._room = (
            np.empty((8, walls)), np.empty((3, max(walls, len(self._things), self._paths.shape[1]))),
            np.empty(walls, np.bool_), np.zeros(_words(lidar.beam_count) * NORMALS_PER_WORD),
            np.empty((4, lidar.beam_count)), np.empty(lidar.beam_count, np.int64),
        )  # fmt: skip
        self._geometry = taus, mount, self.scanner.first_rad, self.scanner.step_rad, lidar.range_max_m, margin_m
        self._radii = np.concatenate([[each.dynamics.robot_radius_m for each in own], self._discs[:, 2]])
        self._draws = {name: StepNoise(*draw) for name, draw in _draws(lidar, members, seed)}
        dark = np.random.default_rng([int(plan.digest, 16), zlib.crc32(b"dark")])
        self._dark = lidar.dark_share, dark.random(2), int(dark.integers(2**62))
        self._scans = 0
        """Number of scans so far."""
        self._run: Callable[..., None] | None = None
        """`_scan` with what does not change."""
        self._ranges = np.full((count, lidar.beam_count), lidar.range_max_m)

    def scan(self, step: int, poses: Array) -> tuple[Array, Array | None]:
        """Latest ranges (members, beams) [m] and whether each completed a scan in this step (None: all did).

        poses: true ones (robots, 3) of all robots, in each step once. No return is the maximum range.
        """
        is_new = not step % self.period_steps
        ranges = np.empty_like(self._ranges) if is_new else self._ranges
        if is_new:
            for draw in self._draws.values():
                draw.hold(self._scans)
        if self._run is None:
            self._run = bound(_scan, self._packed(), poses, is_new, self._scans, ranges)
        self._run(poses, is_new, self._scans, ranges)
        self._scans += is_new
        self._ranges = ranges
        return ranges, None if self.period_steps == 1 else np.full(len(self.members), is_new)

    def _packed(self) -> Lent:
        """The constant arguments of `_scan`."""
        lidar, shape = self._config, (1, len(self.members), 0)
        draws = tuple(
            self._draws[name].numbers
            if name in self._draws
            else np.zeros(shape, np.uint64 if name == "lidar" else float)
            for name in _NAMES
        )
        return Lent((
            self._paths, self._discs, self._things, self.members, self._walls, self._near, self._geometry, self._room,
            self._radii, self._panes, self._mirrors,
            (lidar.glass_return_probability, lidar.glass_incidence_max_rad, lidar.mirror_probability),
            (lidar.detection_range_m, *self._dark),
            (lidar.beam_divergence_rad, lidar.is_full_circle),
            (lidar.range_noise_std_m, lidar.range_noise_per_m, lidar.range_min_m, lidar.dropout_probability),
            self._cast_things, draws, normal_quantiles(),
        ))  # fmt: skip

    def __getstate__(self) -> dict:
        return self.__dict__ | {"_run": None}


class MixedScanners:
    """The scanners of a team with scanners of several kinds, each as `Scanners` simulates it."""

    def __init__(
        self, config: EnvConfig, plan: Floorplan, seed: int, discs: Array | None = None, things: Array | None = None
    ):
        """As of `Scanners`."""
        kinds = [own.lidar for own in robot_configs(config)]
        members = {kind: [robot for robot, own in enumerate(kinds) if own == kind] for kind in kinds}
        groups = {kind: Scanners(config, plan, seed, discs, members[kind], things) for kind in members}
        self._groups = list(groups.values())
        self.scanner = tuple(groups[kind].scanner for kind in kinds)
        """Geometry of each robot's scans ..."""
        self.beams = tuple(kind.beam_count for kind in kinds)
        """... and how many beams they have."""

    def scan(self, step: int, poses: Array) -> tuple[Array, Array]:
        """As `Scanners.scan`, of all robots; rows of fewer beams than the longest end in `UNSEEN_M`."""
        ranges = np.full((len(self.beams), max(self.beams)), UNSEEN_M)
        has_scan = np.ones(len(self.beams), np.bool_)
        for group in self._groups:
            own, is_new = group.scan(step, poses)
            ranges[group.members, : own.shape[1]] = own
            if is_new is not None:
                has_scan[group.members] = is_new
        return ranges, has_scan


_NAMES = "lidar-glass", "lidar-mirror", "lidar-loss", "lidar-edge", "lidar", "lidar-dropout"
"""Names of the random numbers, in the order in which `_scan` takes them; without columns where an error is off."""


def needs_scanners(lidar: LidarConfig) -> bool:
    """Whether `Scanners` must simulate this scanner, as it has limits or errors that `Lidar` does not know."""
    known = "range_noise_per_m", "beam_divergence_rad", "mirror_probability", "delay_s"
    return lidar.scanner is not None or any(getattr(lidar, name) > 0.0 for name in known)


def _draws(lidar: LidarConfig, members: Sequence[int], seed: int):
    """Name, streams, count and kind of the random numbers that this scanner needs for a scan."""
    beams = lidar.beam_count
    needed = {
        "lidar": (lidar.range_noise_std_m + lidar.range_noise_per_m, _words(beams), "bits"),
        "lidar-glass": (1.0 - lidar.glass_return_probability, beams, "random"),
        "lidar-mirror": (lidar.mirror_probability, beams, "random"),
        "lidar-loss": (lidar.detection_range_m, beams, "random"),
        "lidar-edge": (lidar.beam_divergence_rad, 2 * beams, "random"),
        "lidar-dropout": (lidar.dropout_probability, beams, "random"),
    }
    for name, (amount, count, kind) in needed.items():
        if amount > 0.0:
            yield name, ([random_stream(seed, name, robot) for robot in members], count, kind)


def _words(beams: int) -> int:
    """Random words for one scan's noise."""
    return -(-beams // NORMALS_PER_WORD)


def _split(plan: Floorplan, lidar: LidarConfig) -> tuple[WallIndex, Array, Array]:
    """Index of the walls that return every beam; panes (k, 4) and mirrors (k, 4) that do not, by the plan's
    materials."""
    walls_m = plan.wall_index.walls_m
    materials = [MATERIALS.get(name) for name in plan.wall_materials] or [None] * len(walls_m)
    is_pane = np.array([bool(m and m.is_glass) for m in materials]) & (lidar.glass_return_probability < 1.0)
    is_mirror = np.array([bool(m and m.is_mirror) for m in materials]) & (lidar.mirror_probability > 0.0)
    is_solid = ~(is_pane | is_mirror)
    if is_solid.all():
        return plan.wall_index, walls_m[:0], walls_m[:0]
    solid = walls_m[is_solid] if is_solid.any() else walls_m[:1] + _FAR_M
    index = index_walls(solid.reshape(-1, 2, 2), np.zeros(len(solid)))
    return index, np.ascontiguousarray(walls_m[is_pane]), np.ascontiguousarray(walls_m[is_mirror])


@borrowing_kernel
def _note_motion(paths, poses, discs, radii):
    """Make poses (robots, 3) and places of discs (k, 3) the latest of paths (steps, robots + discs, 3), and note the
    radii of discs; at first, everything has always been there."""
    robots, is_first = poses.shape[0], math.isnan(paths[0, 0, 0])
    for k in range(paths.shape[0] - 1, 0, -1):
        for j in range(paths.shape[1]):
            for m in range(3):
                paths[k, j, m] = paths[k - 1, j, m]
    for i in range(robots):
        for m in range(3):
            paths[0, i, m] = poses[i, m]
    for j in range(discs.shape[0]):
        paths[0, robots + j, 0], paths[0, robots + j, 1], paths[0, robots + j, 2] = discs[j, 0], discs[j, 1], 0.0
        radii[robots + j] = discs[j, 2]
    if is_first:
        for k in range(1, paths.shape[0]):
            for j in range(paths.shape[1]):
                for m in range(3):
                    paths[k, j, m] = paths[0, j, m]


@borrowing_kernel
def _scan(apparatus, poses, is_new, number, ranges):
    """Note the latest poses and, if a scan is complete, its number is `number`: fill ranges (members, beams)."""
    (
        paths, discs, segments, members, index, looked_up, geometry, room, radii, panes, mirrors, shiny, loss, edges,
        limits, things, draws, quantiles,
    ) = parts_of(apparatus)  # fmt: skip
    _note_motion(paths, poses, discs, radii)
    if not is_new:
        return
    for w in range(segments.shape[0]):
        things[0, w], things[1, w] = segments[w, 0], segments[w, 1]
        things[2, w], things[3, w] = segments[w, 2] - segments[w, 0], segments[w, 3] - segments[w, 1]
    glass_chance, mirror_chance, loss_chance, edge_chance, words, drop_chance = (
        draws[0][number % draws[0].shape[0]], draws[1][number % draws[1].shape[0]],
        draws[2][number % draws[2].shape[0]], draws[3][number % draws[3].shape[0]],
        draws[4][number % draws[4].shape[0]], draws[5][number % draws[5].shape[0]],
    )  # fmt: skip
    walls, origin, bucket, rows, columns, first_member, wall_members = index
    near, near_counts, anchors = looked_up
    taus, mount, first, step, range_max, margin = geometry
    scratch, spans, stamps, work, beams, hit = room
    glass_probability, incidence_max, mirror_probability = shiny
    detection, dark_share, lattice, dark_seed = loss
    cone, is_closed = edges
    std, std_per_m, range_min, drop_probability = limits
    count = ranges.shape[1]
    for i in range(ranges.shape[0]):
        begin, mean_step, spread = place_beams(paths[:, members[i]], taus, mount, first, step, beams)
        x, y = beams[0, count - 1], beams[1, count - 1]
        if not (x - anchors[i, 0]) ** 2 + (y - anchors[i, 1]) ** 2 < _LOOK_UP_MARGIN_M * _LOOK_UP_MARGIN_M:
            anchors[i, 0], anchors[i, 1] = x, y
            near_counts[i] = gather_near(
                walls, origin, bucket, rows, columns, first_member, wall_members, x, y, range_max, margin, stamps,
                scratch, near[i],
            )  # fmt: skip
        reach = 0.0
        for b in range(count):
            ranges[i, b], hit[b] = range_max, NOTHING
            reach = max(reach, (beams[0, b] - x) ** 2 + (beams[1, b] - y) ** 2)
        reach = math.sqrt(reach)
        row, centre = ranges[i], beams[:2, count - 1]
        cast(near[i], near_counts[i], beams, centre, begin, mean_step, spread, reach, range_max, spans, row, hit)
        if things.shape[1] > 0:
            for b in range(count):
                work[b] = row[b]
            cast(things, things.shape[1], beams, centre, begin, mean_step, spread, reach, range_max, spans, row, hit)
            for b in range(count):
                if row[b] < work[b]:
                    hit[b] = NOTHING
        cast_discs(
            paths, taus, radii, members[i], beams, centre, begin, mean_step, spread, reach, range_max, spans, row, hit
        )  # fmt: skip
        if panes.shape[0] > 0:
            reflect_glass(panes, beams, glass_chance[i], glass_probability, incidence_max, row, hit)
        if mirrors.shape[0] > 0:
            look_in_mirrors(
                mirrors, near[i], near_counts[i], beams, mirror_chance[i], mirror_probability, range_max, row, hit
            )
        if loss_chance.shape[1] > 0:
            lose_returns(near[i], beams, hit, loss_chance[i], detection, dark_share, lattice, dark_seed, range_max, row)
        if edge_chance.shape[1] > 0:
            chance = edge_chance[i].reshape(2, count)
            mix_pixels(hit, chance, cone, abs(step), range_max, is_closed, work, row)
        look_up_normals(words[i], quantiles, work)  # without words, any numbers that are finite
        add_noise(work, std, std_per_m, range_min, range_max, row)
        if drop_chance.shape[1] > 0:
            for b in range(count):
                if drop_chance[i, b] < drop_probability:
                    row[b] = range_max
