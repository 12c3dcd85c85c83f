"""`twc-env train`: learning."""

from __future__ import annotations

import argparse
import ast
import sys
from dataclasses import fields, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from twc_env.errors import DataError
from twc_env.records.json_values import check_folder
from twc_env.running.argument_parser import add_verbosity
from twc_env.running.learning_libraries import learning_libraries
from twc_env.running.options import add_folder, add_ray, add_set, assignments, count, natural, number

MODULES = {"mappo": "mappo", "es": "evolution", "ppo": "ppo"}
"""Algorithm -> its module in `twc_env.training`."""
BLIND = "teammates", "signs", "map"
"""`HIDES` of twc_env.training.blindness."""
SEEDS = 2**31
"""Seeds are below this: torch and numpy accept no larger ones, and resuming adds the number of steps."""
FIRST_HOUR = """\
The first hour:
  pip install 'twc_env[train,viz]'
  twc-env train mappo --task ExploreQuick-v1 --steps 30000 --out runs/quick    # ten minutes on two cores
  tensorboard --logdir runs/quick/tensorboard      # meanwhile: return, coverage, wrong merges, ATE, reward terms
  open runs/quick/curve.png                        # then: the curve, with lines for three scripted teams
  twc-env evaluate --suite v1 --model runs/quick --buildings 10 --json runs/quick/test.json    # on test buildings
  twc-env train mappo --out runs/quick --resume    # after an interruption, with the settings of the run
  twc-env train mappo --task ExploreQuick-v1 --ray auto --out runs/far    # on all machines of a Ray cluster
docs/learning.md has the rest.
"""


OF_OPTIONS = ("map", "robots", "max_cycles")
"""Settings that are options of their own."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Fill the parser of the command, which has one command per algorithm."""
    parser.description = (
        "Train an exploration policy shared by all robots of a team. Each algorithm has its own --help."
    )
    parser.epilog = FIRST_HOUR
    algorithms = parser.add_subparsers(required=True, metavar="ALGORITHM")
    _add_algorithm(
        algorithms, "mappo", 60_000, "train with multi-agent PPO (torch)",
        "Decisions of different length are discounted by their time, and a centralised critic sees the true state, in "
        "training only. A run that was killed at any moment continues with --resume as if nothing had happened.",
    )  # fmt: skip
    _add_algorithm(
        algorithms, "es", 500_000, "train with an evolution strategy (torch)",
        "Varies the weights of the rule that all policies start from, each change and its opposite for a whole episode "
        "in the same building. A run that was killed continues with --resume as if nothing had happened.",
    )  # fmt: skip
    _add_algorithm(
        algorithms, "ppo", 181_000, "train with the standard PPO of stable-baselines3",
        "A busy robot counts as one that decides to continue.",
    )  # fmt: skip


def _add_algorithm(algorithms: Any, name: str, steps: int, summary: str, more: str) -> None:
    parser = algorithms.add_parser(
        name,
        help=summary,
        description=f"{summary.capitalize()}: one shared policy, for a registered task, small generated buildings or "
        f"one map. {more} Writes config.json, model.safetensors, metrics.csv, tensorboard/ and curve.png to the run "
        "folder; the model is saved after each update. A new run needs a new folder.",
        epilog=f"examples:\n  twc-env train {name} --task ExploreQuick-v1 --out runs/quick\n"
        f"  twc-env train {name} --out runs/quick --resume\n"
        f"  twc-env train {name} --map twin-01 --robots 3 --set odometry.drift=2 --out runs/twin",
    )
    task = parser.add_argument_group("task")
    task.add_argument("--task", help="a registered task, such as ExploreQuick-v1, in its training buildings")
    task.add_argument("--map", help="bundled name, generated name or file, instead of small generated buildings")
    task.add_argument("--area", type=float, help="floor area of the generated buildings [m2] (default: 250)")
    task.add_argument("--robots", type=count, help="robots per team (default: as the task says, else 2)")
    task.add_argument("--max-cycles", type=count, help="time steps per episode (default: as the task says, else 500)")
    add_set(task)
    parser.add_argument(
        "--steps",
        type=count,
        help=f"total decisions of all robots, rounded up (default: {steps}; with --resume as before)",
    )
    parser.add_argument(
        "--workers",
        type=natural,
        help="worker processes (default: 2, with --ray one per core of the cluster; 0: none, run in this process)",
    )
    add_ray(parser, "; the result is the same, also if workers or machines are lost")
    parser.add_argument("--seed", type=natural, help="of network, buildings and episodes (default: 0)")
    module = f"twc_env.training.{MODULES[name]}"
    tuned = parser.add_argument_group("hyperparameters", f"reasons of the defaults: {module}.Settings")
    most = 10.0 if name == "es" else 1.0
    tuned.add_argument("--learning-rate", type=number(0.0, most), metavar="RATE", help="initial step size")
    tuned.add_argument("--environments", type=count, help="teams that play at once")
    if name != "es":
        _add_gradients(tuned, name)
    defaults = _defaults(module)
    for option in tuned._group_actions:
        option.help = f"{option.help} (default: {defaults[option.dest]})"
    _add_knowledge(parser, name)
    parser.add_argument(
        "--references",
        type=natural,
        default=4,
        metavar="BUILDINGS",
        help="validation buildings in which scripted teams are played for curve.png (default: %(default)s; 0: none)",
    )
    add_folder(parser, "--out", f"runs/{name}", "run folder")
    parser.add_argument(
        "--resume",
        action="store_true",
        help="continue from the model in the run folder, with its task and settings; --steps may be more than before",
    )
    add_verbosity(parser)
    parser.set_defaults(
        run=_train,
        algorithm=name,
        default_steps=steps,
        when_interrupted="interrupted; --resume continues from the last saved model, if any",
    )


def _check_task(options: argparse.Namespace, overrides: dict[str, object]) -> None:
    """Raise DataError for options of the task of which one would be ignored beside another."""
    if options.task is not None and options.map is not None:
        raise DataError(f"--map {options.map}: the task {options.task} has its own buildings; leave one of them out")
    if options.area is not None and (options.task or options.map):
        raise DataError(f"--area {options.area:g}: it is of generated buildings; leave out --task and --map, or this")
    for name in OF_OPTIONS:
        if name in overrides:
            raise DataError(f"--set {name}={overrides[name]}: use --{name.replace('_', '-')}, which evaluations follow")


def _defaults(module: str) -> dict[str, str]:
    """The defaults of a learner's `Settings` as its file writes them: importing it would take torch to show a help."""
    spec = find_spec(module)
    assert spec is not None and spec.origin is not None
    tree = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
    (settings,) = (node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == "Settings")
    fields = [node for node in settings.body if isinstance(node, ast.AnnAssign) and node.value is not None]
    return {ast.unparse(field.target): ast.unparse(field.value) for field in fields if field.value is not None}


def _add_gradients(tuned: Any, name: str) -> None:
    """Hyperparameters of learners that follow gradients of a network."""
    tuned.add_argument("--clip", type=number(0.0, 10.0), help="clip range of the probability ratio")
    unit = "second" if name == "mappo" else "decision"
    tuned.add_argument("--discount", type=number(0.0, 1.0), metavar="GAMMA", help=f"of what comes later, per {unit}")
    tuned.add_argument("--gae-lambda", type=number(0.0, 1.0), metavar="LAMBDA", help="of the advantages, per decision")
    tuned.add_argument("--entropy-weight", type=number(-10.0, 10.0), metavar="WEIGHT", help="bonus for entropy")
    tuned.add_argument("--epochs", type=count, help="passes over each rollout")
    tuned.add_argument("--rollout-steps", type=count, metavar="STEPS", help="of each environment between two updates")
    tuned.add_argument("--hidden-size", type=count, metavar="WIDTH", help="of the networks, a multiple of 4")
    if name == "mappo":
        tuned.add_argument("--minibatches", type=count, help="gradient steps per pass")
    else:
        tuned.add_argument("--batch-size", type=count, help="samples per gradient step")


def _add_knowledge(parser: argparse.ArgumentParser, name: str) -> None:
    """What can be kept from a learner."""
    told = "what is kept from it to measure what it is worth, as reproduce ablation does; by default nothing"
    kept = parser.add_argument_group("knowledge", told)
    shown = ", ".join(BLIND)
    kept.add_argument("--blind", nargs="+", choices=BLIND, metavar="NAME", help=f"from the policy: any of {shown}")
    switches = {
        "attention": "candidates, teammates and signs attend to each other, or each is encoded by itself",
        "privileged-critic": "the critic sees the truth, or what the robot sees",
        "from-rule": "start from the rule for one robot, or from choices that are all alike",
    }
    for switch in {"mappo": [*switches], "ppo": ["from-rule"]}.get(name, []):
        kept.add_argument(f"--{switch}", action=argparse.BooleanOptionalAction, help=switches[switch])


def _train(options: argparse.Namespace) -> int:
    with learning_libraries():
        from twc_env.training.run_folder import Task, read_settings, task_id, task_of

        algorithm = import_module(f"twc_env.training.{MODULES[options.algorithm]}")

    if (options.seed or 0) >= SEEDS:
        raise DataError(f"--seed must be 0 to {SEEDS - 1}; got {options.seed}")
    if getattr(options, "hidden_size", None) is not None and options.hidden_size % 4:
        raise DataError(f"--hidden-size must be a multiple of the 4 heads of the attention; got {options.hidden_size}")
    overrides = assignments(options.set)
    _check_task(options, overrides)
    check_folder(options.out)
    is_begun = options.resume and (options.out / "config.json").is_file()
    record = read_settings(options.out) if is_begun else {}
    named = {
        "id": None if options.task is None else task_id(options.task),
        "map": options.map,
        "area_m2": options.area,
        "robots": options.robots,
        "max_cycles": options.max_cycles,
        "overrides": overrides or None,
    }
    task = replace(
        task_of(record) if record else Task(), **{name: value for name, value in named.items() if value is not None}
    )
    before = record.get("settings", {"steps": options.default_steps})
    given = {field.name: getattr(options, field.name, None) for field in fields(algorithm.Settings)}
    asked = {name: before.get(name) if value is None else value for name, value in given.items()}
    asked["blind"] = tuple(asked["blind"] or ())
    settings = algorithm.Settings(**{name: value for name, value in asked.items() if value is not None})
    if options.workers is None:
        settings = replace(settings, workers=0 if options.ray else min(settings.workers, settings.environments))
    model_path = algorithm.train(task, settings, options.out, options.resume, not options.quiet, options.ray)
    print(f"model: {model_path}   learning curve: {options.out / 'metrics.csv'} and {options.out / 'tensorboard'}")
    if options.references:
        from twc_env.suite.curve_picture import draw_curve
        from twc_env.suite.references import references

        means = references(task, options.out, options.references, ray=options.ray)
        title = f"{options.algorithm}, {task.id or task.map or 'small generated buildings'}"
        if path := draw_curve(options.out, means, title):
            print(f"picture: {path}")
        else:
            lacks = "an episode that has ended" if find_spec("matplotlib") else "pip install 'twc_env[viz]'"
            print(f"no picture of the learning curve: it needs {lacks}", file=sys.stderr)
    return 0
