"""Names of modules that have moved: importing an old one fails with the new name."""

from __future__ import annotations

import sys
from importlib.abc import MetaPathFinder
from typing import Any

MOVED = {
    "cell_rows": "kernels.cell_rows",
    "class_file": "records.class_file",
    "command_line": "running.command_line",
    "file_lock": "processes.file_lock",
    "finished_parts": "running.finished_parts",
    "geometry": "records.geometry",
    "json_values": "records.json_values",
    "kernel_packs": "kernels.packs",
    "map_picture": "pictures.map_picture",
    "messages": "records.messages",
    "random_streams": "records.random_streams",
    "rerun_export": "pictures.rerun_export",
    "replay_page": "pictures.replay_page",
    "sb3": "vector.sb3",
    "team_messages": "records.team_messages",
    "video": "pictures.video",
    "whole_copy": "records.whole_copy",
    "without_infos": "vector.without_infos",
    "worker_processes": "processes.worker_processes",
    "datasets.frame_log": "datasets.logs.frame_log",
    "datasets.g2o": "datasets.logs.g2o",
    "datasets.map_export": "datasets.buildings.map_export",
    "datasets.radio_frames": "datasets.logs.radio_frames",
    "datasets.ros_map": "datasets.buildings.ros_map",
    "datasets.scan_log": "datasets.logs.scan_log",
    "datasets.tum": "datasets.logs.tum",
    "exploration.evaluation": "exploration.assessment.evaluation",
    "exploration.rewards": "exploration.assessment.rewards",
    "reproduce.sfw_flats": "reproduce.walls.sfw_flats",
    "slam.change_points": "slam.walls.change_points",
    "slam.global_matching": "slam.matching.global_matching",
    "slam.k_clusters": "slam.walls.k_clusters",
    "slam.k_visibility": "slam.walls.k_visibility",
    "slam.k_visibility_rules": "slam.walls.k_visibility_rules",
    "slam.place_recognition": "slam.places.place_recognition",
    "slam.radio_map": "slam.radio.radio_map",
    "slam.radio_slam": "slam.radio.radio_slam",
    "slam.robust_backend": "slam.pose_graph.robust_back_end",
    "slam.scan_matching": "slam.matching.scan_matching",
    "slam.trace_joining": "slam.radio.trace_joining",
    "training.evaluate": "suite.evaluation",
    "world.floorplan": "world.building.floorplan",
    "world.floorplan_file": "world.building.floorplan_file",
    "world.router_placement": "world.building.router_placement",
}
"""New names by old ones, below `twc_env`: modules that the documentation has named."""


class _MovedModules(MetaPathFinder):
    """Asked last, so only for modules that do not exist."""

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> None:
        """Raise ModuleNotFoundError with the new name of a moved module; None for any other."""
        package, _, name = fullname.partition(".")
        if package == "twc_env" and name in MOVED:
            # Without the name of the module: `from package import module` hides an error that bears it.
            raise ModuleNotFoundError(f"{fullname} is now twc_env.{MOVED[name]}")


def name_moved_modules() -> None:
    """From now on, an import of a moved module says where it is."""
    if not any(isinstance(finder, _MovedModules) for finder in sys.meta_path):
        sys.meta_path.append(_MovedModules())
