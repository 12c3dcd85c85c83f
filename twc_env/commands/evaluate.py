"""`twc-env evaluate`: a trained policy in held-out buildings."""

from __future__ import annotations

import argparse
from pathlib import Path

from twc_env.agents.policy import LEARNED, is_model
from twc_env.commands.train import SEEDS
from twc_env.errors import DataError
from twc_env.records.json_values import TERMINAL, check_folder, write_json
from twc_env.records.text_tables import aligned_text
from twc_env.running.learning_libraries import learning_libraries
from twc_env.running.options import (
    add_allow_code,
    add_json,
    add_pictures,
    add_ray,
    count,
    parse_seeds,
    picture_options,
    refuse_ignored,
    refuse_jobs_with_ray,
)  # fmt: skip
from twc_env.running.terminal import aligned, tell, terminal_width
from twc_env.tasks import SUITES

SCRIPTED = ("nearest-frontier", "information-gain", "minpos")
"""Teams beside which models are evaluated: the reference, and those that lead tasks (docs/leaderboard.md)."""
MODEL = Path("runs/ppo")
SEEDS_OF_BUILDINGS, BUILDINGS = "0-19", 10
"""Defaults without a suite, and with one."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Fill the command's parser."""
    parser.description = (
        "Run one episode per held-out building with the trained policy, a random one, the nearest frontier "
        "and the scripted nearest-frontier team; print means with 95 % confidence intervals. With --suite: play models "
        "in the buildings of their tasks beside the teams of the benchmark, and print how much of the gap between the "
        "best scripted team and the informed one they close."
    )
    parser.epilog = (
        "examples:\n  twc-env evaluate --model runs/ppo --seeds 0-4 --films\n"
        "  twc-env evaluate --suite v1 --model runs/quick --buildings 20 --json runs/quick/test.json"
    )
    parser.add_argument(
        "--model",
        metavar="MODEL",
        nargs="+",
        type=Path,
        help="a run folder, or a model file next to its config.json; with --suite several, or learned for the shipped "
        f"policy (default: {MODEL})",
    )
    add_json(parser)
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="folder of evaluation.json, .csv, .tex and coverage.png, or with --suite of finished episodes (default: "
        "evaluation in the model's folder; runs/evaluation)",
    )
    add_pictures(parser)
    parser.add_argument("--no-pictures", action="store_true", help="do not draw coverage over time")
    parser.add_argument(
        "--seeds", help="of held-out buildings: numbers and ranges such as 0-4 or 1,5,7-9 (default: 0-19)"
    )
    parser.add_argument(
        "--films", action="store_true", help="write a film of the trained team in each building, to films in --out"
    )
    parser.add_argument("--jobs", type=count, default=1, help="worker processes")
    add_ray(parser)
    group = parser.add_argument_group("with --suite")
    group.add_argument("--suite", choices=SUITES, help="play the tasks of this suite")
    group.add_argument("--tasks", nargs="+", metavar="TASK", help="these (default: the one that each model learnt)")
    group.add_argument(
        "--agents",
        nargs="+",
        metavar="AGENT",
        help=f"scripted teams to beat (default: {', '.join(SCRIPTED)})",
    )
    group.add_argument("--split", choices=("train", "validation", "test"), help="buildings (default: test)")
    group.add_argument("--buildings", type=count, help="per task, from the start of the split (default: 10)")
    add_allow_code(parser)
    parser.set_defaults(run=_evaluate)


def _evaluate(options: argparse.Namespace) -> int:
    refuse_jobs_with_ray(options)
    _refuse_other(options)
    if options.films and (options.ray is not None or options.suite):
        other = "--ray: machines of a cluster would keep them" if options.ray is not None else "--suite draws none"
        raise DataError(f"--films with {other}; leave one of them out")
    if options.suite:
        return _evaluate_suite(options)
    with learning_libraries():
        from twc_env.suite.evaluation import evaluate

    seeds = parse_seeds(options.seeds or SEEDS_OF_BUILDINGS)
    if max(seeds) >= SEEDS:
        raise DataError(f"--seeds must be 0 to {SEEDS - 1}; got {max(seeds)}")
    model, *others = _models(options)
    if others:
        raise DataError(f"--model {others[0]}: several models need --suite v1; name one")
    if str(model) == LEARNED:
        raise DataError(f"--model {LEARNED}: a policy is shipped for a task of the suite; add --suite v1")
    check_folder(options.out)
    where = options.jobs, options.ray
    folder = options.out or (model if model.is_dir() else model.parent) / "evaluation"
    films = folder / "films" if options.films else None
    found = evaluate(model, seeds, not options.quiet, films, options.allow_code, where)
    if options.json != TERMINAL:
        print(aligned_text(found.rows(), terminal_width()))
    write_json(options.json, found.as_json())
    for path in [*found.write(folder, picture_options(options)), *([films] if films else [])]:
        tell(f"written: {path}")
    return 0


def _refuse_other(options: argparse.Namespace) -> None:
    """Raise DataError for an option that would be ignored: of a suite without one, or the other way round."""
    given: tuple[str, ...]
    if options.suite:
        given = ("seeds", "dpi", "no_pictures")
        why = f"--suite {options.suite} plays --buildings of its tasks and draws nothing"
    else:
        given, why = ("tasks", "agents", "split", "buildings"), "it needs --suite v1; without one, choose with --seeds"
    refuse_ignored(options, given, why)


def _evaluate_suite(options: argparse.Namespace) -> int:
    from twc_env.suite.entries import REFERENCES, Entry, entries, suite_tasks
    from twc_env.suite.gaps import rows_of_models
    from twc_env.suite.runs import play_all

    folder = options.out or Path("runs/evaluation")
    check_folder(folder)
    for agent in options.agents or ():
        if is_model(agent):
            raise DataError(f"--agents {agent}: it is a trained model, no scripted team; name it with --model")
    models = [str(path) for path in _models(options)]
    played: dict[str, list[str]] = {}
    for model in models:
        own = _tasks_of(model)
        if options.tasks is None and not own <= set(SUITES[options.suite]):
            raise DataError(f"{model} was not trained on a task of suite {options.suite}: name tasks with --tasks")
        for task in suite_tasks(options.suite, options.tasks or sorted(own)):
            played.setdefault(task, []).append(model)
    planned: list[Entry] = []
    for task, own_models in played.items():
        teams = dict.fromkeys((*own_models, *(options.agents or SCRIPTED), *REFERENCES))
        planned += entries([task], tuple(teams), options.split or "test", options.buildings or BUILDINGS)
    values = play_all(planned, folder / "episodes", options.jobs, options.ray, tell)
    rows = rows_of_models(models, planned, values)
    write_json(options.json, rows)
    if options.json != TERMINAL:
        shown = [{key: value for key, value in row.items() if key != "mean_coverage"} for row in rows]
        print(aligned(shown, terminal_width()))
        for task in played:
            areas: dict[str, float] = {}
            for row in (row for row in rows if row["task"] == task):
                areas |= {
                    row["model"] if team == "model" else team: area for team, area in row["mean_coverage"].items()
                }
            print(f"{task}: mean coverage: {', '.join(f'{team} {area:.3f}' for team, area in areas.items())}")
    return 0


def _models(options: argparse.Namespace) -> list[Path]:
    """Those that are named, or the default if it is there."""
    if options.model is None and not MODEL.exists():
        raise DataError(f"there is no {MODEL}: name the folder of your run, for example --model runs/quick")
    return options.model or [MODEL]


def _tasks_of(model: str) -> set[str]:
    """The tasks on which a model was trained; of `learned` those that a policy is shipped for."""
    with learning_libraries():
        from twc_env.training.run_folder import model_in, read_settings, task_of
        from twc_env.training.shipped import shipped

    if model == LEARNED:
        return {f"twc/{folder.name}" for folder in shipped()}
    return {task_of(read_settings(model_in(Path(model)).parent)).id or ""}
