"""Pictures of a running episode, as arrays or in a window, with layers that keys toggle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import RadioConfig, robot_configs
from twc_env.exploration.assessment.episode_record import EpisodeRecord
from twc_env.exploration.assessment.map_scores import GroupScore
from twc_env.exploration.drawing.extent import grown_extent_m, wall_points_m
from twc_env.exploration.drawing.frame import framed, legend_of
from twc_env.exploration.drawing.labels import building_name
from twc_env.exploration.drawing.layers import Layers, layered
from twc_env.exploration.drawing.rendering import ClosureLine, Scene, SignalLayer, building_box_m
from twc_env.exploration.drawing.window import Window
from twc_env.exploration.episode import Episode
from twc_env.records.geometry import compose, transform_points
from twc_env.slam.modes import Engine
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.sensors.signal_map import SIGNAL_SPAN_DBM, signal_map_dbm

TRAIL_STEPS = 150


class Viewer:
    """Draws an episode; in mode "human" in a window, once per time step or change of layers."""

    def __init__(self, mode: str, frames_per_s: float, with_signal: bool):
        """Raises ConfigError if the mode is "human" and pygame is missing."""
        self.window = Window("twc_env", frames_per_s) if mode == "human" else None
        """None in other modes."""
        self._layers = Layers(signal=with_signal)
        self._signal: tuple[Floorplan, SignalLayer] | None = None
        self._seen = SeenClosures()
        self._shown_step = -1
        self._shown_m: Array | None = None
        """As of `Scene`: it grows with maps that lie askew."""

    def begin(self) -> None:
        """Prepare for a new episode."""
        self._seen, self._shown_step, self._shown_m = SeenClosures(), -1, None

    def draw(self, episode: Episode) -> Array | None:
        """The picture of the present state; None if it is shown in the window. Waits while the window is paused."""
        if self.window is None:
            return self._picture(episode)
        step = episode.record.count
        while self.window.answer():
            layers = self._layers
            for key in self.window.take_keys():
                layers = layers.after(key)
            if step != self._shown_step or layers != self._layers:
                self._layers, self._shown_step = layers, step
                self.window.show(self._picture(episode), episode.caption())
            elif self.window.is_paused:
                self.window.wait()
            if not self.window.is_paused:
                break
        return None

    def follow(self, episode: Episode) -> None:
        """Draw in the window, if there is one."""
        if self.window is not None:
            self.draw(episode)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self.window is not None:
            self.window.close()

    def _picture(self, episode: Episode) -> Array:
        scores = episode.map_scores()
        lines = self._seen.lines(scores, episode.record.count, episode.config.dynamics.time_step_s)
        layers = self._layers
        signal = self._signal_of(episode.floorplan, episode.config.radio) if layers.signal else None
        self._grow_to(scores, episode.floorplan)
        if layers.robot is not None:
            scores = [v for v in scores if layers.robot in v.view.viewers] or scores
        others = {"people_m": episode.world.people_m, "things_m": episode.world.things_m}
        radii_m = tuple(own.dynamics.robot_radius_m for own in robot_configs(episode.config))
        scene = scene_of(episode.floorplan, episode.engine, episode.record, scores, lines, signal, radii_m, **others)
        scene = replace(scene, shown_m=self._shown_m)
        caption = f"{building_name(episode.floorplan.name)}, seed {episode.seed}: {episode.caption()}"
        help_text = "" if self.window is None else self.window.help_text
        return framed(layered(scene, layers), caption, help_text, legend_of(scene))

    def _grow_to(self, scores: Sequence[GroupScore], plan: Floorplan) -> None:
        """Let the pictures from now on show the walls of these maps, too, but nothing far away."""
        cells = plan.cells()
        box_m = building_box_m(cells.origin_m, cells.wall, cells.resolution_m)
        walls_m = np.vstack([wall_points_m(score.grid, score.pose_building_map) for score in scores])
        shown_m = grown_extent_m(box_m, box_m if self._shown_m is None else self._shown_m, walls_m)
        self._shown_m = shown_m if (shown_m != box_m).any() else None

    def _signal_of(self, plan: Floorplan, config: RadioConfig) -> SignalLayer:
        if self._signal is None or self._signal[0] is not plan:
            strength_dbm, origin_m, cell_m = signal_map_dbm(plan, config)
            low, high = SIGNAL_SPAN_DBM
            share = np.clip((strength_dbm - low) / (high - low), 0.0, 1.0)
            self._signal = plan, SignalLayer(share, np.array(origin_m), cell_m)
        return self._signal[1]


class SeenClosures:
    """Records at which step each closure of the largest group's mapper was first seen accepted or rejected."""

    def __init__(self) -> None:
        self._since: dict[tuple, tuple[str, int]] = {}

    def lines(self, scores: Sequence[GroupScore], step: int, time_step_s: float) -> tuple[ClosureLine, ...]:
        """The accepted and rejected closures, at their estimated positions in the building frame."""
        best, shown = scores[0], {robot: v for v in reversed(scores) for robot in v.view.viewers}
        shown |= dict.fromkeys(best.view.segments, best)

        def place_m(segment: int, index: int) -> Array:
            score = shown.get(segment, best)
            pose = score.view.mapper.segment_path(segment)[0][index : index + 1, :2]
            return transform_points(score.pose_building_map, pose)[0]

        lines = []
        for closure in best.view.mapper.closures:
            if closure.status not in ("accepted", "rejected"):
                continue
            candidate = closure.candidate
            key = (candidate.target, candidate.source, candidate.recogniser)
            status, since = self._since.get(key, ("", step))
            if status != closure.status or since > step:
                since = step
                self._since[key] = closure.status, step
            ends_m = np.array([place_m(*candidate.target), place_m(*candidate.source)])
            lines.append(ClosureLine(ends_m, closure.status == "accepted", (step - since) * time_step_s))
        return tuple(lines)


def scene_of(
    floorplan: Floorplan,
    engine: Engine,
    record: EpisodeRecord,
    scores: Sequence[GroupScore],
    closures: tuple[ClosureLine, ...] = (),
    signal: SignalLayer | None = None,
    robot_radii_m: tuple[float, ...] = (),
    **others: Array,
) -> Scene:
    """The present state of an episode; each group's map is aligned with the building by one rigid motion.

    others: `people_m` and `things_m`, as of `Scene`.
    """
    cells = floorplan.cells()
    true = record.true_poses
    estimated = np.full((true.shape[1], 3), np.nan)
    for score in scores:
        for robot in score.view.viewers:
            estimated[robot] = compose(score.pose_building_map, engine.pose_map_robot(robot))
    return Scene(
        walls=cells.wall,
        origin_m=cells.origin_m,
        resolution_m=cells.resolution_m,
        grids=tuple(v.grid for v in scores),
        pose_building_map=np.array([v.pose_building_map for v in scores]),
        true_poses=true[-1],
        estimated_poses=estimated,
        groups=tuple(v.robots for v in scores),
        trails_m=tuple(true[-TRAIL_STEPS:, robot, :2] for robot in range(true.shape[1])),
        closures=closures,
        signal=signal,
        robot_radii_m=robot_radii_m,
        **others,
    )
