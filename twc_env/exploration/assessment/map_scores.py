"""Evaluation of every map that robots use: alignment with the building, wrongly merged pairs, correct area."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from numpy.typing import NDArray as Array

from twc_env import metrics
from twc_env.exploration.assessment.episode_record import EpisodeRecord
from twc_env.exploration.assessment.map_evaluation import lay
from twc_env.exploration.assessment.rewards import EvaluatedMap, Standing, standing_of
from twc_env.exploration.assessment.team_alignment import true_of_segments
from twc_env.records.messages import GridMap
from twc_env.slam.engine import View
from twc_env.slam.modes import Engine
from twc_env.world.building.floor_cells import Cells


@dataclass(frozen=True, slots=True, eq=False)
class GroupScore:
    """One map that robots use, and the robots whose keyframes it holds, compared with ground truth."""

    view: View
    robots: tuple[int, ...]
    grid: GridMap
    pose_building_map: Array
    """(3,) rigid alignment of the group's map with the building; without keyframes, the robot's true start pose."""
    wrong_pairs: tuple[tuple[int, int], ...]
    """Pairs of its robots whose relative frame is wrong by more than 1 m or 10 degrees."""
    correct_area_m2: float


def score_view(view: View, record: EpisodeRecord, cells: Cells) -> GroupScore:
    """Align a group's map with the building and measure it."""
    place = lay(view.segments, view.mapper.nodes, true_of_segments(view.mapper, record.true_poses))
    grid, area_m2 = view.mapper.grid_of(view.group), 0.0
    pose, wrong = place or (record.true_poses[0, view.viewers[0]].copy(), ())
    if place is not None:
        area_m2 = metrics.correct_area_m2(
            grid.log_odds, grid.origin_m, grid.resolution_m, pose, cells.free, cells.origin_m, cells.resolution_m,
            box=view.mapper.groups[view.group].grid.known_box(),
        )  # fmt: skip
    return GroupScore(view, view.robots, grid, pose, wrong, area_m2)


def scores_of(engine: Engine, record: EpisodeRecord, cells: Cells) -> list[GroupScore]:
    """Evaluate every map that robots use, largest group (then largest correct area) first; modifies nothing."""
    scores = [score_view(view, record, cells) for view in engine.views()]
    return sorted(scores, key=lambda v: (-len(v.robots), -v.correct_area_m2))


def told(scores: Sequence[GroupScore], cells: Cells, robots: int, time_s: float) -> str:
    """Caption of a picture: one line on the state of a team of `robots` robots; scores: largest group first."""
    best = scores[0]
    wrong = ", merged wrongly" if any(score.wrong_pairs for score in scores) else ""
    share = best.correct_area_m2 / floor_m2(cells)
    apart = robots > 1 and len(best.robots) == 1
    merged = f"{'no two' if apart else f'{len(best.robots)} of {robots}'} robots in one map{wrong}"
    return f"{time_s:.1f} s   {merged}   {100 * share:.1f} % of the floor mapped correctly"


def standing(engine: Engine, record: EpisodeRecord, cells: Cells, last: Sequence[GroupScore] = ()) -> Standing:
    """The potentials of the rewards, evaluated now. Adds wrong pairs to the record.

    last: exact scores of the last time step, whose areas are used instead of those counted over cells of the map.
    """
    true_poses, evaluate, mapper = record.true_poses, record.map_evaluators.evaluate, None
    true, believed = true_poses[-1, :, :2].tolist(), engine.beliefs().poses[:, 0].tolist()
    maps, errors_m, floor = [], [0.0] * len(true), floor_m2(cells)
    for view in engine.views():
        viewers = view.viewers
        if view.mapper is not mapper:  # a mapper may have several maps
            mapper = view.mapper
            nodes, groups = mapper.nodes, mapper.groups
        group, segments = groups[view.group], view.segments
        truth = true_of_segments(mapper, true_poses)
        evaluated = evaluate(segments, nodes, truth, group.grid.snapshot(), cells)
        if evaluated is not None:
            (x, y, turn), wrong, area_m2 = evaluated
            c, s = math.cos(turn), math.sin(turn)
            if wrong:
                record.wrong_pairs.update(wrong)
            for score in last:
                if score.view is view:
                    area_m2 = score.correct_area_m2
            maps.append(EvaluatedMap(viewers, len(view.robots), not wrong, area_m2 / floor))
        for robot in viewers:
            if evaluated is None:  # no keyframe yet: its map begins where it started
                x, y, turn = true_poses[0, robot].tolist()
                c, s = math.cos(turn), math.sin(turn)
            ahead, left, _ = believed[robot]
            errors_m[robot] = math.dist((x + c * ahead - s * left, y + s * ahead + c * left), true[robot])
    return standing_of(maps, errors_m)


@lru_cache(maxsize=8)
def floor_m2(cells: Cells) -> float:
    """Area of the explorable floor; cached per building."""
    return max(float(cells.free.sum()) * cells.resolution_m**2, 1e-9)
