"""Puts the scripted teams, the learners and the maps into the wheel; an editable install finds them in the clone."""

from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

FOLDERS = ("agents", "training", "maps")


class WheelHook(BuildHookInterface):
    """Copies in an editable wheel would hide the package, so it gets none."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the folders to an ordinary wheel."""
        if version != "editable":
            build_data["force_include"].update({name: f"twc_env/{name}" for name in FOLDERS})
