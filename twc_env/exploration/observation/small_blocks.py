"""The blocks of an observation that are a few numbers each: `lidar`, `pose`, `wifi`, `signs` and `team`.

What is kept of a robot for them stands in a row of an array, so that one compiled call serves all robots.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, robot_configs
from twc_env.exploration.observation.observation_blocks import POSE_LIMITS, beams_shown
from twc_env.exploration.observation.recent_signs import RecentSigns
from twc_env.exploration.observation.wifi_slots import slots_for, take_scans
from twc_env.kernels.compiled import Lent, borrowing_kernel, bound, parts_of
from twc_env.records.team_messages import NOBODY, TeamBeliefs, TeamFrames

SMALL = "lidar", "pose", "wifi", "signs", "team"
"""Names of the blocks."""
HALF_WAY_M = 10.0
"""Distances d are shown as d / (d + this)."""
HALF_AGE_S = 10.0
HALF_COUNT = 2.0
PATH_SPACING_M = 0.2
_FLOAT = np.dtype(np.float32)
"""Of the numbers in each block."""
_STEPS_AT_ONCE = 16
"""Steps for which blocks are made together: a row of one costs a third of an array of its own."""


class SmallBlocks:
    """Remembers the WiFi slots and the path of each robot; a block of all robots is one new array."""

    def __init__(self, config: EnvConfig, signs: RecentSigns):
        robots, shape, scanners = config.robots, config.observation, [own.lidar for own in robot_configs(config)]
        beams = np.array([lidar.beam_count for lidar in scanners])
        teammates = max(robots - 1, 1)
        self.paths_odom = np.full((robots, 3, int(shape.path_m / PATH_SPACING_M) + 3), math.nan)
        """(robots, 3, k) rings of the latest places of each robot, and of how far each was from the one before; NaN for
        places further back along the path than `observation.path_m`."""
        self.path_counts = np.zeros(robots, np.int64)
        self.teammate_places = np.full((robots, 3, teammates), math.nan)
        """Pose, in the robot's frame, of each teammate of the group, then NaN; as of the last `build`."""
        self._shapes = (
            (int(beams.max()),), (len(POSE_LIMITS),), (shape.wifi_slots,), (shape.sign_slots, 5), (teammates, 5),
        )  # fmt: skip
        rule = (
            np.array([1.0 / lidar.range_max_m for lidar in scanners]), beams, float(shape.sign_memory_s),
            float(config.dynamics.time_step_s), float(shape.path_m),
        )  # fmt: skip
        path_tails = np.zeros((robots, 2))
        """(robots, 2) how many places are left behind, and how long the path is that is shown."""
        slots = slots_for(robots, shape.wifi_slots)
        self._kept = self.path_counts, path_tails, self.paths_odom, *slots, signs.readings, self.teammate_places, *rule
        self._run: Callable[..., None] | None = None
        """`_fill_small` with what is kept."""
        self._robots = robots
        self._room, self._unseen = self._blocks_of(0), self._blocks_of(1)
        """Blocks of some steps, of which the rows before the next one are given away; and what nobody gets."""
        self._next_row = 0
        self._rows: Iterator[tuple[Array, ...]] = iter(())
        """Those from that row on."""
        self._frames: TeamFrames | None = None
        """What was noticed last; taken in once it is shown, or once there is more."""
        self._is_taken_in = True
        shown = beams_shown(config)
        self._lengths = shown if min(shown) < int(beams.max()) else None
        """(robots,) how much is shown of each robot's block `lidar`; None: all."""
        self._scans = np.zeros((robots, int(beams.max())))
        """Latest scans, of scanners that do not complete one in each step."""

    def notice(self, frames: TeamFrames, beliefs: TeamBeliefs) -> None:
        """Take in one step of all robots, whether or not it is ever shown: path and radio."""
        if not self._is_taken_in:
            self._fill(0, self._unseen, False)
        self._frames, self._beliefs, self._is_taken_in = frames, beliefs, False
        if frames.scanner is not None:
            self._hold(frames)

    def _hold(self, frames: TeamFrames) -> None:
        """Keep the latest scan of each robot, as not every step completes one."""
        if frames.has_scan is None:
            self._scans = frames.ranges_m
        elif frames.has_scan.any():
            self._scans = np.where(frames.has_scan[:, None], frames.ranges_m, self._scans)

    def build(self) -> list[tuple[Array, ...]]:
        """The blocks `SMALL` of each robot after the step that was noticed last."""
        first, blocks = self._next_row, self._room
        if first == len(blocks[0]):
            first, blocks = 0, self._blocks_of(_STEPS_AT_ONCE)
            self._room, self._rows = blocks, zip(*blocks, strict=True)
        self._fill(first, blocks, True)
        rows = list(islice(self._rows, self._robots))
        self._next_row = first + self._robots
        if self._lengths is not None:
            rows = [(lidar[:length], *others) for length, (lidar, *others) in zip(self._lengths, rows, strict=True)]
        return rows

    def _blocks_of(self, steps: int) -> tuple[Array, ...]:
        """New blocks with a row for each robot and step."""
        return tuple([np.empty((steps * self._robots, *shape), _FLOAT) for shape in self._shapes])

    def _fill(self, first: int, blocks: tuple[Array, ...], is_shown: bool) -> None:
        frames, beliefs = self._frames, self._beliefs
        assert frames is not None
        ranges_m = frames.ranges_m if frames.scanner is None else self._scans
        now = (
            not self._is_taken_in, is_shown, first, frames.time_s, frames.step, *frames.scans, ranges_m,
            beliefs.poses, beliefs.since_closure_m, beliefs.contact_steps, beliefs.teammates, beliefs.teammate_poses,
            *blocks,
        )  # fmt: skip
        if self._run is None:
            self._run = bound(_fill_small, Lent(self._kept), *now)
        self._run(*now)
        self._is_taken_in = True

    def __getstate__(self) -> dict:
        return self.__dict__ | {"_run": None, "_room": self._blocks_of(0), "_next_row": 0, "_rows": iter(())}


@borrowing_kernel
def _extend_paths(poses, counts, tails, paths, length_m):
    """Note where each robot has come to, in rings (robots, 3, k); poses (robots, 3, 3): the last is that in odom."""
    size = paths.shape[2]
    for i in range(poses.shape[0]):
        x, y, last = poses[i, 2, 0], poses[i, 2, 1], (counts[i] - 1) % size
        dx, dy = x - paths[i, 0, last], y - paths[i, 1, last]
        if counts[i] == 0 or dx * dx + dy * dy >= PATH_SPACING_M * PATH_SPACING_M:
            at, away = counts[i] % size, 0.0 if counts[i] == 0 else math.sqrt(dx * dx + dy * dy)
            paths[i, 0, at], paths[i, 1, at], paths[i, 2, at] = x, y, away
            counts[i] += 1
            tails[i, 1] += away
            while tails[i, 1] > length_m and tails[i, 0] < counts[i] - 1:
                first = int(tails[i, 0])
                tails[i, 1] -= paths[i, 2, (first + 1) % size]
                paths[i, 0, first % size] = math.nan
                tails[i, 0] += 1


@borrowing_kernel
def _fill_pose(pose, std, since_m, out):
    out[0], out[1] = pose[0], pose[1]
    out[2], out[3] = math.cos(pose[2]), math.sin(pose[2])
    out[4], out[5], out[6], out[7] = std[0], std[1], std[2], since_m
    for k in range(8):
        out[k] = min(max(out[k], -POSE_LIMITS[k]), POSE_LIMITS[k])


@borrowing_kernel
def _fill_signs(readings, now_s, memory_s, pose, rows):
    """The block `signs`: readings (slots, 4), newest first, that are not older than the memory."""
    for k in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            rows[k, j] = 0.0
    for k in range(rows.shape[0]):
        age_s = now_s - readings[k, 0]
        if age_s > memory_s + 1e-9:
            return
        dx, dy, elsewhere = readings[k, 1] - pose[0], readings[k, 2] - pose[1], readings[k, 3]
        bearing = (math.atan2(dy, dx) - pose[2] + math.pi) % (2.0 * math.pi) - math.pi
        away = math.sqrt(dx * dx + dy * dy)
        rows[k, 0], rows[k, 1] = 1.0, bearing / math.pi
        rows[k, 2] = away / (away + HALF_WAY_M)
        rows[k, 3] = min(age_s / max(memory_s, 1e-9), 1.0)
        rows[k, 4] = elsewhere / (elsewhere + HALF_COUNT)


@borrowing_kernel
def _fill_team(robot, now, time_step_s, contact_steps, teammates, pose, teammate_poses, places, rows):
    """The block `team`: how long ago the last contact with each teammate was, and where those of the same map are.

    Also these places in the robot's frame: (3, m), where they end NaN.
    """
    for k in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            rows[k, j] = 0.0
    c, s, count = math.cos(pose[2]), math.sin(pose[2]), 0
    for k in range(contact_steps.shape[0]):
        step = contact_steps[k]
        if step != NOBODY:
            age_s = max(now - step, 0) * time_step_s
            rows[k, 4] = 1.0 if step < 0 else age_s / (age_s + HALF_AGE_S)
        teammate = teammates[k]
        if teammate < 0:
            continue
        dx, dy, turn = teammate_poses[k, 0] - pose[0], teammate_poses[k, 1] - pose[1], teammate_poses[k, 2] - pose[2]
        ahead, left, turn = c * dx + s * dy, c * dy - s * dx, (turn + math.pi) % (2.0 * math.pi) - math.pi
        places[0, count], places[1, count], places[2, count] = ahead, left, turn
        away, row = math.sqrt(ahead * ahead + left * left), rows[teammate if teammate < robot else teammate - 1]
        row[0], row[1] = 1.0, math.atan2(left, ahead) / math.pi
        row[2], row[3] = away / (away + HALF_WAY_M), turn / math.pi
        count += 1
    for k in range(count, places.shape[1]):
        places[0, k] = math.nan


@borrowing_kernel
def _fill_small(
    kept, is_new, is_shown, first, now_s, step, scan_robots, macs, rssi_dbm, heard_counts, ranges, poses, since_m,
    contact_steps, teammates, teammate_poses, lidar, pose, wifi, signs, team,
):  # fmt: skip
    """Take in a step that `is_new`; if it `is_shown` fill the rows of all robots, from the first on, in each block, and
    the places of teammates.

    poses (robots, 3, 3): in the map, its spread, in odom; contact_steps, teammates, teammate_poses as in `TeamBeliefs`.
    """
    (
        path_counts, path_tails, paths, wifi_slots, levels, room, readings, teammate_places, per_metre, beams, memory_s,
        time_step_s, path_m,
    ) = parts_of(kept)  # fmt: skip
    if is_new:
        _extend_paths(poses, path_counts, path_tails, paths, path_m)
        take_scans(step + 1, scan_robots, macs, rssi_dbm, heard_counts, wifi_slots, levels, room)
    if not is_shown:
        return
    for i in range(ranges.shape[0]):
        row = first + i
        for b in range(ranges.shape[1]):
            lidar[row, b] = min(max(ranges[i, b] * per_metre[i], 0.0), 1.0)
        for b in range(beams[i], lidar.shape[1]):
            lidar[row, b] = 0.0
        for k in range(wifi.shape[1]):
            wifi[row, k] = levels[i, k]
        _fill_pose(poses[i, 0], poses[i, 1], since_m[i], pose[row])
        _fill_signs(readings[i], now_s, memory_s, poses[i, 2], signs[row])
        _fill_team(
            i, step, time_step_s, contact_steps[i], teammates[i], poses[i, 0], teammate_poses[i], teammate_places[i],
            team[row],
        )  # fmt: skip
