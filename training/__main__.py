"""`python -m training ppo ...` and `python -m training evaluate ...`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from twc_env.errors import DataError
from twc_env.records.json_values import check_folder, write_json
from twc_env.running.command_line import (
    Parser,
    add_folder,
    add_set,
    add_version,
    assignments,
    natural,
    parse_seeds,
    run_command,
)

SEEDS = 2**31
"""Seeds are below this: torch and numpy accept no larger ones, and resuming adds the number of steps."""


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns the exit status: 0 done, 2 wrong input, 130 interrupted."""
    try:
        return run_command(_parser(), arguments)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in ("torch", "stable_baselines3", "tqdm"):
            raise
        print(f"error: training needs {error.name}; install it with: pip install 'twc_env[train]'", file=sys.stderr)
    return 2


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="python -m training",
        description="Train and evaluate exploration policies shared by all robots of a team. Each command has its own "
        "--help.",
        epilog="examples:\n  python -m training ppo --steps 60000 --out runs/ppo\n"
        "  python -m training evaluate --model runs/ppo/model.zip --seeds 0-19",
    )
    add_version(parser)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    ppo = commands.add_parser(
        "ppo",
        help="train with proximal policy optimisation",
        description="Train one shared policy with PPO, in small generated buildings or on one map. Writes config.json, "
        "model.zip, metrics.csv and tensorboard/ to the run folder. The model is saved after each policy update, so an "
        "interrupted run continues with --resume. A new run needs a new folder.",
        epilog="examples:\n  python -m training ppo --steps 60000 --out runs/ppo\n"
        "  python -m training ppo --steps 120000 --out runs/ppo --resume\n"
        "  python -m training ppo --map twin-01 --robots 3 --set odometry.drift=2 --out runs/twin",
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
    ppo.set_defaults(
        run=_train_ppo, when_interrupted="interrupted; --resume continues from the last saved model, if any"
    )

    evaluate = commands.add_parser(
        "evaluate",
        help="compare a trained policy with random and scripted teams in held-out buildings",
        description="Run one episode per held-out building with the trained policy, a random one, the nearest frontier "
        "and the scripted nearest-frontier team; print means with 95 % confidence intervals.",
        epilog="example:\n  python -m training evaluate --model runs/ppo/model.zip --seeds 0-4 --films runs/ppo/films",
    )
    evaluate.add_argument(
        "--model",
        metavar="MODEL",
        type=Path,
        default=Path("runs/ppo/model.zip"),
        help="a run folder, or a model file next to its config.json",
    )
    evaluate.add_argument("--json", type=Path, metavar="FILE", help="write all episodes and the means")
    evaluate.add_argument("--seeds", default="0-19", help="seeds of held-out buildings, e.g. 0-4 or 1,5,7")
    evaluate.add_argument(
        "--films", type=Path, metavar="FOLDER", help="write a GIF of the trained team in each building"
    )
    evaluate.set_defaults(run=_evaluate)
    return parser


def _train_ppo(options: argparse.Namespace) -> int:
    from training import ppo
    from training.run_folder import Task

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
    model_path = ppo.train(task, settings, options.steps, options.out, options.resume)
    print(f"model: {model_path}   learning curve: {options.out / 'metrics.csv'} and {options.out / 'tensorboard'}")
    return 0


def _evaluate(options: argparse.Namespace) -> int:
    from training.evaluate import evaluate

    seeds = parse_seeds(options.seeds)
    if max(seeds) >= SEEDS:
        raise DataError(f"--seeds must be 0 to {SEEDS - 1}; got {max(seeds)}")
    found = evaluate(options.model, seeds, films=options.films)
    print(found.table)
    write_json(options.json, found.as_json())
    return 0


if __name__ == "__main__":
    sys.exit(main())
