"""`twc-env warm-up`: compile all kernels before the first episode."""

from __future__ import annotations

import argparse
import time

STEPS = 600
"""Of each episode of `compile_for_commands`."""
EPISODES = (
    ("nearest-frontier", {"slam.cues.text": False, "slam.cues.wifi": False}),
    ("informed", {"world": "ward", "lidar.preset": "rplidar-a1", "slam.place_recognition.recogniser": "fused"}),
    ("informed", {"world": "mall", "lidar.preset": "rplidar-a1"}),
    ("voronoi", {"world": "office"}),
    ("random", {"slam.mode": "off"}),
    ("segments", {"slam.cues.text": False}),
    ("rrt", {"slam.prior": "earlier-session:300"}),
    ("nearest-frontier", {"slam.cues.lidar": False}),
)
"""Teams and settings that between them need what no other episode of `twc-env warm-up` does: planning by the map, the
true plan, rooms and random trees, scan descriptors, people, doors, furniture, a scanner's errors, WiFi alone, dead
reckoning, an earlier session's map, one robot alone, and radio without scan matching."""
TEAM_SIZES = 4, 8
"""Numbers of robots of tasks of the suite that no episode here has: views of maps are compiled for each number."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.description = (
        "Compile what episodes need, in every world, with every scanner, team and learner, and what replays of logs "
        "need, and keep it on disk: some minutes. The first episode on a machine does so anyway; this is for images "
        "and clusters, whose processes then start at once. What few settings and commands need (glass, walls from "
        "WiFi, localisation in saved maps) is compiled when it is first used."
    )
    parser.epilog = (
        "examples:\n  twc-env warm-up\n  NUMBA_CACHE_DIR=/opt/kernels twc-env warm-up\n\n"
        "The kernels go to NUMBA_CACHE_DIR, or to the user's cache folder. In an image: set NUMBA_CACHE_DIR to "
        "a folder of the image and run this as its last step; the folder may be read-only afterwards."
    )
    parser.set_defaults(run=_run)


def _run(_arguments: argparse.Namespace) -> None:
    from twc_env.exploration.warm_up import compile_all
    from twc_env.kernels.cache_folder import cache_folder, is_kept
    from twc_env.kernels.compilation import EVERYTHING
    from twc_env.kernels.compile_events import ARE_KNOWN

    begin_s = time.perf_counter()
    count = compile_all(EVERYTHING) + compile_for_commands()
    done = f"{count} functions compiled" if count else "nothing to compile: all kernels were there"
    if not ARE_KNOWN:
        done = "all kernels are there; this numba does not tell how many it compiled"
    kept = f"kept in {cache_folder()}" if is_kept() else "NOT kept: no folder can be written, set NUMBA_CACHE_DIR"
    print(f"{done} ({time.perf_counter() - begin_s:.0f} s); {kept}")


def compile_for_commands(steps: int = STEPS) -> int:
    """Compile what velocity commands with all cues in the clean world do not need (`EPISODES`, choices of frontiers,
    drawing, logs); the number of functions compiled."""
    from twc_env.agents.explore import explore
    from twc_env.config import EnvConfig, override
    from twc_env.exploration.environment import ExplorationEnv
    from twc_env.exploration.warm_up import MAP, SEED
    from twc_env.kernels import compilation

    before = compilation.announcer().count
    settings = {"map": MAP, "robots": 2, "max_cycles": steps}
    for team, own in EPISODES:
        explore(override(EnvConfig(), {**settings, **own}), team, SEED)
    for robots in TEAM_SIZES:
        ExplorationEnv(config=override(EnvConfig(), {**settings, "robots": robots})).reset(seed=SEED)
    env = ExplorationEnv(config=override(EnvConfig(), {**settings, "action.kind": "frontier"}), render_mode="rgb_array")
    seen, _ = env.reset(seed=SEED)
    while env.agents:
        seen, *_ = env.step({agent: int(blocks["action_mask"].argmax()) for agent, blocks in seen.items()})
    env.render()
    _replay_sample()
    return compilation.announcer().count - before


def _replay_sample() -> None:
    from twc_env.datasets.sample import sample_files
    from twc_env.pictures.log_page import LogPage
    from twc_env.replaying.inputs import Asked, read_input
    from twc_env.replaying.odometry_errors import with_errors_of_log
    from twc_env.replaying.run import run
    from twc_env.running.terminal import without_progress

    files = sample_files()
    source = with_errors_of_log(read_input(files.logs, Asked(wifi=files.wifi, signs=files.signs)))
    page = LogPage(source.config.robots, len(source.steps), source.config.dynamics.robot_radius_m)
    with without_progress():
        run(source, source.config, page.note).table()
