"""`twc-env record`: the sensor frames of an episode."""

from __future__ import annotations

import argparse

from twc_env.records.json_values import check_folder
from twc_env.running.command_line import INTERRUPTED
from twc_env.running.command_start import Interruption
from twc_env.running.options import add_config, add_folder, add_set, assignments, config_of, count, natural
from twc_env.running.output_folder import alone_in
from twc_env.running.terminal import end_line, show_count, tell


def add_arguments(record: argparse.ArgumentParser) -> None:
    """Fill the command's parser."""
    record.description = (
        "Record an episode of robots driven by a reactive policy. Writes frames.npz (sensor frames and settings, no "
        "ground truth) and truth.npz (true poses); see docs/frames.md. Ctrl-C or SIGTERM ends the recording early, and "
        "what there is of it is written. `twc-env explore` records frames too."
    )
    record.epilog = (
        "examples:\n  twc-env record --map twin-02 --steps 900 --out runs/log\n"
        "  twc-env record --config twc/ExploreMixed-v1 --steps 900 --out runs/mixed"
    )
    record.add_argument("--map", help="bundled name, generated name or file (default: that of the settings)")
    record.add_argument("--robots", type=count, help="number of robots (default: that of the settings)")
    record.add_argument("--steps", type=count, default=600, help="time steps of 0.1 s")
    add_config(record)
    record.add_argument("--seed", type=natural, default=0, help="of start poses, noise and generated signs")
    add_set(record)
    add_folder(record, "--out", "runs/log", "folder of the log")
    record.set_defaults(run=_record)


def _record(options: argparse.Namespace) -> int:
    from twc_env.bench.rates import wander
    from twc_env.config import override
    from twc_env.datasets.logs.frame_log import write_frame_log, write_truth_log
    from twc_env.exploration.environment import ExplorationEnv

    check_folder(options.out)
    told = {"map": options.map, "robots": options.robots, "max_cycles": options.steps}
    settings = {key: value for key, value in told.items() if value is not None}
    env = ExplorationEnv(config=override(config_of(options.config), {**settings, **assignments(options.set)}))
    env.reset(seed=options.seed)
    log = [(env.frames, env.contacts)]
    with Interruption() as interruption:
        for actions in wander(env, options.seed):
            env.step(actions)
            log.append((env.frames, env.contacts))
            show_count(len(log) - 1, env.config.max_cycles, " steps", every=50)
    end_line()
    steps, contacts = zip(*log, strict=True)
    true_poses = env.episode.record.true_poses[: len(steps)]
    with alone_in(options.out):
        write_frame_log(options.out / "frames.npz", env.config, steps, contacts)
        write_truth_log(options.out / "truth.npz", options.seed, env.episode.config.map, true_poses)
    print(f"{len(steps) - 1} steps of {env.config.robots} robot{'s' * (env.config.robots > 1)}\nwritten: {options.out}")
    if interruption.came:
        tell(f"interrupted after {len(steps) - 1} steps; the log holds these")
    return INTERRUPTED if interruption.came else 0
