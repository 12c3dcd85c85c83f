"""`twc-env evaluate`: a trained policy in held-out buildings."""

from __future__ import annotations

import argparse
from pathlib import Path

from twc_env.commands.train import SEEDS, learning_libraries
from twc_env.errors import DataError
from twc_env.records.json_values import write_json
from twc_env.running.command_line import add_allow_code, parse_seeds


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Fill the command's parser."""
    parser.description = (
        "Run one episode per held-out building with the trained policy, a random one, the nearest frontier "
        "and the scripted nearest-frontier team; print means with 95 % confidence intervals."
    )
    parser.epilog = "example:\n  twc-env evaluate --model runs/ppo/model.zip --seeds 0-4 --films runs/ppo/films"
    parser.add_argument(
        "--model",
        metavar="MODEL",
        type=Path,
        default=Path("runs/ppo/model.zip"),
        help="a run folder, or a model file next to its config.json",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all episodes and the means")
    parser.add_argument("--seeds", default="0-19", help="seeds of held-out buildings, e.g. 0-4 or 1,5,7")
    parser.add_argument("--films", type=Path, metavar="FOLDER", help="write a GIF of the trained team in each building")
    add_allow_code(parser)
    parser.set_defaults(run=_evaluate)


def _evaluate(options: argparse.Namespace) -> int:
    with learning_libraries():
        from twc_env.training.evaluate import evaluate

    seeds = parse_seeds(options.seeds)
    if max(seeds) >= SEEDS:
        raise DataError(f"--seeds must be 0 to {SEEDS - 1}; got {max(seeds)}")
    found = evaluate(options.model, seeds, films=options.films, allow_code=options.allow_code)
    print(found.table)
    write_json(options.json, found.as_json())
    return 0
