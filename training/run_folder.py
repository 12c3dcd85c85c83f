"""The folder of one training run: task, settings, and how to recreate its environments."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import twc_env
from twc_env import TASKS, task_config
from twc_env import config as configuration
from twc_env.errors import ConfigError, DataError, TwcError, WorkerError, did_you_mean, one_of
from twc_env.records.json_values import plain, table_of, write_json
from twc_env.running.output_folder import alone_in

from .blindness import check_blind
from .checkpoint import FILE_NAME

HELD_OUT_SEED = 100_000
"""Generated buildings with this seed or a larger one are not used for training."""
CHOICES: dict[str, object] = {
    "action.kind": "frontier",
    "action.goals": "views",
    "action.timing": "in-turn",
    "action.decision_max_s": 0.5,
    "action.reverses": True,
}
"""Default actions in training, unless the task has choices of its own: each robot chooses a view anew twice a second,
and need not turn around to go there (docs/learning.md has what that is worth)."""
SMALL_VIEW: dict[str, object] = {
    "observation.lidar": False,
    "observation.map": False,
    "observation.overview": False,
    "observation.wifi": False,
    "observation.gains": True,
    "observation.frontier_period_s": 60.0,
}
"""Default observations in training: frontier candidates and what they would show, pose, team and recent signs. The
candidates of busy robots, which nobody uses, are rarely updated."""
SMALL_TEAM = {"robots": 2, "max_cycles": 500}
"""Of tasks without an id."""


@dataclass(frozen=True, slots=True)
class Task:
    """A training task: a registered one, or exploration of unseen small buildings by a team, or of one map."""

    id: str | None = None
    """A registered task, as in "twc/ExploreQuick-v1", in its training buildings; None: what follows."""
    map: str | None = None
    """A bundled map or map file for training and evaluation; None: generated buildings."""
    kinds: tuple[str, ...] = ("office", "ring", "ward")
    """Kinds of generated buildings, in turn."""
    area_m2: float = 250.0
    buildings: int = 300
    """Number of generated buildings for training."""
    robots: int | None = None
    """None: as the task says, else 2."""
    max_cycles: int | None = None
    """Time steps per episode; None: as the task says, else 500."""
    overrides: dict[str, object] = field(default_factory=dict)
    """Dotted settings of the environment, as in {"lidar.beam_count": 90}."""

    @property
    def config(self) -> configuration.EnvConfig:
        """The whole configuration of the environment."""
        fixed: dict[str, Any] = {"robots": self.robots, "max_cycles": self.max_cycles}
        if self.id is None:
            known = {name: value for name, value in SMALL_TEAM.items() if name != "robots" or not self._names_team}
            fixed = {name: known.get(name) if value is None else value for name, value in fixed.items()}
            fixed["map"] = self.map or self.names(0, 1)[0]
            base = configuration.EnvConfig()
            view: dict[str, object] = {**CHOICES, **SMALL_VIEW, "reward.period_steps": 20}
        else:
            base = task_config(self.id)
            view = SMALL_VIEW if base.action.kind == "frontier" else {**CHOICES, **SMALL_VIEW}
        given = {name: value for name, value in fixed.items() if value is not None}
        return configuration.override(base, {**view, **self.overrides, **given})

    @property
    def _names_team(self) -> bool:
        """Whether the overrides say of which robots the team consists."""
        return "team" in self.overrides or "robot" in self.overrides

    def names(self, first: int, count: int) -> list[str]:
        """Names of `count` generated buildings from seed `first` on, or of the one map."""
        if self.map is not None:
            return [self.map]
        return [f"gen:{self.kinds[k % len(self.kinds)]}:{self.area_m2:g}:{k}" for k in range(first, first + count)]

    @property
    def training_maps(self) -> Sequence[str]:
        """Maps for training; none if the environment draws them by itself."""
        return () if self.id is not None else self.names(0, self.buildings)

    def held_out(self, number: int, split: str = "test") -> dict[str, str]:
        """Options of `reset` for one of the buildings for evaluation, whose number is also the seed."""
        if self.id is None:
            return {"map": self.names(HELD_OUT_SEED + number, 1)[0]}
        name = task_config(self.id).map
        family, _, is_set = name.rpartition(":")
        return {"map": f"{family}:{split}/{number:04d}" if is_set == "train" else name}


def task_id(name: str) -> str:
    """The id of a task named with or without `twc/`. Raises ConfigError for an unknown one."""
    known = {short: each for each in TASKS for short in (each, each.partition("/")[2])}
    if name not in known:
        raise ConfigError(f"unknown task {name!r}{did_you_mean(name, known) or one_of(name, TASKS)}")
    return known[name]


def write_settings(folder: Path, algorithm: str, task: Task, settings: dict) -> None:
    """Write `config.json`: everything needed to repeat the run or to evaluate its model."""
    record = {
        "algorithm": algorithm,
        "task": asdict(task),
        "settings": settings,
        "environment": configuration.to_dict(task.config),
        "config_digest": configuration.digest(task.config),
        "version": twc_env.__version__,
    }
    write_json(folder / "config.json", record)


def read_settings(folder: Path) -> dict:
    """Read `config.json`; raises DataError when the folder holds no run or one of another version."""
    path = folder / "config.json"
    try:
        record = json.loads(path.read_text(), object_pairs_hook=table_of)
    except FileNotFoundError:
        raise DataError(
            f"{folder.resolve()} holds no training run (no config.json); train first or name its folder"
        ) from None
    except OSError as error:
        raise DataError(f"cannot read {path}: {error.strerror}; train first or name another folder") from error
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path} is not valid JSON: {error}") from error
    missing = {"task", "settings", "config_digest"} - set(record if isinstance(record, dict) else ())
    if missing:
        raise DataError(f"{path} lacks {', '.join(sorted(missing))}; name the folder of a training run")
    try:
        digest = configuration.digest(task_of(record).config)
    except TwcError:
        raise
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        raise DataError(f"{path} holds a task of another form: {error}; train anew") from error
    if digest != record["config_digest"]:
        raise DataError(
            f"{path} was written for config digest {record['config_digest']}, this version of twc_env gives {digest}; "
            f"use twc_env {record.get('version', 'of that time')} or train anew"
        )
    return record


def check_choices(task: Task) -> configuration.EnvConfig:
    """The configuration of a task. Raises DataError if the choice policies cannot play it."""
    config = task.config
    action, observation = config.action, config.observation
    if config.slam.mode == "off":
        raise DataError("this policy chooses between frontiers, and slam.mode=off has none: remove that setting")
    if (action.kind, observation.kind) != ("frontier", "dict"):
        raise DataError("this policy chooses between frontiers: keep action.kind=frontier and observation.kind=dict")
    if not (observation.pose and observation.team):
        raise DataError("robots share their goals: keep observation.pose=true and observation.team=true")
    return config


def check_run(folder: Path, algorithm: str, task: Task, settings: Any, resume: bool) -> None:
    """Raise DataError unless `folder` is free for a new run, or holds one of this task with these settings that can be
    resumed; ConfigError if they are blind for something unknown."""
    check_blind(settings.blind)
    has_model = (folder / FILE_NAME).exists()
    if not resume:
        if has_model:
            raise DataError(f"{folder} already holds a model; continue with --resume or name another folder with --out")
        return
    record = read_settings(folder)
    if not has_model:
        raise DataError(f"{folder} has no {FILE_NAME} to resume from; start without --resume")
    if record.get("algorithm") != algorithm:
        other = f"{record.get('algorithm')} instead of {algorithm}"
        raise DataError(f"{folder} was trained with {other}; use the same, or name another --out")
    told: Mapping[str, Any] = record["settings"]
    free = {name: told.get(name, getattr(settings, name)) for name in ("workers", "steps")}
    settings = replace(settings, **free)  # how many processes there are, and when training ends
    own: dict[str, Any] = plain({**asdict(task), **asdict(settings)})
    written = {**plain(asdict(type(settings)())), **record["task"], **told}  # earlier runs lack later settings
    said = {"id": "task", "area_m2": "area", "overrides": "set"}  # the names of the options
    changed = [
        f"{_option(said.get(k, k))} {written.get(k)} instead of {value}"
        for k, value in own.items()
        if written.get(k) != value
    ]
    if changed:
        raise DataError(f"{folder} was trained with {', '.join(changed)}; use the same settings, or name another --out")


@contextmanager
def open_run(folder: Path, algorithm: str, task: Task, settings: Any, resume: bool) -> Iterator[Path]:
    """The path of the model of a run, in whose folder nobody else writes meanwhile; a new run gets its `config.json`.

    Raises DataError if another process trains there, or if workers have died.
    """
    try:
        with alone_in(folder, patience_s=0.0):
            if not resume:
                write_settings(folder, algorithm, task, asdict(settings))
            yield folder / FILE_NAME
    except WorkerError as error:
        remedy = "--resume continues from the last saved model, if any"
        raise DataError(f"a worker process has died (out of memory or killed); {remedy}") from error


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def model_in(path: Path) -> Path:
    """The model of a run folder, or the given model file; what is not there and has no suffix is taken for a folder."""
    return path / FILE_NAME if path.is_dir() or not (path.suffix or path.exists()) else path


def task_of(record: dict) -> Task:
    """The task in the record of a run folder."""
    values = dict(record["task"])
    return Task(**{**values, "kinds": tuple(values["kinds"])})
