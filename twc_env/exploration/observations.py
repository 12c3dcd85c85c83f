"""What agents see: a function of sensor frames and estimates alone. No truth is among its arguments."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from twc_env.config import EnvConfig
from twc_env.exploration import map_view
from twc_env.exploration.observation_blocks import POSE_LIMITS, block_spaces, joined
from twc_env.exploration.wifi_slots import slots_for, take_scans
from twc_env.kernels import borrowing_kernel, kernel
from twc_env.messages import Belief, KnownSign, SensorFrame, SignReading
from twc_env.planning.candidates import NOTHING, Candidates, features_of
from twc_env.slam.dead_reckoning import DeadReckoning
from twc_env.team_messages import NOBODY, TeamBeliefs, TeamFrames

Array = NDArray

HALF_WAY_M = 10.0
"""Distances d are shown as d / (d + this)."""
HALF_AGE_S = 10.0
HALF_COUNT = 2.0
PATH_SPACING_M = 0.2
OVERVIEW_PERIOD_STEPS = 10


class ObservationBuilder:
    """Builds the observations of a team; remembers the WiFi slots, path and recent readings of each robot.

    A block of all robots is one new array, of which each robot gets a row. What is kept of a robot stands in a row of
    an array too, so that one compiled call serves all robots.
    """

    def __init__(self, config: EnvConfig):
        self._config = config
        robots, shape = config.robots, config.observation
        self._robots = range(robots)
        self._names = tuple(block_spaces(config))
        self._is_flat = shape.kind != "dict"
        made: dict[str, Callable[[], Sequence[Array] | Array]] = {
            "map": self._maps, "overview": self._whole_maps, "radio": self._radio_maps
        }  # fmt: skip
        self._makers = [(name, make) for name, make in made.items() if name in self._names]
        self._wifi_slots = slots_for(robots, shape.wifi_slots)
        self._texts: list[list[str]] = [[] for _ in range(robots)]
        """Of each robot's latest readings, newest first."""
        self._readings = np.zeros((robots, shape.sign_slots, 4))
        """Of each: time, x and y in the odom frame, and in how many other places the text is known."""
        self._reading_counts = np.zeros(robots, np.int64)
        self._paths_odom = np.zeros((robots, max(1, round(shape.path_m / PATH_SPACING_M)), 2))
        """Rings of the latest places of each robot."""
        self._path_counts, self._path_ends = np.zeros(robots, np.int64), np.full((robots, 2), math.inf)
        self._overviews: list[tuple[tuple[int, int], tuple[Array, Array, float]] | None] = [None] * robots
        mates = max(robots - 1, 1)
        self._mate_places, self._mate_counts = np.zeros((robots, mates, 3)), np.zeros(robots, np.int64)
        """Scratch: pose, in the robot's frame, of each mate of the group."""
        self._small_shapes = (
            (robots, config.lidar.beam_count), (robots, len(POSE_LIMITS)), (robots, shape.sign_slots, 5),
            (robots, mates, 5),
        )  # fmt: skip
        """Of the blocks `lidar`, `pose`, `signs` and `team`."""
        self._signs_of_team: Sequence[tuple[KnownSign, ...]] = ()
        self._indexed_signs: list[tuple[KnownSign, ...]] = [()] * robots
        self._sign_places = [_NO_SIGNS] * robots
        self._text_counts: list[Counter[str]] = [Counter()] * robots

    def notice(self, frames: Sequence[SensorFrame], beliefs: Sequence[Belief]) -> None:
        """Take in one step of all robots, whether or not observations are built of it: path, radio and readings."""
        self._frames, self._beliefs = TeamFrames.of(frames), TeamBeliefs.of(beliefs)
        _take_in(
            self._beliefs.poses, self._path_ends, self._path_counts, self._paths_odom, *self._frames.scans,
            *self._wifi_slots,
        )  # fmt: skip
        for robot, signs in enumerate(self._frames.signs):
            if signs:
                self._remember(robot, signs)

    def build(
        self, candidates: Sequence[Candidates] | None = None, masks: Sequence[Array] | None = None
    ) -> list[dict[str, Array]] | list[Array]:
        """The observation of each robot after the step that was noticed last; `masks`: its choices that count."""
        beliefs, names = self._beliefs, self._names
        robots = self._robots
        if beliefs.signs is not self._signs_of_team:
            self._signs_of_team = beliefs.signs
            for robot, signs in enumerate(beliefs.signs):
                if signs is not self._indexed_signs[robot]:
                    self._index_signs(robot, signs)
        blocks: dict[str, Sequence[Array] | Array] = self._small_blocks()
        for name, make in self._makers:
            blocks[name] = make()
        if "frontiers" in names:
            slots, lists = self._config.action.frontier_slots, candidates or [NOTHING] * len(robots)
            blocks["frontiers"] = [features_of(lists[r], beliefs[r].pose_map_robot, slots) for r in robots]
        if "action_mask" in names:
            blocks["action_mask"] = [np.zeros(0, np.int8) if masks is None else masks[r].copy() for r in robots]
        columns = [(name, blocks[name]) for name in names]
        seen = [{name: column[robot] for name, column in columns} for robot in robots]
        return [joined(own) for own in seen] if self._is_flat else seen

    def _small_blocks(self) -> dict[str, Sequence[Array] | Array]:
        """Those that one compiled call fills; it also places the mates in each robot's frame."""
        beliefs, frames, config = self._beliefs, self._frames, self._config
        lidar, pose, signs, team = [np.empty(shape, np.float32) for shape in self._small_shapes]
        wifi = self._wifi_slots[-1].copy()
        _fill_small(
            frames.ranges_m, 1.0 / config.lidar.range_max_m, beliefs.poses, beliefs.since_closure_m, POSE_LIMITS,
            self._readings, self._reading_counts, frames.time_s, config.observation.sign_memory_s, frames.step,
            config.dynamics.time_step_s, beliefs.contact_steps, beliefs.mates, beliefs.mate_poses, self._mate_places,
            self._mate_counts, lidar, pose, signs, team,
        )  # fmt: skip
        return {"lidar": lidar, "pose": pose, "wifi": wifi, "signs": signs, "team": team}

    def _maps(self) -> Array:
        shape, beliefs = self._config.observation, self._beliefs
        return map_view.views(
            beliefs.grids, beliefs.poses, shape.map_cells, shape.map_cell_m, self._paths_odom, self._path_counts,
            self._mate_places, self._mate_counts, self._sign_places,
        )  # fmt: skip

    def _radio_maps(self) -> list[Array]:
        """Probably free, probably wall around each robot, from signal strength alone."""
        cells, cell_m = self._config.observation.map_cells, self._config.observation.map_cell_m
        return [
            np.zeros((2, cells, cells), np.uint8)
            if belief.radio_map is None
            else map_view.crop_around(belief.radio_map, belief.pose_map_robot, cells, cell_m)[:2]
            for belief in self._beliefs
        ]

    def _whole_maps(self) -> list[Array]:
        return [self._whole_map(robot, belief) for robot, belief in enumerate(self._beliefs)]

    def _whole_map(self, robot: int, belief: Belief) -> Array:
        cells, kept = self._config.observation.overview_cells, self._overviews[robot]
        key = (belief.step // OVERVIEW_PERIOD_STEPS, belief.map_version)
        if kept is None or kept[0] != key:
            kept = self._overviews[robot] = (key, map_view.shrink(belief.grid, cells))
        picture, corner_m, cell_m = kept[1]
        out = np.zeros((map_view.OVERVIEW_CHANNELS, cells, cells), np.uint8)
        out[:2] = picture
        for channel, pose in [(2, belief.pose_map_robot), *((3, pose) for pose in belief.mates.values())]:
            column, row = (math.floor(v) for v in (pose[:2] - corner_m) / cell_m)
            if 0 <= row < cells and 0 <= column < cells:
                out[channel, row, column] = 255
        return out

    def _remember(self, robot: int, signs: Sequence[SignReading]) -> None:
        """Take in the texts that one robot read in this step."""
        texts, slots = self._texts[robot], self._readings.shape[1]
        for sign in signs:
            _note_reading(
                self._beliefs.poses, robot, self._frames.time_s, sign.bearing_rad, sign.range_m, self._readings,
                self._reading_counts,
            )  # fmt: skip
            texts = [sign.text, *texts[: slots - 1]]
        self._texts[robot] = texts
        if self._text_counts[robot]:
            self._count_elsewhere(robot)

    def _index_signs(self, robot: int, signs: tuple[KnownSign, ...]) -> None:
        self._indexed_signs[robot] = signs
        self._sign_places[robot], self._text_counts[robot] = _index_of(signs)
        self._count_elsewhere(robot)

    def _count_elsewhere(self, robot: int) -> None:
        for row, text in enumerate(self._texts[robot]):
            self._readings[robot, row, 3] = max(self._text_counts[robot][text] - 1, 0)


def first_observations(config: EnvConfig, frames: TeamFrames) -> list[dict[str, Array]] | list[Array]:
    """What robots would see after their first frames that have no map yet."""
    engine, builder = DeadReckoning(config, len(frames)), ObservationBuilder(config)
    engine.track(frames)
    beliefs = engine.beliefs()
    for array in (beliefs.poses, beliefs.mate_poses):  # as the engine's are: kernels know the difference
        array.setflags(write=False)
    builder.notice(frames, beliefs)
    return builder.build()


_NO_SIGNS = np.zeros((0, 2))


@lru_cache(maxsize=4)
def _index_of(signs: tuple[KnownSign, ...]) -> tuple[Array, Counter[str]]:
    """Places (k, 2) and how often each text is known; robots of one group share the list of signs."""
    return np.array([sign.position_m for sign in signs]).reshape(-1, 2), Counter([sign.text for sign in signs])


@kernel
def _extend_paths(poses, ends, counts, paths):
    """Note where each robot has come to, in rings (robots, k, 2); poses (robots, 3, 3): the last is that in odom."""
    for i in range(poses.shape[0]):
        x, y = poses[i, 2, 0], poses[i, 2, 1]
        dx, dy = x - ends[i, 0], y - ends[i, 1]
        if dx * dx + dy * dy >= PATH_SPACING_M * PATH_SPACING_M:
            at = counts[i] % paths.shape[1]
            paths[i, at, 0], paths[i, at, 1] = x, y
            ends[i, 0], ends[i, 1] = x, y
            counts[i] += 1


@borrowing_kernel
def _take_in(poses, ends, counts, paths, robots, macs, rssi_dbm, heard_counts, scans, slot_macs, last_scan, levels):
    """`_extend_paths` and `take_scans`."""
    _extend_paths(poses, ends, counts, paths)
    take_scans(robots, macs, rssi_dbm, heard_counts, scans, slot_macs, last_scan, levels)


@kernel
def _note_reading(poses, robot, time_s, bearing, away, readings, counts):
    """Put a sign before the other readings of a robot; as yet its text is known from nowhere else."""
    rows, angle = readings[robot], poses[robot, 2, 2] + bearing
    for k in range(rows.shape[0] - 1, 0, -1):
        rows[k] = rows[k - 1]
    rows[0, 0], rows[0, 3] = time_s, 0.0
    rows[0, 1], rows[0, 2] = poses[robot, 2, 0] + away * math.cos(angle), poses[robot, 2, 1] + away * math.sin(angle)
    counts[robot] = min(counts[robot] + 1, rows.shape[0])


@kernel
def _fill_pose(pose, std, since_m, limits, out):
    out[0], out[1] = pose[0], pose[1]
    out[2], out[3] = math.cos(pose[2]), math.sin(pose[2])
    out[4], out[5], out[6], out[7] = std[0], std[1], std[2], since_m
    for k in range(8):
        out[k] = min(max(out[k], -limits[k]), limits[k])


@kernel
def _fill_signs(readings, count, now_s, memory_s, pose, rows):
    """The block `signs`: readings (slots, 4), newest first, that are not older than the memory."""
    for k in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            rows[k, j] = 0.0
    for k in range(min(count, rows.shape[0])):
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


@kernel
def _as_seen_from(pose, others, out):
    """`geometry.between` of a pose and another (3,)."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy, turn = others[0] - pose[0], others[1] - pose[1], others[2] - pose[2]
    out[0], out[1] = c * dx + s * dy, c * dy - s * dx
    out[2] = (turn + math.pi) % (2.0 * math.pi) - math.pi


@kernel
def _fill_team(robot, now, time_step_s, contact_steps, mates, pose, mate_poses, places, rows):
    """The block `team`: the step in which each mate was last heard of, and where those of the same map are.

    Also these places (m, 3) in the robot's frame; gives how many they are.
    """
    for k in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            rows[k, j] = 0.0
    count = 0
    for k in range(contact_steps.shape[0]):
        step = contact_steps[k]
        if step != NOBODY:
            age_s = (now - step) * time_step_s
            rows[k, 4] = 1.0 if step < 0 else age_s / (age_s + HALF_AGE_S)
        mate = mates[k]
        if mate < 0:
            continue
        place, row = places[count], rows[mate if mate < robot else mate - 1]
        _as_seen_from(pose, mate_poses[k], place)
        away = math.sqrt(place[0] * place[0] + place[1] * place[1])
        row[0], row[1] = 1.0, math.atan2(place[1], place[0]) / math.pi
        row[2], row[3] = away / (away + HALF_WAY_M), place[2] / math.pi
        count += 1
    return count


@borrowing_kernel
def _fill_small(
    ranges, per_metre, poses, since_m, limits, readings, reading_counts, now_s, memory_s, step, time_step_s,
    contact_steps, mates, mate_poses, mate_places, mate_counts, lidar, pose, signs, team,
):  # fmt: skip
    """The blocks `lidar`, `pose`, `signs` and `team` of all robots, and the places of mates in their frames.

    poses (robots, 3, 3): in the map, its spread, in odom; contact_steps, mates, mate_poses as in `TeamBeliefs`.
    """
    for i in range(ranges.shape[0]):
        for b in range(ranges.shape[1]):
            lidar[i, b] = min(max(ranges[i, b] * per_metre, 0.0), 1.0)
        _fill_pose(poses[i, 0], poses[i, 1], since_m[i], limits, pose[i])
        _fill_signs(readings[i], reading_counts[i], now_s, memory_s, poses[i, 2], signs[i])
        mate_counts[i] = _fill_team(
            i, step, time_step_s, contact_steps[i], mates[i], poses[i, 0], mate_poses[i], mate_places[i], team[i]
        )
