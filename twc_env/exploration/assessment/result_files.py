"""An episode's result as files and as tables of pandas."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from twc_env.config import to_dict
from twc_env.errors import ConfigError
from twc_env.exploration.assessment import result_table
from twc_env.records.geometry import compose
from twc_env.records.json_values import write_json
from twc_env.records.text_tables import csv_text, flat
from twc_env.records.whole_file import write_text

TABLES = ("figures", "paths")
DPI_MIN, DPI_MAX = 20, 1200


def frame_of(result: Any, what: str) -> Any:
    """See `EpisodeResult.to_frame`. Raises ConfigError for another table than `TABLES`, and without pandas."""
    if not isinstance(what, str) or what not in TABLES:
        raise ConfigError(f"tables are {' and '.join(TABLES)}; got {what!r}")
    if find_spec("pandas") is None:
        raise ConfigError(
            "to_frame() needs pandas: run `pip install 'twc_env[viz]'`; save(FOLDER) writes the same as CSV"
        )
    pandas = import_module("pandas")
    if what == "figures":
        return pandas.DataFrame([flat(result.figures)])
    return pandas.DataFrame(paths_of(result))


def paths_of(result: Any) -> dict[str, Any]:
    """Columns of the poses of all robots over time [s, m, rad], in the building frame."""
    estimated = result.estimated_poses.copy()
    for robots, pose in zip(result.viewers, result.pose_building_map, strict=True):
        estimated[:, list(robots)] = compose(pose, result.estimated_poses[:, list(robots)])
    steps, robots_count = result.true_poses.shape[:2]
    columns: dict[str, Any] = {
        "time_s": np.repeat(np.arange(steps) * result.config.dynamics.time_step_s, robots_count).round(6),
        "robot": np.tile(np.arange(robots_count), steps),
    }
    for kind, poses in (("true", result.true_poses), ("estimated", estimated), ("odometry", result.odometry_poses)):
        for axis, name in enumerate(("x_m", "y_m", "heading_rad")):
            columns[f"{kind}_{name}"] = poses[..., axis].reshape(-1)
    return columns


def save(result: Any, folder: Path, format: str, dpi: float | None) -> list[Path]:
    """See `EpisodeResult.save`. Raises ConfigError for another format than png, pdf, svg, or an unfit dpi."""
    from twc_env.exploration.drawing.figures import FORMATS, save_figure

    if not isinstance(format, str) or format not in FORMATS:
        raise ConfigError(f"format must be one of {', '.join(FORMATS)}; got {format!r}")
    if dpi is not None and not (isinstance(dpi, (int, float)) and DPI_MIN <= dpi <= DPI_MAX):
        raise ConfigError(f"dpi must be dots per inch from {DPI_MIN} to {DPI_MAX}; got {dpi!r}")
    paths = [folder / name for name in ("report.json", "config.json", "figures.csv", "figures.tex", "paths.csv")]
    write_json(paths[0], result.figures)
    write_json(paths[1], to_dict(result.config))
    columns = paths_of(result)
    lines = [",".join(columns), *(",".join(map(_shortest, row)) for row in zip(*columns.values(), strict=True))]
    texts = csv_text([flat(result.figures)]), result_table.latex_of(result.figures), "\n".join(lines) + "\n"
    for path, text in zip(paths[2:], texts, strict=True):
        write_text(path, text)
    if find_spec("matplotlib") is not None:
        paths.append(save_figure(result.plot(dpi), folder / f"map.{format}", dpi))
    return paths


def _shortest(value: Any) -> str:
    """A number in as few digits as give it back."""
    return repr(value.item())
