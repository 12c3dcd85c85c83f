"""The robots' scans as they come in, of any scanner, as circles of equal directions around each robot at one time."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.kernels.compiled import BindsAnew, Lent, borrowing_kernel, bound, parts_of
from twc_env.records.geometry import beam_directions
from twc_env.records.messages import UNSEEN_M, SensorFrame
from twc_env.records.scanner import Scanner
from twc_env.records.team_messages import TeamFrames
from twc_env.slam.scans.deskewing import ENDS, deskew, note_motion

_POSES_KEPT = 256
"""Poses of each robot that are remembered for rolling scans: 2 s at 100 Hz."""
GYRO_GAP_MAX_S = 1.0
"""Over a longer time between two frames, odometry tells the turn: the rate of the gyro is not constant."""


@borrowing_kernel
def _take_in(held, ranges, has_scan, odometry, turn_rates, now_s, circles, new):
    """Note the motion of all robots, and keep and deskew their scans: circles (robots, directions), and the same with
    rows without information where there is no new scan."""
    scans, ends_s, tracks, latest, scanner, undoes_motion, limits, rays, work, is_soft = parts_of(held)
    for i in range(ranges.shape[0]):
        track = tracks[i]
        elapsed_s = now_s - track[latest[i], 0]
        turn = turn_rates[i] * elapsed_s if elapsed_s <= GYRO_GAP_MAX_S else odometry[i, 2]
        latest[i] = note_motion(now_s, odometry[i], turn, track, latest[i])
        if has_scan[i]:
            ends_s[i] = now_s
            for b in range(ranges.shape[1]):
                scans[i, b] = ranges[i, b]
        if math.isnan(ends_s[i]):
            circles[i, :] = UNSEEN_M
        else:
            end_s = ends_s[i] if undoes_motion else now_s
            deskew(scans[i], scanner, end_s, track, latest[i], *limits, rays, work, circles[i], is_soft[i])
        for d in range(circles.shape[1]):
            new[i, d] = circles[i, d] if has_scan[i] else UNSEEN_M


class ScanIntake(BindsAnew):
    """Undoes rolling scans and mountings, robot by robot; frames without a `scanner` pass unchanged."""

    def __init__(self, config: EnvConfig, robot_count: int):
        self._beam_count = config.lidar.circle_beam_count
        self._limits = float(config.lidar.range_max_m), float(config.lidar.range_noise.typical_std_m)
        self._undoes_motion, self._rays = config.slam.undoes_rolling, beam_directions(self._beam_count)
        self.free_m = np.full(robot_count, np.inf)
        """(robots,) range up to which the floor is free in directions without return, as the latest scanner says."""
        self.is_soft = np.zeros((robot_count, self._beam_count), np.bool_)
        """(robots, directions) whether the latest scan is unsure of the wall in a direction, see `deskewing.deskew`."""
        self._tracks = np.zeros((robot_count, _POSES_KEPT, 4))
        """Rings of the robots' poses by odometry and gyro, see `deskewing.note_motion`."""
        self._tracks[:, :, 0] = -np.inf
        self._latest = np.zeros(robot_count, np.int64)
        self._scans: list[Array | None] = [None] * robot_count
        """Latest scan of each robot, ..."""
        self._ends_s = np.full(robot_count, np.nan)
        """... its time, ..."""
        self._scanners: list[Scanner | None] = [None] * robot_count
        """... and its scanner."""
        self._all_scanned = np.ones(robot_count, np.bool_)
        self._run: Callable[..., None] | None = None
        """`_take_in` for a team that has one scanner."""

    def on_circle(self, frames: Sequence[SensorFrame]) -> tuple[Sequence[SensorFrame], list[Array] | Array]:
        """The frames with circles as scans, and the latest circle of each of these frames' robots.

        Frames must have passed `check_frames` or come from the simulated world.
        """
        if isinstance(frames, TeamFrames):
            if isinstance(frames.scanner, tuple):
                return self._each(frames)
            return (frames, frames.ranges_m) if frames.scanner is None else self._together(frames, frames.scanner)
        self._run = None
        circles = [self._taken_in(frame) for frame in frames]
        return [
            frame if frame.scanner is None else _with_circle(frame, circle)
            for frame, circle in zip(frames, circles, strict=True)
        ], circles

    def _together(self, frames: TeamFrames, scanner: Scanner) -> tuple[TeamFrames, Array]:
        """The same for the whole team, which has one scanner."""
        has_scan = self._all_scanned if frames.has_scan is None else frames.has_scan
        shape = len(has_scan), self._beam_count
        circles, new = np.empty(shape), np.empty(shape)
        now = frames.ranges_m, has_scan, frames.odometry, frames.turn_rates_rad_s, frames.time_s, circles, new
        if self._run is None or self._scanners[0] is not scanner:
            self._run = bound(_take_in, self._packed(frames.ranges_m, scanner), *now)
        self._run(*now)
        together = TeamFrames(
            frames.step, frames.time_s, frames.odometry, frames.turn_rates_rad_s, new, frames.raw_wifi, frames.signs,
            None, frames.has_scan,
        )  # fmt: skip
        return together, circles

    def _each(self, frames: TeamFrames) -> tuple[TeamFrames, Array]:
        """The same for the whole team, in which each robot has a scanner of its own."""
        self._run = None
        circles = np.array([self._taken_in(frame) for frame in frames])
        new = circles if frames.has_scan is None else np.where(frames.has_scan[:, None], circles, UNSEEN_M)
        together = TeamFrames(
            frames.step, frames.time_s, frames.odometry, frames.turn_rates_rad_s, new, frames.raw_wifi, frames.signs,
            None, frames.has_scan,
        )  # fmt: skip
        return together, circles

    def _packed(self, ranges_m: Array, scanner: Scanner) -> Lent:
        """The constant arguments of `_take_in`."""
        scans = np.full(ranges_m.shape, UNSEEN_M)
        for robot, held in enumerate(self._scans):
            if held is not None and self._scanners[robot] == scanner and held.shape == scans[robot].shape:
                scans[robot] = held
            else:
                self._ends_s[robot] = np.nan
        self._scans, self._scanners, self.free_m[:] = list(scans), [scanner] * len(scans), self._free_m(scanner)
        work = np.empty((ENDS, ranges_m.shape[1] + 2))
        return Lent((
            scans, self._ends_s, self._tracks, self._latest, self._numbers(scanner), self._undoes_motion,
            self._limits, self._rays, work, self.is_soft,
        ))  # fmt: skip

    def _taken_in(self, frame: SensorFrame) -> Array:
        """The latest scan of the frame's robot on the circle, as seen from where it is now."""
        robot, track, now_s = frame.robot, self._tracks[frame.robot], float(frame.time_s)
        odometry = np.ascontiguousarray(frame.odometry, float)
        elapsed_s = now_s - track[self._latest[robot], 0]
        turn = frame.turn_rate_rad_s * elapsed_s if elapsed_s <= GYRO_GAP_MAX_S else float(odometry[2])
        self._latest[robot] = note_motion(now_s, odometry, turn, track, self._latest[robot])
        if frame.scanner is None:
            self.is_soft[robot] = False
            return frame.ranges_m
        if len(frame.ranges_m):
            self._scans[robot], self._scanners[robot] = np.array(frame.ranges_m, float), frame.scanner
            self._ends_s[robot], self.free_m[robot] = now_s, self._free_m(frame.scanner)
        held, scanner = self._scans[robot], self._scanners[robot]
        out = np.full(self._beam_count, UNSEEN_M)
        if held is not None and scanner is not None and math.isfinite(self._ends_s[robot]):
            end_s = float(self._ends_s[robot]) if self._undoes_motion else now_s
            numbers, work = self._numbers(scanner), np.empty((ENDS, len(held) + 2))
            latest, is_soft = self._latest[robot], self.is_soft[robot]
            deskew(held, numbers, end_s, track, latest, *self._limits, self._rays, work, out, is_soft)
        return out

    def _free_m(self, scanner: Scanner) -> float:
        """Range up to which a beam without return tells that the floor is free: no further than it could have
        measured, of a scanner with a shorter range than the engine's."""
        return min(scanner.free_m, scanner.range_max_m) if scanner.range_max_m < self._limits[0] else scanner.free_m

    def _numbers(self, scanner: Scanner) -> Array:
        """What `deskew` needs to know of a scanner."""
        return np.array([
            scanner.first_rad, scanner.step_rad, *scanner.mount, scanner.range_min_m, scanner.range_max_m,
            self._free_m(scanner), scanner.sweep_s if self._undoes_motion else 0.0,
        ])  # fmt: skip


def _with_circle(frame: SensorFrame, circle: Array) -> SensorFrame:
    return dataclasses.replace(frame, ranges_m=circle if len(frame.ranges_m) else circle[:0], scanner=None)
