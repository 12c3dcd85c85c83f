"""The folder of one training run: what was asked for, what came out, and how to make its environment again."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

import gymnasium

import twc_env
from twc_env import config as configuration
from twc_env.errors import DataError

ENVIRONMENT_ID = "twc/Explore-v0"


@dataclass(frozen=True, slots=True)
class Task:
    """What is learnt: one robot's exploration of one map."""

    map: str = "twin-01"
    """Bundled map or map file."""
    max_cycles: int = 1000
    """Steps per episode."""
    overrides: dict[str, object] = field(default_factory=dict)
    """Dotted settings of the environment, as in {"lidar.beam_count": 90}."""

    @property
    def config(self) -> configuration.EnvConfig:
        """The whole configuration of the environment."""
        fixed = {"map": self.map, "robots": 1, "max_cycles": self.max_cycles}
        return configuration.override(configuration.EnvConfig(), {**self.overrides, **fixed})

    def make(self) -> gymnasium.Env:
        """The single-agent view of the environment."""
        return gymnasium.make(ENVIRONMENT_ID, config=configuration.to_dict(self.config))


def write_settings(folder: Path, algorithm: str, task: Task, settings: dict) -> None:
    """Write `config.json`: everything needed to repeat the run or to evaluate its model."""
    folder.mkdir(parents=True, exist_ok=True)
    record = {
        "algorithm": algorithm,
        "task": asdict(task),
        "settings": settings,
        "environment": configuration.to_dict(task.config),
        "config_digest": configuration.digest(task.config),
        "version": twc_env.__version__,
    }
    (folder / "config.json").write_text(json.dumps(record, indent=2) + "\n")


def read_settings(folder: Path) -> dict:
    """Read `config.json`; raises DataError when the folder holds no run or one of another version."""
    path = folder / "config.json"
    try:
        record = json.loads(path.read_text())
    except FileNotFoundError:
        raise DataError(f"{folder} holds no training run (no config.json); train first or name its folder") from None
    except ValueError as error:
        raise DataError(f"{path} is not valid JSON: {error}") from error
    missing = {"task", "settings", "config_digest"} - set(record)
    if missing:
        raise DataError(f"{path} lacks {', '.join(sorted(missing))}; it was not written by this program")
    digest = configuration.digest(Task(**record["task"]).config)
    if digest != record["config_digest"]:
        raise DataError(
            f"{path} was written for config digest {record['config_digest']}, this version of twc_env gives {digest}; "
            f"use twc_env {record.get('version', 'of that time')} or train anew"
        )
    return record
