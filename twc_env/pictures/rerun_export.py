"""A recorded episode for the Rerun viewer: `twc-env replay RUN --rerun`. Needs rerun-sdk (extra `rerun`)."""

from __future__ import annotations

import importlib.util
import json
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, from_dict, robot_configs
from twc_env.errors import ConfigError, DataError
from twc_env.exploration.drawing.palette import tinted_floor
from twc_env.exploration.drawing.rendering import CLOSURE, COLOURS
from twc_env.exploration.trace import UNKNOWN, WALL
from twc_env.pictures.replay_page import contradictions, read_report, read_trace
from twc_env.records.geometry import transform_points
from twc_env.records.whole_file import whole_file

TRUE_WALL = (158, 164, 173)
WALL_RGB = np.array([60, 70, 90])
_LIFT_M = 0.02
"""Height between layers, so that the viewer draws them in order."""


def write_rerun(run: Path, path: Path) -> Path:
    """Write a recording (.rrd) of the trace.npz and report.json of a run folder.

    Time lines are `step` and `time`. Entities, all in the building frame [m]: `building/...` is ground truth,
    `team/...` the estimate at that time, `figures/...` metrics over time.
    Raises ConfigError without rerun-sdk, DataError if a file is missing, invalid or cannot be written.
    """
    if importlib.util.find_spec("rerun") is None:
        raise ConfigError("--rerun needs rerun-sdk: run `pip install 'twc_env[rerun]'`, or choose --html")
    import rerun

    trace, figures = read_trace(run / "trace.npz"), read_report(run / "report.json")
    with contradictions(run):
        config: EnvConfig = from_dict(json.loads(str(trace["config"])))
        moments = json.loads(str(trace["moments"]))
        cells = _cells_of(trace, moments)
        corners_m = trace["walls_m"].reshape(-1, 2)
    name = f"{figures.get('agent', 'team')} on {figures['map']}, seed {figures['seed']}"
    recording = rerun.RecordingStream("twc_env", recording_id=name)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as beside:
            recording.save(beside, default_blueprint=_blueprint(corners_m))
            with recording:
                _log_building(rerun, trace)
                recording.log("report", rerun.TextDocument(json.dumps(figures, indent=2)), static=True)
                for count, moment in enumerate(moments):
                    recording.set_time("step", sequence=moment["step"])
                    recording.set_time("time", duration=moment["step"] * config.dynamics.time_step_s)
                    _log_moment(rerun, moment, cells[count])
                _log_robots(rerun, trace, config)
            recording.disconnect()
    except (OSError, RuntimeError) as error:
        raise DataError(f"cannot write {path}: {error}; choose another place with --out FOLDER") from error
    return path


def _blueprint(corners_m: Array) -> Any:
    """View from above, north up, with the figures beside it."""
    from rerun import blueprint

    low, high = corners_m.min(axis=0), corners_m.max(axis=0)
    x, y = (0.5 * (low + high)).tolist()
    away = float(max(high - low))
    eye = blueprint.EyeControls3D(position=(x, y - 0.01 * away, away), look_target=(x, y, 0.0), eye_up=(0.0, 1.0, 0.0))
    around = blueprint.Spatial3DView(
        origin="/", contents=["building/**", "team/**"], name="Building and team", eye_controls=eye
    )
    return blueprint.Blueprint(
        blueprint.Horizontal(
            around,
            blueprint.Vertical(
                blueprint.TimeSeriesView(origin="figures/shares", name="Shares"),
                blueprint.TimeSeriesView(origin="figures/team_ate_m", name="Team ATE [m]"),
                blueprint.TextDocumentView(origin="report", name="report.json"),
            ),
            column_shares=[3, 1],
        ),
        collapse_panels=True,
    )


def _log_building(rerun: Any, trace: dict[str, Array]) -> None:
    """Static entities: true walls, signs, access points."""
    walls_m = _lifted(trace["walls_m"].reshape(-1, 2), 0).reshape(-1, 2, 3)
    rerun.log("building/walls", rerun.LineStrips3D(walls_m, colors=TRUE_WALL, radii=0.03), static=True)
    texts = json.loads(str(trace["sign_texts"]))
    for name, places_m, labels in (
        ("signs", trace["signs_m"], texts),
        ("access_points", trace["access_points_m"], None),
    ):
        colour = (230, 159, 0) if name == "signs" else (204, 121, 167)
        points = rerun.Points3D(_lifted(places_m, 5), colors=colour, radii=0.12, labels=labels, show_labels=False)
        rerun.log(f"building/{name}", points, static=True)


def _cells_of(trace: dict[str, Array], moments: list[dict]) -> list[list[Array]]:
    """Per moment and layer, cells (rows, columns) uint8."""
    packed, first = trace["maps"].tobytes(), 0
    cells: list[list[Array]] = []
    ends = trace["map_ends"].tolist()[::-1]
    for moment in moments:
        cells.append([])
        for layer in moment["layers"]:
            end = ends.pop()
            kinds = np.frombuffer(zlib.decompress(packed[first:end]), np.uint8)
            cells[-1].append(kinds.reshape(layer["shape"]))
            first = end
    return cells


def _log_moment(rerun: Any, moment: dict, cells: list[Array]) -> None:
    """Maps, closures and figures at one time."""
    rerun.log("team/maps", rerun.Clear(recursive=True))
    for count, (layer, kinds) in enumerate(zip(moment["layers"], cells, strict=True)):
        rerun.log(f"team/maps/{count}", _map_mesh(rerun, layer, kinds, len(moment["layers"]) - count))
    for status, colour in (("accepted", CLOSURE), ("rejected", 0.5 * (CLOSURE + 255))):
        ends_m = [[row["target_m"], row["source_m"]] for row in moment["closures"] if row["status"] == status]
        lines_m = _lifted(np.array(ends_m, float).reshape(-1, 2), 6).reshape(-1, 2, 3)
        rerun.log(f"team/closures/{status}", rerun.LineStrips3D(lines_m, colors=colour.astype(np.uint8), radii=0.02))
    for key, value in moment["figures"].items():
        folder = "figures/shares/" if key in ("coverage_correct", "wall_iou") else "figures/"
        rerun.log(folder + key, rerun.Scalars(value))


def _map_mesh(rerun: Any, layer: dict, kinds: Array, level: int) -> Any:
    """The known cells of the map of one group, in the building frame."""
    boxes, kind = rectangles(kinds)
    corners = boxes[:, [[0, 2], [1, 2], [1, 3], [0, 3]]].reshape(-1, 2)
    corners_m = np.asarray(layer["origin_m"]) + corners * layer["resolution_m"]
    placed_m = transform_points(np.asarray(layer["pose_building_map"], float), corners_m)
    floor = tinted_floor(layer["robots"][0])
    colours = np.where((kind == WALL)[:, None], WALL_RGB, floor).astype(np.uint8)
    return rerun.Mesh3D(
        vertex_positions=_lifted(placed_m, level * 0.5),
        vertex_colors=np.repeat(colours, 4, axis=0),
        triangle_indices=(4 * np.arange(len(boxes))[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3),
    )


def rectangles(kinds: Array) -> tuple[Array, Array]:
    """Split the known cells of a grid into rectangles of one kind: (n, 4) first and end column, first and end row, and
    (n,) kinds. Equal runs of consecutive rows are joined.
    """
    rows, columns = kinds.shape
    padded = np.zeros((rows, columns + 2), np.uint8)
    padded[:, 1:-1] = kinds
    row, first = np.nonzero((padded[:, 1:-1] != padded[:, :-2]) & (kinds != UNKNOWN))
    end = np.nonzero((padded[:, 1:-1] != padded[:, 2:]) & (kinds != UNKNOWN))[1] + 1
    kind = kinds[row, first]
    order = np.lexsort((row, kind, end, first))
    row, first, end, kind = row[order], first[order], end[order], kind[order]
    starts = np.ones(len(row), bool)
    starts[1:] = np.diff(row) != 1
    for values in (first, end, kind):
        starts[1:] |= values[1:] != values[:-1]
    begin = np.flatnonzero(starts)
    last = np.append(begin[1:], len(row))[: len(begin)] - 1
    return np.column_stack([first[begin], end[begin], row[begin], row[last] + 1]), kind[begin]


def _log_robots(rerun: Any, trace: dict[str, Array], config: EnvConfig) -> None:
    """True and estimated positions at every step, and both paths."""
    for robot, own in enumerate(robot_configs(config)):
        radius = own.dynamics.robot_radius_m
        colour = COLOURS[robot % len(COLOURS)]
        for where, poses, level in (
            ("building", trace["true_poses"], 7),
            ("team", trace["estimated_poses"], 8),
        ):
            places_m = _lifted(poses[:, robot, :2], level)
            name = f"{where}/robot_{robot}"
            size_m = radius if where == "building" else 0.5 * radius
            rerun.log(f"{name}/way", rerun.LineStrips3D([places_m], colors=colour, radii=0.015), static=True)
            steps = np.arange(len(places_m))
            times = [
                rerun.TimeColumn("step", sequence=steps),
                rerun.TimeColumn("time", duration=steps * config.dynamics.time_step_s),
            ]
            rerun.log(f"{name}/place", rerun.Points3D.from_fields(colors=[colour], radii=[size_m]), static=True)
            rerun.send_columns(f"{name}/place", times, rerun.Points3D.columns(positions=places_m))


def _lifted(points_m: Array, level: float) -> Array:
    """Points (k, 2) as (k, 3) at the height of a layer."""
    points_m = np.asarray(points_m, float).reshape(-1, 2)
    return np.column_stack([points_m, np.full(len(points_m), level * _LIFT_M)])
