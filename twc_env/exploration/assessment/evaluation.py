"""Evaluation of an episode: estimates against ground truth. Engine and observations must not use it."""

from __future__ import annotations

import math
from collections.abc import Iterator, KeysView, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray as Array

from twc_env import metrics
from twc_env._version import __version__
from twc_env.config import EnvConfig, robot_configs, shared_config
from twc_env.config import digest as config_digest
from twc_env.errors import did_you_mean
from twc_env.exploration.assessment import result_table
from twc_env.exploration.assessment.episode_record import EpisodeRecord
from twc_env.exploration.assessment.map_scores import GroupScore, floor_m2
from twc_env.exploration.assessment.seen_floor import seen_share
from twc_env.exploration.assessment.team_alignment import TeamPaths, position_error_m
from twc_env.records.geometry import between, transform_points
from twc_env.records.messages import GridMap
from twc_env.records.whole_file import file_path
from twc_env.slam.modes import Engine
from twc_env.slam.scans.occupancy_grid import OccupancyGrid
from twc_env.world.building.floor_cells import Cells
from twc_env.world.building.floorplan import Floorplan

STUCK_WINDOW_S = 10.0
STUCK_RADIUS_M = 0.3
CARRIED = 2.0
"""Steps longer than so many times the longest that a robot can drive: somebody carried it."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class EpisodeResult:
    """All data of an episode, ground truth included; for reports, pictures and exports.

    `print(result)` shows the table of its figures, and `result["team_ate_m"]` is one of them; `plot()` draws the map,
    `to_frame()` makes a pandas table, and `save(FOLDER)` writes all of it.
    """

    config: EnvConfig
    seed: int
    floorplan: Floorplan
    figures: dict
    """The figures of the report, by name (docs/figures.md defines each)."""
    true_poses: Array
    """(steps + 1, robots, 3) in the building frame."""
    estimated_poses: Array
    """(steps + 1, robots, 3) final estimate, in the map frame of each robot's group."""
    odometry_poses: Array
    """(steps + 1, robots, 3) dead reckoning from the true start poses, in the building frame."""
    groups: tuple[tuple[int, ...], ...]
    """Robots that share a map, largest group first; with one mapper per robot, those in the map of each robot."""
    viewers: tuple[tuple[int, ...], ...]
    """Robots whose estimates are in the map of each group: all of it, or the one robot that has the mapper."""
    grids: tuple[GridMap, ...]
    """The merged map of each group."""
    pose_building_map: Array
    """(groups, 3) alignment of each group's map with the building."""
    closures: list[dict]
    """Verified closures of the largest group's mapper: kind, status, reason, correct, target, source, and the estimated
    positions target_m, source_m (building frame)."""
    graph: dict
    """The pose graph, as `TeamMapper.graph` gives it: nodes, node_ids, edges_ij, edges_z and so on."""

    def __repr__(self) -> str:
        return result_table.text_of(self.figures)

    def _repr_html_(self) -> str:
        return result_table.html_of(self.figures)

    def __getitem__(self, key: str) -> Any:
        if key not in self.figures:
            raise KeyError(f"no figure {key!r}; keys() has all{did_you_mean(key, self.figures)}")
        return self.figures[key]

    def __contains__(self, key: object) -> bool:
        return key in self.figures

    def __iter__(self) -> Iterator[str]:
        return iter(self.figures)

    def __len__(self) -> int:
        return len(self.figures)

    def keys(self) -> KeysView[str]:
        """The names of the figures, so that `dict(result)` has all of them."""
        return self.figures.keys()

    def plot(self, dpi: float | None = None) -> Any:
        """The map as a matplotlib figure, which a notebook shows: `result.plot().savefig("map.pdf")` writes it.

        Raises ConfigError without matplotlib, and unless dpi is a number.
        """
        from twc_env.exploration.drawing.episode_map import map_figure

        return map_figure(self, dpi)

    def to_frame(self, what: str = "figures") -> Any:
        """A pandas table: "figures", one row, to be put below those of other episodes by `pandas.concat`; or "paths",
        one row per time step and robot, in the building frame.

        Raises ConfigError without pandas (extra `viz`), and for another table.
        """
        from twc_env.exploration.assessment.result_files import frame_of

        return frame_of(self, what)

    def save(self, folder: str | Path, format: str = "png", dpi: float | None = None) -> list[Path]:
        """Write report.json, figures.csv, figures.tex, paths.csv, config.json and the map; returns their paths.

        format: of the map, png, pdf or svg; without matplotlib there is no map. Raises DataError if the folder cannot
        be written.
        """
        from twc_env.exploration.assessment.result_files import save

        return save(self, file_path(folder), format, dpi)


def progress(
    engine: Engine, record: EpisodeRecord, cells: Cells, scores: Sequence[GroupScore]
) -> tuple[list[dict], dict[str, float]]:
    """Data for pictures over time, defined as in the report; does not modify the record.

    Returns closures as in `EpisodeResult`, and figures.
    """
    paths, best = TeamPaths(engine, record.odom_poses), scores[0]
    estimated, alignment = paths.as_seen(record.true_poses), paths.alignment(record.true_poses)
    closures = _closures(engine, best, record, alignment)
    status = [row["status"] for row in closures]
    score = _score(best.grid, best.pose_building_map, cells)
    figures = {
        "coverage_correct": score.coverage_correct,
        "wall_iou": score.wall_iou,
        "team_ate_m": position_error_m(alignment, estimated, record.true_poses),
        "merged_robots": len(best.robots),
        "wrong_pairs": sum(len(v.wrong_pairs) for v in scores),
        "closures_accepted": status.count("accepted"),
        "closures_rejected": status.count("rejected"),
    }
    return closures, figures


class EpisodePaths(NamedTuple):
    """True and estimated paths of all robots; poses (steps + 1, robots, 3)."""

    true: Array
    """In the building frame."""
    estimated: Array
    """Each in the map frame of its robot's group."""
    alignment: Array
    """(robots, 3) rigid alignment of that map with the building."""
    reckoned: Array
    """Dead reckoning from the true start poses, in the building frame."""

    @classmethod
    def of(cls, engine: Engine, record: EpisodeRecord) -> EpisodePaths:
        """The paths as estimated now."""
        paths, true = TeamPaths(engine, record.odom_poses), record.true_poses
        return cls(true, paths.as_seen(true), paths.alignment(true), record.odometry_poses())


def numbers(
    config: EnvConfig, seed: int, cells: Cells, engine: Engine, record: EpisodeRecord, scores: Sequence[GroupScore],
    paths: EpisodePaths,
) -> dict[str, float]:  # fmt: skip
    """The scalar figures of the report; cells: of the building, for scoring; scores, paths: of the present maps.
    Modifies nothing."""
    best = scores[0]
    wrong_pairs = record.wrong_pairs.union(*(score.wrong_pairs for score in scores))
    true, estimated, alignment, reckoned = paths
    score = _score(best.grid, best.pose_building_map, cells)
    robots = range(true.shape[1])
    strides_m = [CARRIED * own.dynamics.speed_max_m_s * own.dynamics.time_step_s for own in robot_configs(config)]
    taken, scans = _taken(engine, len(robots))
    # The map drawn at the dead-reckoned poses, whose relative start poses are the true ones, after one alignment.
    by_odometry = _score(_drawn_at(reckoned, taken, scans, config), metrics.lay_map(reckoned, true), cells)
    return {
        "robots": config.robots,
        "seed": seed,
        "steps": record.count - 1,
        "sim_time_s": round((record.count - 1) * config.dynamics.time_step_s, 6),
        "coverage_believed": score.believed_area_m2 / floor_m2(cells),
        "coverage_true": seen_share(_poses_of(true, taken), scans, config, cells),
        "coverage_correct": score.coverage_correct,
        "map_iou": score.map_iou,
        "wall_iou": score.wall_iou,
        "merged_robots": len(best.robots),
        "wrong_merges": len(wrong_pairs),
        "team_ate_m": position_error_m(alignment, estimated, true),
        "epe_m": float(np.mean([metrics.end_point_error_m(estimated[:, r], true[:, r]) for r in robots])),
        "odometry_ate_m": metrics.absolute_trajectory_error_m(reckoned, true),
        "odometry_coverage_correct": by_odometry.coverage_correct,
        "odometry_map_iou": by_odometry.map_iou,
        "odometry_wall_iou": by_odometry.wall_iou,
        "bytes_sent": int(sum(engine.bytes_sent.values())),
        "path_length_m": float(sum(metrics.path_length_m(true[:, r], strides_m[r]) for r in robots)),
        "collisions": record.contact_count,
        **({} if record.people_collisions is None else {"people_collisions": record.people_collisions}),
        "stuck_share": metrics.stuck_share(
            true, max(int(STUCK_WINDOW_S / config.dynamics.time_step_s), 1), STUCK_RADIUS_M
        ),
    }


def evaluate(
    config: EnvConfig, seed: int, floorplan: Floorplan, cells: Cells, engine: Engine, record: EpisodeRecord,
    scores: Sequence[GroupScore],
) -> EpisodeResult:  # fmt: skip
    """All figures of the report and the data for pictures and exports; scores: of the present maps."""
    paths, best = EpisodePaths.of(engine, record), scores[0]
    true, estimated = paths.true, paths.estimated
    closures = _closures(engine, best, record, paths.alignment)
    counted = metrics.score_closures([c["correct"] for c in closures], [c["status"] == "accepted" for c in closures])
    figures = {
        "map": config.map,
        **numbers(config, seed, cells, engine, record, scores, paths),
        "per_robot_ate_m": [
            metrics.absolute_trajectory_error_m(estimated[:, r], true[:, r]) for r in range(true.shape[1])
        ],
        "closures": {
            "proposed": counted.proposed,
            "accepted": counted.accepted,
            "correct": counted.correct,
            "precision": _or_none(counted.precision),
            "recall": _or_none(counted.recall),
        },
        **(_of_saved_map(engine, best, config.robots) if config.slam.prior else {}),
        "lacked": engine.lacked(),
        "bytes_by_kind": {kind: int(count) for kind, count in sorted(engine.bytes_sent.items())},
        "config_digest": config_digest(config),
        "version": __version__,
    }
    return EpisodeResult(
        config=config,
        seed=seed,
        floorplan=floorplan,
        figures=figures,
        true_poses=true.copy(),
        estimated_poses=estimated,
        odometry_poses=paths.reckoned,
        groups=tuple(v.robots for v in scores),
        viewers=tuple(v.view.viewers for v in scores),
        grids=tuple(GridMap(v.grid.log_odds.copy(), v.grid.origin_m.copy(), v.grid.resolution_m) for v in scores),
        pose_building_map=np.array([v.pose_building_map for v in scores]),
        closures=closures,
        graph=best.view.mapper.graph(),
    )


def _of_saved_map(engine: Engine, best: GroupScore, robot_count: int) -> dict[str, Any]:
    """Robots in the frame of the map of an earlier session, and accepted closures with it, whose truth is unknown."""
    mapper = best.view.mapper
    ends = [(c.candidate.target[0], c.candidate.source[0]) for c in mapper.closures if c.status == "accepted"]
    robots = [robot for robot in range(robot_count) if engine.found_prior(robot)]
    return {"found_prior": robots, "prior_closures": sum(mapper.prior in pair for pair in ends)}


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value


def _score(grid: GridMap, pose_building_map: Array, cells: Cells) -> metrics.MapScore:
    log_odds = grid.log_odds
    if cells.unscored is not None:
        place = grid.origin_m, grid.resolution_m, pose_building_map
        is_left_out = metrics.floor_mask(log_odds.shape, *place, cells.unscored, cells.origin_m, cells.resolution_m)
        log_odds = np.where(is_left_out, 0, log_odds).astype(log_odds.dtype)
    return metrics.score_map(
        log_odds, grid.origin_m, grid.resolution_m, pose_building_map, cells.free, cells.wall, cells.origin_m,
        cells.resolution_m,
    )  # fmt: skip


def map_at(engine: Engine, poses: Array, config: EnvConfig) -> GridMap:
    """The map of the keyframes' scans, drawn at other poses (steps + 1, robots, 3)."""
    return _drawn_at(poses, *_taken(engine, poses.shape[1]), config)


def _taken(engine: Engine, robots: int) -> tuple[list[Array], Array]:
    """Steps (k,) of each robot's keyframes, and all their scans (keyframes, beams) [m], ordered by robot."""
    steps, scans = zip(*(engine.mapper_of(robot).scans_of(robot) for robot in range(robots)), strict=True)
    return list(steps), np.array([scan for own in scans for scan in own])


def _drawn_at(poses: Array, steps: list[Array], scans: Array, config: EnvConfig) -> GridMap:
    """The map of scans (keyframes, beams) drawn at poses (steps + 1, robots, 3); steps: of each robot's keyframes."""
    lidar = shared_config(config).lidar
    grid = OccupancyGrid(config.slam.resolution_m, lidar.range_max_m, lidar.circle_beam_count)
    grid.integrate(_poses_of(poses, steps), scans)
    return grid.snapshot()


def _poses_of(poses: Array, steps: list[Array]) -> Array:
    """(keyframes, 3) rows of poses (steps + 1, robots, 3) at these steps of each robot, ordered by robot."""
    return np.concatenate([poses[taken, robot] for robot, taken in enumerate(steps)])


def _closures(engine: Engine, best: GroupScore, record: EpisodeRecord, alignment: Array) -> list[dict]:
    """`EpisodeResult.closures`: those of the mapper of the best map; alignment (robots, 3) as `EpisodePaths`."""
    mapper = best.view.mapper
    viewer = best.view.viewers[0]
    made = [c for c in mapper.closures if mapper.prior not in (c.candidate.target[0], c.candidate.source[0])]
    if not made:  # the truth of an earlier session is not known here
        return []
    true_poses: list[Array] = []
    believed: list[Array] = []
    """Per segment: true poses (k, 3) of its keyframes, and their estimated positions (k, 2) in the building frame."""
    for segment, robot in enumerate(mapper.segments.owners):
        if segment == mapper.prior:
            believed.append(np.zeros((0, 2)))
            true_poses.append(np.zeros((0, 3)))
            continue
        shown = (mapper, alignment[viewer])
        if segment not in best.view.segments and segment < record.true_poses.shape[1]:
            shown = engine.mapper_of(robot), alignment[robot]
        believed.append(transform_points(shown[1], shown[0].segment_path(segment)[0][:, :2]))
        true_poses.append(record.true_poses[mapper.segment_path(segment)[1], robot])

    ends = [(closure.candidate.target, closure.candidate.source) for closure in made]
    first_row = np.cumsum([0, *map(len, true_poses)])
    pairs = np.array(ends)  # (closures, 2, 2)
    true = np.concatenate(true_poses)[first_row[pairs[..., 0]] + pairs[..., 1]]  # (closures, 2, 3)
    measured = np.array([closure.pose_target_source for closure in made])
    is_correct = metrics.closures_are_correct(measured, between(true[:, 0], true[:, 1])).tolist()
    rows = []
    for closure, (target, source), correct in zip(made, ends, is_correct, strict=True):
        rows.append(
            {
                "kind": closure.candidate.recogniser,
                "status": closure.status,
                "reason": closure.reason,
                "correct": correct,
                "target": target,
                "source": source,
                "target_m": believed[target[0]][target[1]],
                "source_m": believed[source[0]][source[1]],
            }
        )
    return rows
