"""The web page of a replayed log, which has no ground truth: maps, paths and closures over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.exploration.drawing import palette
from twc_env.exploration.trace import MOMENTS_MAX, layer_of
from twc_env.pictures.replay_page import base64_of, fill_page, rounded
from twc_env.records.geometry import compose
from twc_env.records.messages import GridMap
from twc_env.slam.modes import Engine

GAP_M = 2.0
"""Maps that are not merged stand side by side, so far apart."""
LAYERS = ("map", "estimate", "accepted", "rejected", "signs")
"""Layers of the page that need no truth."""
_JUMPS = 3.0
"""A robot's track on the page is broken where it moves by more than so many times the usual step, and by"""
_JUMP_MIN_M = 1.0


class LogPage:
    """Collects what the page shows: call `note` after every step, then `write`."""

    def __init__(self, robots: int, steps: int, robot_radius_m: float):
        self._robots, self._radius_m = robots, robot_radius_m
        self._period = max(1, steps // MOMENTS_MAX)
        self._moments: list[dict[str, Any]] = []
        self._poses: list[Array] = []
        """Per step (robots, 3), in the frame of the page."""
        self._places = np.zeros((robots, 3))
        """(robots, 3) place of each robot's map on the page ..."""
        self._regroupings = -1
        """... and the count of merges and splits by then."""

    def note(self, step: int, engine: Engine) -> None:
        """Record one step."""
        if step % self._period == 0:
            self._add_moment(step, engine)
        elif engine.team.regroupings != self._regroupings:
            self._lay_out(engine)
        live = np.array([engine.pose_map_robot(robot) for robot in range(self._robots)])
        self._poses.append(compose(self._places, live))

    def write(
        self,
        path: Path,
        engine: Engine,
        title: str,
        subtitle: str,
        report: dict,
        times_s: Array,
        told: Sequence[tuple[str, str]] = (),
    ) -> Path:
        """Write the page, with the final maps as its last moment; times_s (steps,) since the start.

        told: names and values with units, of the summary below the picture.
        """
        last = len(self._poses) - 1
        self._moments = [moment for moment in self._moments if moment["step"] < last]
        self._add_moment(last, engine)
        live = np.array([engine.pose_map_robot(robot) for robot in range(self._robots)])
        self._poses[-1] = compose(self._places, live)
        poses = np.array(self._poses)
        moved_m = np.hypot(*np.diff(poses[..., :2], axis=0).reshape(-1, 2).T)
        moved_m = moved_m[moved_m > 0.0]
        usual_m = float(np.median(moved_m)) if len(moved_m) else 0.0
        team, places = engine.team, self._layout(engine)
        signs = [(places[group], sign) for group in range(len(team.groups)) for sign in team.signs_of(group)]
        signs_m = [compose(place, np.array([*sign.position_m, 0.0]))[:2] for place, sign in signs]
        corners = [corner for layer in self._moments[-1]["layers"] for corner in _corners(layer)]
        corners += poses[-1, :, :2].tolist()
        data = {
            "robots": self._robots,
            "robot_radii_m": [self._radius_m] * self._robots,
            "time_step_s": float(times_s[-1] / max(last, 1)),
            "times_s": rounded(times_s),
            "subtitle": subtitle,
            "colours": list(palette.ROBOTS),
            "figures": [[name, name, text] for name, text in told],
            "remarks": [],
            "bounds_m": _bounds(corners),
            "layers": LAYERS,
            "walls_m": [],
            "signs_m": rounded(np.array(signs_m).reshape(-1, 2)),
            "sign_texts": [sign.text for _, sign in signs],
            "access_points_m": [],
            "signal": None,
            "true_poses": None,
            "trail_jump_m": max(_JUMP_MIN_M, _JUMPS * usual_m),
            "estimated_poses": rounded(poses),
            "moments": self._moments,
            "report": report,
        }
        return fill_page(path, title, data)

    def _layout(self, engine: Engine) -> dict[int, Array]:
        """Place of each group's map, the largest first, side by side."""
        team, right = engine.team, 0.0
        places: dict[int, Array] = {}
        for group in sorted(range(len(team.groups)), key=lambda g: (-len(team.groups[g].robots), g)):
            left_m, right_m = _sides(team.grid_of(group))
            places[group] = np.array([right - left_m if places else 0.0, 0.0, 0.0])
            right = places[group][0] + right_m + GAP_M
        return places

    @staticmethod
    def _robots_of(engine: Engine, group: int) -> tuple[int, ...]:
        """Robots that use a map; of a map that all have left, its first robot."""
        segments = engine.team.segments
        own = engine.team.groups[group].robots
        return segments.robots_in(own) or (segments.owners[own[0]],)

    def _lay_out(self, engine: Engine) -> dict[int, Array]:
        """`_layout`, also for the robots."""
        places = self._layout(engine)
        self._places = np.array([places[engine.team.group_index(robot)] for robot in range(self._robots)])
        self._regroupings = engine.team.regroupings
        return places

    def _add_moment(self, step: int, engine: Engine) -> None:
        team, places = engine.team, self._lay_out(engine)
        closures, paths = [], {}
        for closure in team.closures:
            ends = []
            for segment, index in (closure.candidate.target, closure.candidate.source):
                if segment not in paths:  # of an hour, some ten thousand poses
                    paths[segment] = compose(places[team.group_of_segment(segment)], team.segment_path(segment)[0])
                ends.append(rounded(paths[segment][index, :2]))
            closures.append(
                {"kind": closure.candidate.recogniser, "status": closure.status, "reason": closure.reason,
                 "correct": None, "target_m": ends[0], "source_m": ends[1]}
            )  # fmt: skip
        status = [closure.status for closure in team.closures]
        grids = {group: team.grid_of(group) for group in places}
        layers = []
        for group, grid in grids.items():
            if grid.log_odds.size:
                layer, cells = layer_of(self._robots_of(engine, group), grid, places[group])
                layers.append({**layer, "cells": base64_of(cells)})
        figures = {
            "known_m2": float(sum((g.log_odds < 0).sum() * g.resolution_m**2 for g in grids.values())),
            "maps": float(len(layers)),
            "keyframes": float(sum(len(team.keyframe_steps(robot)) for robot in range(self._robots))),
            "closures_accepted": float(status.count("accepted")),
            "closures_rejected": float(status.count("rejected")),
        }
        bounds_m = _bounds([corner for layer in layers for corner in _corners(layer)])
        self._moments.append(
            {"step": step, "figures": figures, "closures": closures, "layers": layers, "bounds_m": bounds_m}
        )


def _sides(grid: GridMap) -> tuple[float, float]:
    """Least and greatest x of what is known of a map [m]."""
    columns = np.flatnonzero((grid.log_odds != 0).any(axis=0)) if grid.log_odds.size else np.zeros(0, int)
    if not len(columns):
        return 0.0, 0.0
    return tuple(float(grid.origin_m[0] + k * grid.resolution_m) for k in (columns[0], columns[-1] + 1))  # type: ignore


def _bounds(corners: list[list[float]]) -> list[float]:
    """Least x and y, greatest x and y."""
    inside = corners or [[0.0, 0.0]]
    return [*np.min(inside, axis=0).tolist(), *np.max(inside, axis=0).tolist()]


def _corners(layer: dict[str, Any]) -> list[list[float]]:
    """Opposite corners of a map on the page."""
    x, y = (np.array(layer["origin_m"]) + layer["pose_building_map"][:2]).tolist()
    rows, columns = layer["shape"]
    cell = layer["resolution_m"]
    return [[x, y], [x + columns * cell, y + rows * cell]]
