"""The standard tasks: versioned ids, registered with Gymnasium and PettingZoo, and their settings.

A test pins the configuration digest of every id; a change of results needs a new version (CHANGELOG.md).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twc_env.config import EnvConfig

TASKS: dict[str, dict[str, Any]] = {
    "twc/Explore-v0": {},
    "twc/ExploreTwin01-v0": {"map": "twin-01"},
    "twc/ExploreTwin02-v0": {"map": "twin-02"},
    "twc/ExploreOffice-v0": {"map": "gen:office:800:7", "max_cycles": 3000},
    "twc/ExploreFrontier-v0": {"action.kind": "frontier"},
    "twc/ExploreFrontierAsync-v0": {"action.kind": "frontier", "action.timing": "asynchronous"},
    "twc/ExploreHard-v0": {
        "map": "gen:office:800:7",
        "robots": 4,
        "max_cycles": 4000,
        "odometry.platform": "legged",
        "odometry.drift": 2.0,
        "building.sign_share": 0.6,
        "building.sign_duplication": 0.5,
        "building.access_point_share": 0.5,
        "link.topology": "peer",
        "link.range_max_m": 12.0,
        "link.loss_probability": 0.1,
    },
    "twc/ExploreKnownStarts-v0": {"slam.oracle": "starts"},
    "twc/ExploreTruePoses-v0": {"slam.oracle": "poses"},
    "twc/ExploreNoMerging-v0": {"slam.merging.enabled": False},
}
"""Id -> dotted settings that differ from the defaults. The last three are oracles and an ablation."""


def task_config(task: str) -> EnvConfig:
    """The complete configuration of a standard task. Raises ConfigError for an unknown id."""
    from twc_env.config import EnvConfig, override
    from twc_env.errors import ConfigError, did_you_mean

    if not isinstance(task, str) or task not in TASKS:
        near = did_you_mean(str(task), TASKS)
        raise ConfigError(f"unknown task {task!r}; known are {', '.join(TASKS)}{near}")
    return override(EnvConfig(), TASKS[task])
