"""The robots' scans as they come in, of any scanner, as circles of equal directions around each robot at one time."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.records.messages import UNSEEN_M, SensorFrame
from twc_env.records.scanner import Scanner
from twc_env.records.team_messages import TeamFrames
from twc_env.slam.scans.deskewing import deskew, note_motion

_POSES_KEPT = 256
"""Poses of each robot that are remembered for rolling scans: 2 s at 100 Hz."""
_GYRO_GAP_MAX_S = 1.0
"""Over a longer time between two frames, odometry tells the turn: the rate of the gyro is not constant."""


class ScanIntake:
    """Undoes rolling scans and mountings, robot by robot; frames without a `scanner` pass unchanged."""

    def __init__(self, config: EnvConfig, robot_count: int):
        self._beam_count, self._range_max_m = config.lidar.circle_beam_count, config.lidar.range_max_m
        self._undoes_motion = config.slam.undoes_rolling
        self.free_m = np.full(robot_count, np.inf)
        """(robots,) range up to which the floor is free in directions without return, as the latest scanner says."""
        self._tracks = np.zeros((robot_count, _POSES_KEPT, 4))
        """Rings of the robots' poses by odometry and gyro, see `deskewing.note_motion`."""
        self._tracks[:, :, 0] = -np.inf
        self._latest = [0] * robot_count
        self._scans: list[tuple[Array, Scanner, float] | None] = [None] * robot_count
        """Latest scan of each robot, its geometry and its time."""

    def on_circle(self, frames: Sequence[SensorFrame]) -> tuple[Sequence[SensorFrame], list[Array] | Array]:
        """The frames with circles as scans, and the latest circle of each of these frames' robots.

        Frames must have passed `check_frames` or come from the simulated world.
        """
        if isinstance(frames, TeamFrames):
            return self._together(frames)
        circles = [self._taken_in(frame) for frame in frames]
        return [
            frame if frame.scanner is None else _with_circle(frame, circle)
            for frame, circle in zip(frames, circles, strict=True)
        ], circles

    def _together(self, frames: TeamFrames) -> tuple[TeamFrames, Array]:
        if frames.scanner is None:
            return frames, frames.ranges_m
        circles = np.array([self._taken_in(frame) for frame in frames])
        has_scan = frames.has_scan
        new = circles if has_scan is None else np.where(has_scan[:, None], circles, UNSEEN_M)
        together = TeamFrames(
            frames.step, frames.time_s, frames.odometry, frames.turn_rates_rad_s, new, frames.raw_wifi, frames.signs,
            None, has_scan,
        )  # fmt: skip
        return together, circles

    def _taken_in(self, frame: SensorFrame) -> Array:
        """The latest scan of the frame's robot on the circle, as seen from where it is now."""
        robot, track = frame.robot, self._tracks[frame.robot]
        last_s = track[self._latest[robot], 0]
        elapsed_s = frame.time_s - last_s
        is_known = math.isfinite(last_s)
        odometry = np.ascontiguousarray(frame.odometry, float)
        by_gyro = is_known and elapsed_s <= _GYRO_GAP_MAX_S
        turn = frame.turn_rate_rad_s * elapsed_s if by_gyro else float(odometry[2])
        self._latest[robot] = note_motion(float(frame.time_s), odometry, turn, track, self._latest[robot])
        if frame.scanner is None:
            return frame.ranges_m
        if len(frame.ranges_m):
            self._scans[robot] = np.array(frame.ranges_m, float), frame.scanner, float(frame.time_s)
            self.free_m[robot] = frame.scanner.free_m
        held = self._scans[robot]
        out = np.empty(self._beam_count)
        if held is None:
            out[:] = UNSEEN_M
            return out
        ranges_m, scanner, end_s = held
        if not self._undoes_motion:
            end_s, scanner = float(frame.time_s), dataclasses.replace(scanner, sweep_s=0.0)
        deskew(
            ranges_m, _numbers(scanner), end_s, track, self._latest[robot], self._range_max_m,
            np.empty((4, len(ranges_m))), out,
        )  # fmt: skip
        return out


def _with_circle(frame: SensorFrame, circle: Array) -> SensorFrame:
    return dataclasses.replace(frame, ranges_m=circle if len(frame.ranges_m) else circle[:0], scanner=None)


@lru_cache(maxsize=64)
def _numbers(scanner: Scanner) -> Array:
    """What `deskew` needs to know of a scanner."""
    return np.array(
        [scanner.first_rad, scanner.step_rad, *scanner.mount, scanner.range_min_m, scanner.range_max_m,
         scanner.free_m, scanner.sweep_s]
    )  # fmt: skip
