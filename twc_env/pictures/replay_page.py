"""One self-contained HTML page that plays a recorded episode: `twc-env replay RUN --html`."""

from __future__ import annotations

import base64
import json
import re
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, from_dict, robot_configs
from twc_env.datasets.logs.arrays_file import read_arrays
from twc_env.errors import UNFIT, DataError, TwcError
from twc_env.exploration.assessment.result_table import keyed_rows, remarks_of
from twc_env.exploration.drawing import palette
from twc_env.exploration.drawing.extent import extent_m, wall_points_m
from twc_env.exploration.drawing.smooth_map import NUMBERS
from twc_env.exploration.trace import FORMAT, TRACE_KEYS, WALL
from twc_env.records.messages import GridMap
from twc_env.records.whole_file import whole_file
from twc_env.world.sensors.signal_map import SIGNAL_SPAN_DBM

DIGITS = 3
"""Positions are written to the millimetre."""

PALETTE = {
    "true_wall": palette.TRUE_WALL,
    "true_text": palette.TRUE_TEXT,
    "wall": palette.WALL,
    "floor": palette.FLOOR,
    "unknown": palette.UNKNOWN,
    "closure": palette.CLOSURE,
    "ink": palette.INK,
    "any_robot": palette.ANY_ROBOT,
    "tints": [palette.hex_of(palette.tinted_floor(robot)) for robot in range(len(palette.ROBOTS))],
}
"""Colours of the page's script."""


def write_page(run: Path, path: Path) -> Path:
    """Write the page of a run folder from its trace.npz and report.json.

    Raises DataError if one of them is missing or invalid, or the page cannot be written.
    """
    trace, report = read_trace(run / "trace.npz"), read_report(run / "report.json")
    with contradictions(run):
        data = page_data(trace, report)
        title = f"{report.get('agent', 'team')} on {report['map']}, seed {report['seed']}"
        return fill_page(path, title, data)


def fill_page(path: Path, title: str, data: dict[str, Any]) -> Path:
    """Write the page of these data. Raises DataError if it cannot be written."""
    data = {**data, "palette": PALETTE, "strokes": NUMBERS}
    content = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    texts = {"TITLE": escape(title), "DATA": content, "STROKES": _shipped("wall_strokes.js")}
    try:
        filled = re.sub(f"__({'|'.join(texts)})__", lambda gap: texts[gap[1]], _shipped("replay_page.html"))
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as beside:
            beside.write_text(filled, encoding="utf-8")
    except OSError as error:
        raise DataError(f"cannot write {path}: {error.strerror}; choose another place with --out FOLDER") from error
    return path


def _shipped(name: str) -> str:
    return files("twc_env.pictures").joinpath(name).read_text(encoding="utf-8")


def page_data(trace: dict[str, Array], report: dict[str, Any]) -> dict[str, Any]:
    """The data for the script of the page, as plain Python values: lengths in metres, maps as base64 of their layers.

    trace: arrays of `read_trace`; report: those of report.json.
    """
    config: EnvConfig = from_dict(json.loads(str(trace["config"])))
    walls = trace["walls_m"].reshape(-1, 4)
    moments = json.loads(str(trace["moments"]))
    starts = np.concatenate([[0], trace["map_ends"]])
    packed = trace["maps"].tobytes()
    layers = [layer for moment in moments for layer in moment["layers"]]
    shown_m = [trace["estimated_poses"][..., :2].reshape(-1, 2)]
    for layer, first, end in zip(layers, starts[:-1], starts[1:], strict=True):
        layer["cells"] = base64_of(packed[first:end])
        shown_m.append(_wall_points_m(layer, packed[first:end]))
    ends_m = walls.reshape(-1, 2)
    bounds_m = extent_m(np.array([ends_m.min(axis=0), ends_m.max(axis=0)]), np.vstack(shown_m))
    return {
        "robots": config.robots,
        "robot_radii_m": [own.dynamics.robot_radius_m for own in robot_configs(config)],
        "time_step_s": config.dynamics.time_step_s,
        "subtitle": f"{config.robots} robot{'s' * (config.robots > 1)}, {len(trace['true_poses']) - 1} steps of "
        f"{config.dynamics.time_step_s:g} s, configuration {report['config_digest']}, version {report['version']}. "
        "Grey: the true building. Black and white: the estimated map. Disc: true pose; ring: estimated pose. "
        "Violet: closures; thick with crosses: accepted, but false.",
        "colours": list(palette.ROBOTS),
        "figures": [list(row) for row in keyed_rows(report)],
        "remarks": remarks_of(report),
        "bounds_m": bounds_m.ravel().tolist(),
        "walls_m": rounded(walls),
        "signs_m": rounded(trace["signs_m"]),
        "sign_texts": json.loads(str(trace["sign_texts"])),
        "access_points_m": rounded(trace["access_points_m"]),
        "signal": _signal(trace),
        "true_poses": rounded(trace["true_poses"]),
        "estimated_poses": rounded(trace["estimated_poses"]),
        "odometry_m": rounded(trace["odometry_poses"][..., :2]) if "odometry_poses" in trace else None,
        "moments": moments,
        "report": report,
    }


def _wall_points_m(layer: dict[str, Any], cells: bytes) -> Array:
    """(n, 2) places of a layer's walls in the building frame."""
    kind = np.frombuffer(zlib.decompress(cells), np.uint8).reshape(layer["shape"])
    grid = GridMap((kind == WALL).astype(np.int16), np.array(layer["origin_m"]), layer["resolution_m"])
    return wall_points_m(grid, layer["pose_building_map"])


def _signal(trace: dict[str, Array]) -> dict[str, Any]:
    """Levels 1 to 255 over the range of the overlay, 0 where there is no floor."""
    low, high = SIGNAL_SPAN_DBM
    strength = trace["signal_dbm"]
    level = 1 + np.round(254 * np.clip((np.nan_to_num(strength, nan=low) - low) / (high - low), 0.0, 1.0))
    level = np.where(np.isfinite(strength), level, 0).astype(np.uint8)
    return {
        "shape": list(level.shape),
        "place": trace["signal_place"].tolist(),
        "cells": base64_of(zlib.compress(level.tobytes())),
    }


def rounded(values: Array) -> list:
    """Nested lists of the values of an array, rounded to the millimetre (or 1e-3 of another unit)."""
    return np.round(values.astype(np.float64), DIGITS).tolist()


def base64_of(content: bytes) -> str:
    """Bytes as text."""
    return base64.b64encode(content).decode("ascii")


@contextmanager
def contradictions(run: Path) -> Iterator[None]:
    """Turn exceptions from inconsistent arrays of a run folder into DataError."""
    try:
        yield
    except TwcError:
        raise
    except (LookupError, zlib.error, *UNFIT) as error:
        what = f"{run / 'trace.npz'} contradicts itself or report.json"
        raise DataError(f"{what}: {error}; run the episode again".replace("\n", " ")) from error


def read_trace(path: Path) -> dict[str, Array]:
    """The arrays of a trace.npz. Raises DataError if it is missing, invalid or of another format."""
    return read_arrays(path, "trace", FORMAT, TRACE_KEYS, "`twc-env explore --out RUN` writes one")


def read_report(path: Path) -> dict[str, Any]:
    """A report.json. Raises DataError if it is missing or invalid."""
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(f"cannot read {path}: {error.strerror}; name a run folder that holds a report") from error
    except UNFIT as error:
        raise DataError(f"{path} is not valid JSON: {error}; run the episode again") from error
    needed = {"map", "seed", "config_digest", "version"}
    if not isinstance(report, dict) or not needed <= set(report):
        raise DataError(f"{path} is not a report with {', '.join(sorted(needed))}; run the episode again")
    return report
