"""Merging of saved map files: reading, joining, the text for the terminal and the files that are written."""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from twc_env.errors import MapError
from twc_env.records.json_values import check_folder, write_json
from twc_env.running.output_folder import make_folder
from twc_env.running.terminal import aligned, show_count, terminal_width
from twc_env.slam.saved_maps.map_joining import Group, JoinedMaps, Pair, join_maps
from twc_env.slam.saved_maps.saved_map import SavedMap

_GRID_SUFFIXES = {".yaml", ".yml", ".png", ".pgm"}


def merge_files(
    names: Sequence[str], resolution_m: float | None, out: Path, json: Path | None = None
) -> tuple[str, bool]:
    """Merge the maps of these files and write what was found to the folder `out`; json: another copy.

    Returns a text for the terminal, and whether any two maps were merged. Raises MapError for fewer than two maps and
    for one that cannot be read.
    """
    if len(names) < 2:
        raise MapError("merging takes two maps or more; name another")
    if resolution_m is not None and not 0.005 <= resolution_m <= 10:
        raise MapError(f"--resolution must be 0.005 to 10 m per pixel; got {resolution_m:g}")
    check_folder(out)
    maps = read_saved_maps(names, resolution_m)
    joined = join_maps(maps, lambda done, total: show_count(done, total, " pairs"))
    make_folder(out)
    written = [path for number, group in enumerate(joined.groups, 1) for path in _write_group(maps, group, number, out)]
    found = summary(names, maps, joined)
    write_json(out / "transforms.json", found)
    write_json(json, found)
    lines = [aligned(_rows(maps, joined), terminal_width())]
    for pair in joined.pairs:
        if not pair.placement.is_believed:
            lines.append(f"{maps[pair.first].name} and {maps[pair.second].name} not merged: {pair.placement.reason}")
    lines += [f"written: {path}" for path in (*written, out / "transforms.json")]
    return "\n".join(lines), bool(written)


def read_saved_maps(names: Sequence[str], resolution_m: float | None = None) -> list[SavedMap]:
    """The maps of these files or names; equal names are told apart by their folders, or numbered. Raises MapError."""
    from twc_env.datasets.buildings.grid_file import grid_of_plan, read_grid
    from twc_env.maps import load_map

    grids = []
    for name in names:
        suffixes = {suffix.lower() for suffix in Path(name).suffixes[-2:]}
        is_grid = bool(suffixes & _GRID_SUFFIXES) and os.path.isfile(name)
        grids.append(read_grid(name, resolution_m) if is_grid else grid_of_plan(load_map(name)))
    stems = [Path(name).name.split(".")[0] or name for name in names]
    if len(set(stems)) < len(stems) and all(len(Path(name).parts) > 1 for name in names):
        stems = [f"{Path(name).parent.name}/{stem}" for name, stem in zip(names, stems, strict=True)]
    labels = [
        stem if stems.count(stem) == 1 else f"{stem} ({stems[: k + 1].count(stem)})" for k, stem in enumerate(stems)
    ]
    return [
        SavedMap(label, grid.free, grid.occupied, grid.resolution_m, grid.origin)
        for label, grid in zip(labels, grids, strict=True)
    ]


def summary(names: Sequence[str], maps: list[SavedMap], joined: JoinedMaps) -> dict:
    """What transforms.json holds."""
    groups = []
    for number, group in enumerate(joined.groups, 1):
        groups.append({
            "frame": maps[group.members[0]].name,
            "map": f"{_stem(number)}.yaml" if len(group.members) > 1 else None,
            "maps": [
                {"name": maps[m].name, "file": str(names[m]), "x_m": pose[0], "y_m": pose[1], "yaw_rad": pose[2]}
                for m, pose in zip(group.members, group.poses, strict=True)
            ],
        })  # fmt: skip
    return {"groups": groups, "pairs": [_pair_values(maps, pair) for pair in joined.pairs]}


def _pair_values(maps: list[SavedMap], pair: Pair) -> dict:
    best = pair.placement.best
    values: dict = {"first": maps[pair.first].name, "second": maps[pair.second].name}
    if best is not None:
        values |= {
            "x_m": best.pose[0],
            "y_m": best.pose[1],
            "yaw_rad": best.pose[2],
            "overlap": best.overlap,
            "overlap_m2": best.overlap_m2,
            "agreeing_wall_m": best.agreeing_m,
            "contradicting_wall_m": best.contradicting_m,
        }
    return values | {
        "certainty": pair.placement.certainty,
        "merged": pair.placement.is_believed,
        "reason": pair.placement.reason,
    }


def _rows(maps: list[SavedMap], joined: JoinedMaps) -> list[dict]:
    """The table: each map in the frame of its group, and the best of its placements among those used."""
    rows = []
    for group in joined.groups:
        for m, pose in zip(group.members, group.poses, strict=True):
            used = [
                pair for pair in joined.pairs
                if pair.placement.is_believed and m in (pair.first, pair.second)
            ]  # fmt: skip
            best = max(used, key=lambda pair: pair.placement.certainty, default=None)
            agreement = None if best is None else best.placement.best
            rows.append({
                "map": maps[m].name,
                "in": maps[group.members[0]].name if len(group.members) > 1 else "alone",
                "x [m]": round(float(pose[0]), 3),
                "y [m]": round(float(pose[1]), 3),
                "yaw [deg]": round(float(np.degrees(pose[2])), 2),
                "overlap": None if agreement is None else f"{100 * agreement.overlap:.0f} %",
                "certainty": None if best is None else f"{best.placement.certainty:.3f}",
            })  # fmt: skip
    return rows


def _write_group(maps: list[SavedMap], group: Group, number: int, out: Path) -> list[Path]:
    from twc_env.datasets.buildings.ros_map import write_ros_map
    from twc_env.pictures.merged_maps import draw_merged
    from twc_env.slam.saved_maps.merged_grid import merged_grid

    if len(group.members) < 2:
        return []
    members = [maps[m] for m in group.members]
    grid = merged_grid(members, group.poses)
    written = [write_ros_map(grid, out, _stem(number))]
    if find_spec("matplotlib") is not None:
        title = f"{len(members)} maps in the frame of {members[0].name}"
        draw_merged(grid, members, group.poses, title, out / f"{_stem(number)}.png")
        written.append(out / f"{_stem(number)}.png")
    return written


def _stem(number: int) -> str:
    return "map" if number == 1 else f"map_{number}"
