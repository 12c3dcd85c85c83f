"""`twc-env explore`: run one episode with a scripted team."""

from __future__ import annotations

import argparse
from pathlib import Path

from twc_env.commands.team_options import (
    add_agent,
    add_team,
    folder_name,
    paragraphs,
    team_config,
    tell_cut_off,
    tell_unused_starts,
)
from twc_env.config import EnvConfig, digest, override, robot_configs
from twc_env.records.json_values import TERMINAL, check_folder, write_json
from twc_env.running.command_line import INTERRUPTED
from twc_env.running.options import add_lasting, add_pictures, natural, picture_options, prior_setting
from twc_env.running.terminal import Bar, end_line, tell

_EXPLORE_HELP = """\
Run one episode with a scripted team and write a run folder:
report.json (metrics, defined in docs/figures.md), config.json, map.png, a film named by map and seed such as
twin-01-seed0.gif, map.pgm + map.yaml, frames.npz and trace.npz (docs/frames.md), pose_graph.g2o, pose_graph.csv (whose
keyframe each vertex is) and trajectories/*.tum (readable by evo). Ctrl-C or SIGTERM ends the episode early, and the
folder is written of the steps until then (exit status 130 or 143); a second Ctrl-C ends the command at once.

examples:
  twc-env explore
  twc-env explore --map twin-02 --robots 3 --seed 1 --out runs/twin-02
  twc-env explore --map office.yaml --steps 6000 --set odometry.drift=2 --set lidar.beam_count=360
  twc-env explore --map gen:office:800:7 --agent random --no-pictures --json -
  twc-env explore --agent mine.py:Mine        your own team: a class derived from agents.Policy
  twc-env explore --config runs/twin-02 --seed 1        the same episode again, to the byte
  twc-env explore --config twc/ExploreHard-v0 --steps 1500
  twc-env explore --map test/0003 --save monday.npz
  twc-env explore --map test/0003 --seed 1 --prior monday.npz --save tuesday.npz
  twc-env explore --robots handheld,wheeled,legged      a mixed team (docs/world.md)
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Fill the command's parser."""
    parser.description, parser.epilog = paragraphs(_EXPLORE_HELP)
    parser.add_argument(
        "--map",
        help="a bundled map (list: twc-env maps list), a generated one such as gen:office:800:7 or test/0003, or a "
        "file (default: twin-01)",
    )
    parser.add_argument("--seed", type=natural, default=0, help="of start poses, noise and generated signs")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="run folder (default: runs/MAP-AGENT-seedSEED, plus a digest of the settings if they are not the "
        "defaults)",
    )
    parser.add_argument("--no-film", action="store_true", help="do not write the film")
    add_pictures(parser)
    parser.set_defaults(run=_explore)
    add_agent(parser)
    add_team(parser)
    add_lasting(parser)


def _explore(options: argparse.Namespace) -> int:
    from twc_env.agents import picture
    from twc_env.agents.explore import explore, write_run
    from twc_env.agents.roster import display_name
    from twc_env.exploration.assessment.result_table import text_of
    from twc_env.maps import load_map
    from twc_env.world.building.splits import is_set

    config = override(team_config(options, options.map, options.steps), prior_setting(options))
    has_film = not (options.no_film or options.no_pictures)
    if not options.no_pictures:
        picture.require_libraries(has_film)
    folder = options.out or _run_folder(config, options.agent, options.seed)
    check_folder(folder)
    if not is_set(config.map):
        plan = load_map(config.map)
        if config.episode.starts == "random":
            tell_unused_starts(config.map, plan)
        tell_cut_off(config.map, plan, max(own.dynamics.robot_radius_m for own in robot_configs(config)))
    film = picture.Film() if has_film else None
    bar = Bar(config.max_cycles, "steps", f"on {folder_name(config.map)}, seed {options.seed}", every=20)

    def watch(done: int, share: float) -> None:
        bar.show(done, f"{share:.1%} in a correctly merged map", f"{share:.1%} in a correct map")

    run = explore(config, options.agent, options.seed, film, watch, options.save)
    end_line()
    write_run(run, folder, picture_options(options) is not None, options.format, options.dpi)
    write_json(options.json, run.report)
    if options.json != TERMINAL:
        print(text_of({**run.report, "agent": display_name(options.agent)}))
        if run.saved is not None:
            print(f"\nmap saved: {run.saved}")
        shown = [p.name for p in sorted(folder.iterdir()) if p.suffix in (".png", ".pdf", ".svg", ".gif")]
        print(f"\nwritten: {folder}: {', '.join([*shown, 'report.json'])} and more")
    if run.was_interrupted:
        tell(f"interrupted after {run.report['steps']} steps; the results cover these")
    return INTERRUPTED if run.was_interrupted else 0


def _run_folder(config: EnvConfig, agent: str, seed: int) -> Path:
    """The default run folder, different for different settings."""
    name = f"{folder_name(config.map)}-{agent.rpartition(':')[2]}-seed{seed}"
    is_usual = config == override(EnvConfig(), {"map": config.map})
    return Path("runs") / (name if is_usual else f"{name}-{digest(config)}")
