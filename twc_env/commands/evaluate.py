"""`twc-env evaluate`: a trained policy in held-out buildings."""

from __future__ import annotations

import argparse
from pathlib import Path

from twc_env.commands.train import SEEDS, learning_libraries
from twc_env.errors import DataError
from twc_env.records.json_values import TERMINAL, check_folder, write_json
from twc_env.records.text_tables import aligned_text
from twc_env.running.command_line import (
    add_allow_code,
    add_json,
    add_pictures,
    parse_seeds,
    picture_options,
    tell,
    terminal_width,
)


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
    add_json(parser)
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="folder of evaluation.json, .csv, .tex and coverage.png (default: evaluation in the model's folder)",
    )
    add_pictures(parser)
    parser.add_argument("--no-pictures", action="store_true", help="do not draw coverage over time")
    parser.add_argument(
        "--seeds", default="0-19", help="of held-out buildings: numbers and ranges such as 0-4 or 1,5,7-9"
    )
    parser.add_argument(
        "--films", type=Path, metavar="FOLDER", help="write a film of the trained team in each building"
    )
    add_allow_code(parser)
    parser.set_defaults(run=_evaluate)


def _evaluate(options: argparse.Namespace) -> int:
    with learning_libraries():
        from twc_env.training.evaluate import evaluate

    seeds = parse_seeds(options.seeds)
    if max(seeds) >= SEEDS:
        raise DataError(f"--seeds must be 0 to {SEEDS - 1}; got {max(seeds)}")
    check_folder(options.out)
    found = evaluate(
        options.model, seeds, show_progress=not options.quiet, films=options.films, allow_code=options.allow_code
    )
    if options.json != TERMINAL:
        print(aligned_text(found.rows(), terminal_width()))
    write_json(options.json, found.as_json())
    folder = options.out or (options.model if options.model.is_dir() else options.model.parent) / "evaluation"
    for path in found.write(folder, picture_options(options)):
        tell(f"written: {path}")
    return 0
