"""Files of a replay: maps, pose graph, trajectories, picture, page, table, and a bag."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

from twc_env.datasets.buildings.ros_map import write_ros_maps
from twc_env.datasets.logs.g2o import write_g2o, write_vertices
from twc_env.datasets.logs.tum import write_tum
from twc_env.datasets.ros.bag_writer import RobotEstimate, write_estimates
from twc_env.errors import DataError
from twc_env.records.messages import GridMap
from twc_env.records.whole_file import whole_file
from twc_env.replaying.run import Replay, groups_by_size
from twc_env.running.output_folder import make_folder
from twc_env.slam.team import TeamMapper


def write_maps(folder: Path, team: TeamMapper) -> None:
    """ROS maps of all groups, and the pose graph. Further maps of an earlier run in the same folder are deleted."""
    make_folder(folder)
    if (folder / "pose_graph.g2o").is_file():
        _delete([*folder.glob("map_[0-9]*.pgm"), *folder.glob("map_[0-9]*.yaml")])
    write_ros_maps(map(team.grid_of, groups_by_size(team)), folder)
    graph = team.graph()
    write_g2o(folder / "pose_graph.g2o", graph)
    write_vertices(folder / "pose_graph.csv", graph)


def write_paths(folder: Path, replay: Replay) -> None:
    """Each robot's trajectory at the times of its frames: in its group's map, and by odometry from its start.

    Poses from before it was carried that are in another map have files of their own, `part_1` and so on; those from
    while it was lost in a finished map are left out. Trajectories of an earlier run in the same folder are deleted.
    """
    make_folder(folder / "trajectories")
    _delete([*folder.glob("trajectories/*_estimated.tum"), *folder.glob("trajectories/*_odometry.tum")])
    for path in replay.paths():
        name = path.name.strip("/").replace("/", "_") or f"robot_{path.robot}"
        write_tum(folder / "trajectories" / f"{name}_odometry.tum", path.times_s, path.odometry)
        for group in {path.group_at_end, *path.group[path.group >= 0].tolist()}:
            rows = path.group == group
            part = "" if group == path.group_at_end else f"_part_{1 + path.part[rows][0]}"
            write_tum(folder / "trajectories" / f"{name}{part}_estimated.tum", path.times_s[rows], path.estimated[rows])


def _delete(files: Iterable[Path]) -> None:
    for path in files:
        path.unlink(missing_ok=True)


def write_table(path: Path, rows: Sequence[dict]) -> None:
    """A table as CSV."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    with whole_file(path) as beside:
        beside.write_text(text.getvalue(), encoding="utf-8")


def write_bag(path: Path, replay: Replay) -> None:
    """Poses, transforms and maps as a bag of ROS."""
    team = replay.engine.team
    order = groups_by_size(team)
    frames = {group: "map" if k == 0 else f"map_{k + 1}" for k, group in enumerate(order)}
    estimates = []
    for own in replay.paths():
        name = own.name or (f"robot_{own.robot}" if replay.robots > 1 else "")
        map_frame = frames[team.group_index(own.robot)]
        is_known = own.group == own.group_at_end
        estimates.append(RobotEstimate(name, map_frame, own.times_s, own.estimated, own.logged, is_known))
    grids: dict[str, GridMap] = {
        frames[group]: team.grid_of(group) for group in order if team.grid_of(group).log_odds.size
    }
    try:
        write_estimates(path, estimates, grids)
    except OSError as error:
        raise DataError(f"cannot write the bag {path}: {error.strerror or error}; choose another place") from error
