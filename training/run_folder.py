"""The folder of one training run: task, settings, and how to recreate its environments."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

import twc_env
from twc_env import config as configuration
from twc_env.errors import DataError, TwcError
from twc_env.records.json_values import write_json

HELD_OUT_SEED = 100_000
"""Generated buildings with this seed or a larger one are not used for training."""
SMALL_VIEW = {
    "action.kind": "frontier",
    "action.timing": "asynchronous",
    "observation.lidar": False,
    "observation.map": False,
    "observation.overview": False,
    "observation.wifi": False,
    "reward.period_steps": 20,
}
"""Default actions and observations in training: frontier candidates, pose, team and recent signs."""


@dataclass(frozen=True, slots=True)
class Task:
    """A training task: exploration of unseen small buildings by a team, or of one map."""

    map: str | None = None
    """A bundled map or map file for training and evaluation; None: generated buildings."""
    kinds: tuple[str, ...] = ("office", "ring", "ward")
    """Kinds of generated buildings, in turn."""
    area_m2: float = 250.0
    buildings: int = 300
    """Number of generated buildings for training."""
    robots: int = 2
    max_cycles: int = 500
    """Time steps per episode."""
    overrides: dict[str, object] = field(default_factory=dict)
    """Dotted settings of the environment, as in {"lidar.beam_count": 90}."""

    @property
    def config(self) -> configuration.EnvConfig:
        """The whole configuration of the environment."""
        fixed = {"map": self.map or self.names(0, 1)[0], "robots": self.robots, "max_cycles": self.max_cycles}
        return configuration.override(configuration.EnvConfig(), {**SMALL_VIEW, **self.overrides, **fixed})

    def names(self, first: int, count: int) -> list[str]:
        """Names of `count` generated buildings from seed `first` on, or of the one map."""
        if self.map is not None:
            return [self.map]
        return [f"gen:{self.kinds[k % len(self.kinds)]}:{self.area_m2:g}:{k}" for k in range(first, first + count)]

    @property
    def training_maps(self) -> list[str]:
        """Maps for training."""
        return self.names(0, self.buildings)

    def held_out_map(self, number: int) -> str:
        """One of the maps for evaluation."""
        return self.names(HELD_OUT_SEED + number, 1)[0]


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
        record = json.loads(path.read_text())
    except FileNotFoundError:
        raise DataError(
            f"{folder.resolve()} holds no training run (no config.json); train first or name its folder"
        ) from None
    except OSError as error:
        raise DataError(f"cannot read {path}: {error.strerror}; train first or name another folder") from error
    except ValueError as error:
        raise DataError(f"{path} is not valid JSON: {error}") from error
    missing = {"task", "settings", "config_digest"} - set(record if isinstance(record, dict) else ())
    if missing:
        raise DataError(f"{path} lacks {', '.join(sorted(missing))}; it was not written by this program")
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


def model_in(path: Path) -> Path:
    """The model of a run folder, or the given model file."""
    return path / "model.zip" if path.is_dir() else path


def task_of(record: dict) -> Task:
    """The task in the record of a run folder."""
    values = dict(record["task"])
    return Task(**{**values, "kinds": tuple(values["kinds"])})
