"""Every map that robots believe in, laid on the building: where it lies, whom it merges wrongly, how much is right."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from twc_env import metrics
from twc_env.exploration.episode_record import EpisodeRecord
from twc_env.exploration.rewards import JudgedMap, Standing, standing_of
from twc_env.kernels import kernel
from twc_env.messages import GridMap
from twc_env.slam.engine import View
from twc_env.slam.modes import Engine
from twc_env.world.floor_cells import Cells

Array = NDArray


@dataclass(frozen=True, slots=True, eq=False)
class GroupVerdict:
    """One map that robots believe in, and the robots whose keyframes it holds, against the truth."""

    view: View
    robots: tuple[int, ...]
    grid: GridMap
    pose_building_map: Array
    """(3,) the one rigid alignment that lays the group's map on the building."""
    wrong_pairs: tuple[tuple[int, int], ...]
    """Pairs of its robots whose relative frame is off by more than 1 m or 10 degrees."""
    correct_area_m2: float


def judge_view(view: View, record: EpisodeRecord, cells: Cells) -> GroupVerdict:
    """Lay a group's map on the building and measure it."""
    team, robots = view.mapper, view.robots
    grid = team.grid_of(view.group)
    poses, robot_of_node, step_of_node = team.nodes
    estimated, true, owner = np.empty_like(poses), np.empty_like(poses), np.empty_like(robot_of_node)
    count, x, y = _collect(
        np.array(robots), poses, robot_of_node, step_of_node, record.true_poses, estimated, true, owner
    )
    if count == 0:
        return GroupVerdict(view, robots, grid, np.zeros(3), (), 0.0)
    estimated, true = estimated[:count], true[:count]
    pose = metrics.lay_map(estimated, true)
    wrong: tuple[tuple[int, int], ...] = ()
    if len(robots) > 1:
        pairs = metrics.wrong_pairs(metrics.implied_frames(estimated, true, owner[:count]), (x, y))
        wrong = tuple((robots[i], robots[j]) for i, j in pairs)
    area = metrics.correct_area_m2(
        grid.log_odds, grid.origin_m, grid.resolution_m, pose, cells.free, cells.origin_m, cells.resolution_m,
        box=team.known_box_of(view.group),
    )  # fmt: skip
    return GroupVerdict(view, robots, grid, pose, wrong, area)


@kernel
def _collect(robots, poses, robot_of_node, step_of_node, truth, estimated, true, owner):
    """Estimated and true poses of some robots' keyframes, robot by robot, and whose they are; count and mean place.

    truth (steps, robots, 3); poses, estimated, true (nodes, 3); owner (nodes,): the robot's number among `robots`.
    """
    count, x, y = 0, 0.0, 0.0
    for a in range(robots.shape[0]):
        for k in range(poses.shape[0]):
            if robot_of_node[k] == robots[a] and count < poses.shape[0]:
                estimated[count] = poses[k]
                true[count] = truth[step_of_node[k], robots[a]]
                owner[count] = a
                x += poses[k, 0]
                y += poses[k, 1]
                count += 1
    return count, x / max(count, 1), y / max(count, 1)


def verdicts_of(engine: Engine, record: EpisodeRecord, cells: Cells) -> list[GroupVerdict]:
    """Every map that some robot believes in, that with most robots (then most area) first; leaves no mark."""
    verdicts = [judge_view(view, record, cells) for view in engine.views()]
    return sorted(verdicts, key=lambda v: (-len(v.robots), -v.correct_area_m2))


def judge(engine: Engine, record: EpisodeRecord, cells: Cells) -> list[GroupVerdict]:
    """`verdicts_of`, with wrong pairs noted in the record."""
    verdicts = verdicts_of(engine, record, cells)
    for verdict in verdicts:
        record.wrong_pairs.update(verdict.wrong_pairs)
    return verdicts


def standing(engine: Engine, record: EpisodeRecord, cells: Cells) -> Standing:
    """The potentials that rewards look at, judged now."""
    whole_m2, true, maps = floor_m2(cells), record.true_poses[-1, :, :2].tolist(), []
    errors_m = [0.0] * len(true)
    for view in engine.views():
        x, y, c, s = 0.0, 0.0, 1.0, 0.0
        if any([view.mapper.keyframes[robot] for robot in view.robots]):
            verdict = judge_view(view, record, cells)
            record.wrong_pairs.update(verdict.wrong_pairs)
            x, y, turn = verdict.pose_building_map.tolist()
            c, s = math.cos(turn), math.sin(turn)
            share, is_right = verdict.correct_area_m2 / whole_m2, not verdict.wrong_pairs
            maps.append(JudgedMap(view.viewers, len(view.robots), is_right, share))
        for robot in view.viewers:
            ahead, left, _ = engine.pose_map_robot(robot).tolist()
            believed = x + c * ahead - s * left, y + s * ahead + c * left
            errors_m[robot] = math.dist(believed, true[robot])
    return standing_of(maps, errors_m)


@lru_cache(maxsize=8)
def floor_m2(cells: Cells) -> float:
    """Explorable floor; summed once per building, for it is asked for whenever the map is judged."""
    return max(float(cells.free.sum()) * cells.resolution_m**2, 1e-9)
