"""Observations of agents: functions of sensor frames and estimates only; no ground truth is among their arguments."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.exploration.observation import map_view
from twc_env.exploration.observation.observation_blocks import block_spaces, joined
from twc_env.exploration.observation.recent_signs import RecentSigns
from twc_env.exploration.observation.small_blocks import SMALL, SmallBlocks
from twc_env.planning.candidates import NOTHING, Candidates, features_of, gains_of, ways_to_others_of
from twc_env.records.messages import Belief, GridMap, SensorFrame
from twc_env.records.team_messages import TeamBeliefs, TeamFrames

_USUAL = "lidar", "map", "pose", "wifi", "signs", "team"
"""The blocks that are enabled by default."""


class ObservationBuilder:
    """Builds the observations of a team. Most blocks are computed as one new array, of which each robot gets a row."""

    def __init__(self, config: EnvConfig):
        self._config = config
        robots, shape = config.robots, config.observation
        self._names = tuple(block_spaces(config))
        self._is_flat = shape.kind != "dict"
        kind = type(self)
        made: dict[str, Callable[[ObservationBuilder], Sequence[Array] | Array]] = {
            "map": kind._maps, "overview": kind._whole_maps, "radio": kind._radio_maps,
            "time_left": kind._times_left,
        }  # fmt: skip
        self._makers = [(name, make) for name, make in made.items() if name in self._names]
        self._robots = range(robots)
        self._blank: dict[str, Any] = dict.fromkeys(self._names)
        self._signs = RecentSigns(robots, shape.sign_slots)
        self._small = small = SmallBlocks(config, self._signs)
        self._map_cells, self._map_cell_m = shape.map_cells, shape.map_cell_m
        self._views = map_view.MapViews(
            shape.map_cells, shape.map_cell_m, small.paths_odom, small.path_counts, small.teammate_places
        )
        self._seen_of: tuple[Sequence[GridMap] | None, list[Array]] = None, self._signs.places
        self._seen = map_view.BelievedMaps.of([], [])
        """The maps for the grids and sign positions in `_seen_of`; a grid that has grown is a new object."""
        self._overviews: list[tuple[GridMap, bytes, tuple[Array, Array, float]]] = []
        """The latest grids, with the `GridMap.touched` of which the downscaled map was made."""

    def notice(self, frames: Sequence[SensorFrame], beliefs: Sequence[Belief]) -> None:
        """Update paths, WiFi slots and sign readings with one step; needed also if no observation is built."""
        sensed = frames if isinstance(frames, TeamFrames) else TeamFrames.of(frames)
        self._beliefs = TeamBeliefs.of(beliefs)
        self._step = sensed.step
        self._small.notice(sensed, self._beliefs)
        if any(sensed.signs):
            self._signs.remember(self._beliefs.poses, sensed.time_s, sensed.signs)

    def build(
        self, candidates: Sequence[Candidates] | None = None, masks: Sequence[Array] | None = None
    ) -> list[dict[str, Array]] | list[Array]:
        """The observation of each robot after the last step given to `notice`; `masks`: its action mask."""
        beliefs, names = self._beliefs, self._names
        if "signs" in names or "map" in names:
            self._signs.know(beliefs)
        rows = self._small.build()
        if names == _USUAL and not self._is_flat:
            return _usual(rows, self._maps())
        # after the small blocks, which compute the teammates' positions that the map shows
        blocks: list[tuple[str, Sequence[Array] | Array]] = [(name, make(self)) for name, make in self._makers]
        if "frontiers" in names:
            slots, lists = self._config.action.frontier_slots, candidates or [NOTHING] * len(beliefs)
            pairs = zip(lists, beliefs, strict=True)
            blocks.append(("frontiers", [features_of(own, belief.pose_map_robot, slots) for own, belief in pairs]))
            if "gains" in names:
                blocks.append(("gains", [gains_of(own, slots) for own in lists]))
            if "other_maps" in names:
                blocks.append(("other_maps", [ways_to_others_of(own, slots) for own in lists]))
        if "action_mask" in names:
            given = [np.zeros(0, np.int8)] * len(beliefs) if masks is None else [m.copy() for m in masks]
            blocks.append(("action_mask", given))
        seen = []
        for robot in self._robots:
            own = self._blank.copy()
            for name, block in zip(SMALL, rows[robot], strict=True):
                if name in own:
                    own[name] = block
            for name, each in blocks:
                own[name] = each[robot]
            seen.append(own)
        return [joined(own) for own in seen] if self._is_flat else seen

    def _maps(self) -> Array:
        beliefs, places = self._beliefs, self._signs.places
        if self._seen_of[0] != beliefs.grids:
            self._seen = map_view.BelievedMaps.of(beliefs.grids, places)
        elif self._seen_of[1] is not places:
            self._seen = self._seen._replace(signs=tuple(places))
        self._seen_of = beliefs.grids, places
        return self._views.draw(self._seen, beliefs.poses)

    def _radio_maps(self) -> list[Array]:
        """(2, cells, cells) per robot: probably free, probably wall around it, estimated from RSSI alone."""
        cells, cell_m = self._map_cells, self._map_cell_m
        return [
            np.zeros((2, cells, cells), np.uint8)
            if belief.radio_map is None
            else map_view.crop_around(belief.radio_map, belief.pose_map_robot, cells, cell_m)[:2]
            for belief in self._beliefs
        ]

    def _times_left(self) -> Array:
        left = np.float32(max(0.0, 1.0 - self._step / self._config.max_cycles))
        return np.full((len(self._robots), 1), left)

    def _whole_maps(self) -> list[Array]:
        return [self._whole_map(belief) for belief in self._beliefs]

    def _whole_map(self, belief: Belief) -> Array:
        cells = self._config.observation.overview_cells
        picture, corner_m, cell_m = self._shrunk(belief.grid)
        out = np.zeros((map_view.OVERVIEW_CHANNELS, cells, cells), np.uint8)
        out[:2] = picture
        if not picture.any():  # an empty map: this robot in its middle
            corner_m = belief.pose_map_robot[:2] - (cells // 2 + 0.5) * cell_m
        for channel, pose in [(2, belief.pose_map_robot), *((3, pose) for pose in belief.teammates.values())]:
            column, row = (min(max(math.floor(v), 0), cells - 1) for v in (pose[:2] - corner_m) / cell_m)
            out[channel, row, column] = 255
        return out

    def _shrunk(self, grid: GridMap) -> tuple[Array, Array, float]:
        """`map_view.shrink`, computed again only if scans have changed the grid."""
        known = b"" if grid.touched is None else grid.touched.tobytes()
        others = [held for held in self._overviews if held[0] is not grid]
        for held in self._overviews:
            if held[0] is grid and held[1] == known != b"":
                return held[2]
        shrunk = map_view.shrink(grid, self._config.observation.overview_cells)
        self._overviews = [(grid, known, shrunk), *others[: len(self._robots) - 1]]
        return shrunk


def _usual(rows: Sequence[tuple[Array, ...]], maps: Array) -> list[dict[str, Array]]:
    """The default blocks of each robot; a dict literal is faster than a dict filled in a loop."""
    seen = []
    for row, around in zip(rows, maps, strict=False):
        lidar, pose, wifi, signs, team = row
        seen.append({"lidar": lidar, "map": around, "pose": pose, "wifi": wifi, "signs": signs, "team": team})
    return seen
