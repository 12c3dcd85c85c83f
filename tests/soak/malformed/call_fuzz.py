"""Public functions and methods called with odd arguments: each call may only raise TwcError."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import twc_env
from tests.soak.attempts import Attempt, workplace
from tests.soak.malformed.action_fuzz import ODD_ACTIONS
from twc_env import config as settings
from twc_env import metrics
from twc_env.datasets.lasting_maps import read_lasting_map
from twc_env.datasets.logs.frame_log import read_frame_log, read_truth_log
from twc_env.datasets.logs.pose_graph_file import read_pose_graph
from twc_env.datasets.logs.tum import read_tum
from twc_env.exploration.single_agent import SingleRobotEnv
from twc_env.records.random_streams import random_stream
from twc_env.replaying.inputs import Asked, read_input
from twc_env.vector.teams import VectorTeams

ODD: tuple = (
    *ODD_ACTIONS,
    "", "robot_0", "robot_7", "/", "..", "\x00", "x" * 5000, "gen:office:-1:0", "test/99999999", 0, 10**400,
    -(10**30), np.float64("nan"), np.int64(-5), [None], {"a": 1}, {1: 2}, {"map": []}, {"starts": "x"}, Path("."), b"",
    {"robots": "x"}, {"lidar": 5}, {"lidar.beam_count": [1]}, np.zeros((3, 0)), np.full((2, 3), np.inf), slice(1),
    np.ma.masked_array([1.0, 2.0], [True, False]), iter(()), Ellipsis, NotImplemented, type, ["\ud800"], "gen:x",
)  # fmt: skip
SMALL = {"robots": 2, "max_cycles": 50, "lidar.beam_count": 36}
RENEW_EVERY = 300
"""Calls with the same environments."""
Call = tuple[str, Callable[..., Any], dict[str, Any]]


def misused_calls(count: int, seed: int = 0) -> Iterator[Attempt]:
    """Make `count` calls with at least one odd argument; equal seeds make the same ones."""
    random = random_stream(seed, "call-fuzz")
    with workplace() as folder, contextlib.chdir(folder):  # for files that a call writes where it is
        calls: list[Call] = []
        for number in range(count):
            if number % RENEW_EVERY == 0:
                calls = _calls(folder)
            name, function, arguments = calls[int(random.integers(len(calls)))]
            keys = list(arguments)
            odd = {keys[int(random.integers(len(keys)))] for _ in range(1 + int(random.random() < 0.2))}
            given = {key: ODD[int(random.integers(len(ODD)))] if key in odd else arguments[key] for key in keys}
            told = ", ".join(f"{key}={given[key]!r:.40}" for key in sorted(odd))
            yield f"#{number} {name}({told})", partial(function, **given)


def _calls(folder: Path) -> list[Call]:
    """Every public function and method with sound arguments by name."""
    env = twc_env.parallel_env(config=SMALL)
    env.reset(seed=0)
    env.step({agent: np.zeros(2) for agent in env.agents})
    turns = twc_env.env(config=SMALL)
    turns.reset(seed=0)
    alone = SingleRobotEnv(config={**SMALL, "robots": 1})
    alone.reset(seed=0)
    teams = VectorTeams(2, SMALL)
    teams.reset(0)
    engine, result, plan = env.engine, env.result(), env.floorplan
    result.save(folder / "first")  # at its first picture matplotlib asks the system for fonts
    engine_alone = twc_env.CooperativeSlam(env.config, 2)
    poses = np.zeros((5, 2, 3))
    team = {
        "map": "twin-01",
        "robots": 2,
        "max_cycles": 9,
        "config": SMALL,
        "render_mode": None,
        "task": "twc/Explore-v0",
    }
    defaults = settings.EnvConfig()
    of_map = {
        "log_odds": np.zeros((4, 4)), "origin_m": np.zeros(2), "resolution_m": 0.1, "pose_building_map": np.zeros(3),
        "walls_m": plan.walls_m,
    }  # fmt: skip
    return [
        ("parallel_env", twc_env.parallel_env, team),
        ("env", twc_env.env, team),
        ("raw_env", twc_env.raw_env, team),
        ("load_map", twc_env.load_map, {"name_or_path": "twin-01", "seed": 0}),
        ("task_config", twc_env.task_config, {"task": "twc/Explore-v0"}),
        ("from_dict", settings.from_dict, {"values": SMALL}),
        ("override", settings.override, {"config": defaults, "assignments": SMALL}),
        ("load", settings.load, {"path": folder}),
        ("lidar_preset", settings.lidar_preset, {"name": "lds-01"}),
        ("radio_preset", settings.radio_preset, {"name": "radio-mall"}),
        ("world_preset", settings.world_preset, {"name": "ward"}),
        (
            "EnvConfig",
            settings.EnvConfig,
            {"map": "twin-01", "robots": 2, "max_cycles": 5, "lidar": settings.LidarConfig()},
        ),
        ("LidarConfig", settings.LidarConfig, {"beam_count": 36, "range_max_m": 5.0, "is_rolling": False}),
        ("ExplorationEnv.reset", env.reset, {"seed": 0, "options": {"map": "twin-02"}}),
        ("ExplorationEnv.step", env.step, {"actions": {}}),
        ("ExplorationEnv.observation_space", env.observation_space, {"agent": "robot_0"}),
        ("ExplorationEnv.action_space", env.action_space, {"agent": "robot_0"}),
        ("ExplorationEnv.belief", env.belief, {"agent": "robot_0"}),
        ("ExplorationEnv.restore", env.restore, {"snapshot": env.snapshot()}),
        ("ExplorationEnv.watch", env.watch, {"spectator": print}),
        ("AEC.reset", turns.reset, {"seed": 0, "options": None}),
        ("AEC.step", turns.step, {"action": np.zeros(2)}),
        ("SingleRobotEnv.reset", alone.reset, {"seed": 0, "options": None}),
        ("SingleRobotEnv.step", alone.step, {"action": np.zeros(2)}),
        ("VectorTeams", VectorTeams, {"count": 1, "config": SMALL, "workers": 0, "buildings": "train"}),
        ("VectorTeams.reset", teams.reset, {"seed": 0}),
        ("VectorTeams.step", teams.step, {"actions": np.zeros((2, 2, 2))}),
        ("VectorTeams.send", teams.send, {"actions": np.zeros((1, 2, 2)), "ids": [0]}),
        ("VectorTeams.states", teams.states, {"ids": [0]}),
        ("CooperativeSlam", twc_env.CooperativeSlam, {"config": env.config, "robot_count": 2, "prior": None}),
        ("CooperativeSlam.update", engine_alone.update, {"frames": env.frames, "contacts": None}),
        ("CooperativeSlam.belief", engine.belief, {"robot": 0}),
        ("CooperativeSlam.mapper_of", engine.mapper_of, {"robot": 0}),
        ("CooperativeSlam.pose_map_robot", engine.pose_map_robot, {"robot": 0}),
        ("CooperativeSlam.found_prior", engine.found_prior, {"robot": 0}),
        ("EpisodeResult.to_frame", result.to_frame, {"what": "figures"}),
        ("EpisodeResult.save", result.save, {"folder": folder / "result", "format": "png", "dpi": 40.0}),
        ("Floorplan.cells", plan.cells, {"resolution_m": 0.1}),
        ("align_team", metrics.align_team, {"estimated": poses, "true": poses}),
        ("lay_map", metrics.lay_map, {"estimated": poses, "true": poses}),
        ("absolute_trajectory_error_m", metrics.absolute_trajectory_error_m, {"estimated": poses, "true": poses}),
        ("end_point_error_m", metrics.end_point_error_m, {"estimated": poses[:, 0], "true": poses[:, 0]}),
        ("path_length_m", metrics.path_length_m, {"poses": poses[:, 0]}),
        ("closures_are_correct", metrics.closures_are_correct, {"measured": poses[0], "true": poses[0]}),
        ("score_closures", metrics.score_closures, {"is_correct": [True], "is_accepted": [True]}),
        ("wrong_pairs", metrics.wrong_pairs, {"poses_building_map": poses[0], "centre_map_m": (0.0, 0.0)}),
        ("wall_thickness_m", metrics.wall_thickness_m, of_map),
        ("read_lasting_map", read_lasting_map, {"path": folder / "none.npz"}),
        ("read_frame_log", read_frame_log, {"path": folder / "none.npz"}),
        ("read_truth_log", read_truth_log, {"path": folder / "none.npz"}),
        ("read_pose_graph", read_pose_graph, {"path": folder / "none.g2o"}),
        ("read_tum", read_tum, {"path": folder / "none.tum"}),
        ("read_input", lambda log: read_input([log], Asked()), {"log": folder / "none.log"}),
    ]
