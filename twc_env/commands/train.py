"""`twc-env train`: learning."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager

from twc_env.errors import DataError
from twc_env.records.json_values import check_folder
from twc_env.running.command_line import add_folder, add_set, add_verbosity, assignments, natural

SEEDS = 2**31
"""Seeds are below this: torch and numpy accept no larger ones, and resuming adds the number of steps."""


@contextmanager
def learning_libraries() -> Iterator[None]:
    """Turns a missing library of the extra `train` into an error of one line."""
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in ("torch", "stable_baselines3", "tqdm"):
            raise
        raise DataError(f"training needs {error.name}; install it with: pip install 'twc_env[train]'") from None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Fill the parser of the command, which has one command per algorithm."""
    parser.description = (
        "Train an exploration policy shared by all robots of a team. Each algorithm has its own --help."
    )
    parser.epilog = "example:\n  twc-env train ppo --steps 60000 --out runs/ppo"
    algorithms = parser.add_subparsers(required=True, metavar="ALGORITHM")
    ppo = algorithms.add_parser(
        "ppo",
        help="train with proximal policy optimisation",
        description="Train one shared policy with PPO, in small generated buildings or on one map. Writes config.json, "
        "model.zip, metrics.csv and tensorboard/ to the run folder. The model is saved after each policy update, so an "
        "interrupted run continues with --resume. A new run needs a new folder.",
        epilog="examples:\n  twc-env train ppo --steps 60000 --out runs/ppo\n"
        "  twc-env train ppo --steps 120000 --out runs/ppo --resume\n"
        "  twc-env train ppo --map twin-01 --robots 3 --set odometry.drift=2 --out runs/twin",
    )
    ppo.add_argument("--map", help="bundled name, generated name or file, instead of small generated buildings")
    ppo.add_argument("--area", type=float, default=250.0, help="floor area of the generated buildings [m2]")
    ppo.add_argument("--robots", type=int, default=2, help="robots per team")
    ppo.add_argument(
        "--steps",
        type=int,
        default=181_000,
        help="total decisions of all robots, rounded up to whole policy updates; a busy robot counts as one per step",
    )
    ppo.add_argument("--max-cycles", type=int, default=500, help="time steps per episode")
    ppo.add_argument(
        "--workers",
        type=natural,
        default=2,
        help="worker processes (default: %(default)s; 0: none, run in this process)",
    )
    ppo.add_argument("--seed", type=int, default=0, help="of network, buildings and episodes")
    add_set(ppo)
    add_folder(ppo, "--out", "runs/ppo", "run folder")
    ppo.add_argument("--resume", action="store_true", help="continue from the model in the run folder")
    add_verbosity(ppo)
    ppo.set_defaults(
        run=_train_ppo, when_interrupted="interrupted; --resume continues from the last saved model, if any"
    )


def _train_ppo(options: argparse.Namespace) -> int:
    with learning_libraries():
        from twc_env.training import ppo
        from twc_env.training.run_folder import Task

    if options.steps < 1:
        raise DataError(f"--steps must be at least 1; got {options.steps}")
    if not 0 <= options.seed < SEEDS:
        raise DataError(f"--seed must be 0 to {SEEDS - 1}; got {options.seed}")
    check_folder(options.out)
    task = Task(
        options.map,
        area_m2=options.area,
        robots=options.robots,
        max_cycles=options.max_cycles,
        overrides=assignments(options.set),
    )
    settings = ppo.Settings(seed=options.seed, workers=options.workers)
    model_path = ppo.train(task, settings, options.steps, options.out, options.resume, show_progress=not options.quiet)
    print(f"model: {model_path}   learning curve: {options.out / 'metrics.csv'} and {options.out / 'tensorboard'}")
    return 0
