"""Time series of an episode: poses of every time step; maps, closures and figures every few seconds.

An `EpisodeTrace` reads an environment without modifying it and is written to `trace.npz` of a run folder;
`twc-env replay RUN --html` makes a page of it. It contains ground truth and estimates.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import to_dict
from twc_env.datasets.logs.arrays_file import write_arrays
from twc_env.errors import DataError, TwcError
from twc_env.exploration.assessment import evaluation
from twc_env.exploration.assessment.map_scores import GroupScore
from twc_env.exploration.environment import ExplorationEnv
from twc_env.planning.drivers import map_id
from twc_env.records.geometry import compose, inverse
from twc_env.records.messages import GridMap
from twc_env.world.sensors.signal_map import signal_map_dbm

FORMAT = "twc_env/trace-1"
TRACE_KEYS = (
    "config", "walls_m", "signs_m", "access_points_m", "signal_dbm", "signal_place", "true_poses", "estimated_poses",
    "maps", "map_ends", "moments", "sign_texts",
)  # fmt: skip
MOMENTS_MAX = 160
"""With more recorded moments than this, every second one is dropped and the period is doubled."""
UNKNOWN, FREE, WALL = 0, 1, 2
CLOSURE_KEYS = ("kind", "status", "reason", "correct", "target_m", "source_m")


class EpisodeTrace:
    """Records one episode: create it after `reset`, call `note` after every step, then `write`."""

    def __init__(self, env: ExplorationEnv, period_s: float = 2.0):
        self._env, self._seed = env, env.episode.seed
        self._period = max(1, round(period_s / env.config.dynamics.time_step_s))
        self._estimated: list[Array] = []
        """Per time step (robots, 3), in the building frame by the alignment at the latest moment or jump of the map."""
        self._rewards: list[float] = []
        self._moments: list[tuple[dict[str, Any], list[bytes]]] = []
        """Step, figures, closures (building frame) and layers, largest group first; compressed cells of each layer."""
        self._alignment = np.zeros((env.config.robots, 3))
        """(robots, 3) alignment of the map of each robot's group with the building, as of the layers."""
        self._maps: list[tuple[int, int]] = []
        """`map_id` of each robot at that time."""
        self.note()

    def note(self, rewards: dict[str, float] | None = None) -> None:
        """Record one step; rewards: as returned by `step`.

        Raises TwcError for a step that is noted, as after `reset` or `restore`: a trace is of one episode.
        """
        step, noted = self._env.episode.steps, len(self._estimated)
        if step < noted or self._env.episode.seed != self._seed:
            now = f"the episode of seed {self._env.episode.seed} is at step {step}"
            raise TwcError(
                f"the trace has steps 0 to {noted - 1} of seed {self._seed}, and {now}: note each step once, and begin "
                "another trace after reset()"
            )
        self._rewards.append(sum(rewards.values()) if rewards else 0.0)
        if not self._moments or step - self._moments[-1][0]["step"] >= self._period:
            self._add_moment(step)
        if self._maps != list(map(map_id, self._env.engine.beliefs())):
            self._lay_maps(self._env.episode.map_scores())
        live = np.array([self._env.engine.pose_map_robot(robot) for robot in range(len(self._alignment))])
        odom = self._env.episode.record.odom_poses[len(self._estimated) : step + 1]  # a step may last many time steps
        self._estimated += list(compose(self._alignment, compose(compose(live, inverse(odom[-1])), odom)))

    def write(self, path: str | Path) -> None:
        """Write the trace, up to the last recorded step. Raises DataError if the file cannot be written."""
        env, last = self._env, len(self._estimated) - 1
        if self._moments[-1][0]["step"] != last:
            self._add_moment(last)
        packed = [cells for _, layers in self._moments for cells in layers]
        plan = env.floorplan
        signal_dbm, signal_origin_m, signal_cell_m = signal_map_dbm(plan, env.config.radio)
        try:
            write_arrays(
                path,
                format=np.array(FORMAT),
                config=np.array(json.dumps(to_dict(env.config), sort_keys=True)),
                walls_m=plan.walls_m,
                signs_m=np.array([s.position_m for s in plan.signs]).reshape(-1, 2),
                access_points_m=np.array([a.position_m for a in plan.access_points]).reshape(-1, 2),
                signal_dbm=signal_dbm.astype(np.float32),
                signal_place=np.array([*signal_origin_m, signal_cell_m]),
                true_poses=env.episode.record.true_poses[: last + 1],
                estimated_poses=np.array(self._estimated),
                odometry_poses=env.episode.record.odometry_poses()[: last + 1],
                maps=np.frombuffer(b"".join(packed), np.uint8),
                map_ends=np.cumsum([len(p) for p in packed]),
                moments=np.array(json.dumps([moment for moment, _ in self._moments])),
                sign_texts=np.array(json.dumps([s.text for s in plan.signs])),
            )
        except OSError as error:
            raise DataError(f"cannot write {path}: {error.strerror}; choose another place") from error

    def _lay_maps(self, scores: Sequence[GroupScore]) -> None:
        for score in scores:
            self._alignment[list(score.view.viewers)] = score.pose_building_map
        self._maps = list(map(map_id, self._env.engine.beliefs()))

    def _add_moment(self, step: int) -> None:
        env, scores = self._env, self._env.episode.map_scores()
        self._lay_maps(scores)
        closures, figures = evaluation.progress(env.engine, env.episode.record, env.episode.world.cells, scores)
        figures |= {"bytes_sent": env.episode.bytes_sent, "reward_sum": sum(self._rewards)}
        layers, cells = zip(*(layer_of(s.robots, s.grid, s.pose_building_map) for s in scores), strict=True)
        moment = {
            "step": step,
            "figures": {key: float(value) for key, value in figures.items()},
            "closures": [
                {key: np.asarray(row[key]).tolist() if key.endswith("_m") else row[key] for key in CLOSURE_KEYS}
                for row in closures
            ],
            "layers": layers,
        }
        self._moments.append((moment, list(cells)))
        if len(self._moments) > MOMENTS_MAX:
            self._moments, self._period = self._moments[::2], 2 * self._period


def layer_of(robots: tuple[int, ...], grid: GridMap, pose_building_map: Array) -> tuple[dict[str, Any], bytes]:
    """One group's map, and its compressed cells (rows, columns) uint8: 0 unknown, 1 free, 2 wall; row 0: lowest y."""
    kind = np.full(grid.log_odds.shape, UNKNOWN, np.uint8)
    kind[grid.log_odds < 0] = FREE
    kind[grid.log_odds > 0] = WALL
    rows, columns = (np.flatnonzero(kind.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        rows = columns = np.zeros(1, int)
    kind = kind[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    layer = {
        "robots": list(map(int, robots)),
        "shape": kind.shape,
        "origin_m": (np.asarray(grid.origin_m) + np.array([columns[0], rows[0]]) * grid.resolution_m).tolist(),
        "resolution_m": float(grid.resolution_m),
        "pose_building_map": pose_building_map.tolist(),
    }
    return layer, zlib.compress(kind.tobytes(), 6)
