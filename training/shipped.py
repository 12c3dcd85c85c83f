"""The policies that come with the package: per task a folder with the weights of the actor, its settings and a card."""

from __future__ import annotations

import shutil
from pathlib import Path

from twc_env import task_config
from twc_env.config import EnvConfig, digest
from twc_env.errors import DataError

from .checkpoint import FILE_NAME, load, save

LEARNED = "learned"
"""Name of the team that plays the shipped policy that suits a task best."""
FOLDER = Path(__file__).with_name("shipped_policies")


def shipped() -> list[Path]:
    """The folders of all policies that come with this version."""
    return [path.parent for path in sorted(FOLDER.glob(f"*/{FILE_NAME}"))]


def shipped_for(config: EnvConfig) -> Path:
    """The folder of the policy that suits settings best: trained on this task; else for robots that pass maps on in the
    same way; else in buildings of this set; else with most nearly this number of robots.

    Raises DataError if no policy comes with this version.
    """
    folders = shipped()
    if not folders:
        raise DataError("no policy comes with this version: train one with twc-env train mappo")

    def likeness(folder: Path) -> tuple[bool, bool, bool, int]:
        of = task_config(f"twc/{folder.name}")
        family = of.map.rpartition(":")[0]
        is_of_set = config.map == of.map or (bool(family) and config.map.startswith(f"{family}:"))
        is_linked_alike = of.link.topology == config.link.topology
        return digest(of) == digest(config), is_linked_alike, is_of_set, -abs(of.robots - config.robots)

    return max(folders, key=likeness)


def ship(run: Path, folder: Path) -> None:
    """Copy what playing needs of a run folder: settings, and the actor's weights without moments and episodes."""
    arrays, values = load(run / FILE_NAME)
    folder.mkdir(parents=True, exist_ok=True)
    own = {name: array for name, array in arrays.items() if name.startswith("actor.")}
    save(folder / FILE_NAME, own, {"decisions": values["decisions"]})
    shutil.copyfile(run / "config.json", folder / "config.json")
