"""The standard tasks: versioned ids, registered with Gymnasium and PettingZoo, and their settings.

A test pins the configuration digest of every id; a change of results needs a new version (CHANGELOG.md).

The tasks v1 are chosen so that teams differ (docs/leaderboard.md). Each has 500 buildings for training, 100 for
validation and 100 for testing: an episode is played in a building of the training split drawn by its seed, unless
`reset(options={"split": "test"})` or a map says otherwise.
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
    "twc/ExploreQuick-v1": {
        "map": "gen:office+ring+ward+mall+warehouse:300:train",
        "max_cycles": 600,
        "episode.ends_at_coverage": 0.99,
    },
    "twc/ExploreOffice-v1": {
        "map": "gen:office+ward+ring:2000:train",
        "robots": 4,
        "max_cycles": 3000,
        "lidar.range_max_m": 5.0,
        "episode.ends_at_coverage": 0.95,
    },
    "twc/ExploreEntrance-v1": {
        "map": "gen:office+ward+ring:2000:train",
        "robots": 4,
        "max_cycles": 2500,
        "lidar.range_max_m": 5.0,
        "episode.starts": "entrance",
        "episode.ends_at_coverage": 0.95,
    },
    "twc/ExplorePeers-v1": {
        "map": "gen:office+ward+ring:2000:train",
        "robots": 4,
        "max_cycles": 3500,
        "lidar.range_max_m": 5.0,
        "link.topology": "peer",
        "link.range_max_m": 10.0,
        "link.wall_range_m": 4.0,
        "episode.ends_at_coverage": 0.95,
    },
    "twc/ExploreMall-v1": {
        "map": "gen:mall:5000:train",
        "robots": 8,
        "max_cycles": 2000,
        "episode.ends_at_coverage": 0.99,
    },
    "twc/ExploreBare-v1": {
        "map": "gen:office+warehouse:1500:train",
        "robots": 4,
        "max_cycles": 2000,
        "lidar.range_max_m": 5.0,
        "building.sign_share": 0.0,
        "building.access_point_share": 0.3,
        "episode.ends_at_coverage": 0.98,
    },
    "twc/ExploreRadio-v1": {
        "map": "gen:office+ward+ring:800:train",
        "max_cycles": 2500,
        "lidar.range_max_m": 4.0,
        "slam.cues.lidar": False,
        "episode.ends_at_coverage": 0.9,
    },
    "twc/ExploreReturn-v1": {
        "map": "gen:office+ward+ring:2000:train",
        "robots": 4,
        "max_cycles": 2500,
        "lidar.range_max_m": 5.0,
        "slam.prior": "earlier-session:2500",
        "episode.ends_at_coverage": 0.95,
    },
    "twc/ExploreWard-v1": {
        "world": "ward",
        "map": "gen:ward:1000:train",
        "robots": 4,
        "max_cycles": 2500,
        "lidar.range_max_m": 5.0,
        "episode.ends_at_coverage": 0.95,
    },
    "twc/ExploreMixed-v1": {
        "world": "office",
        "team": "twc-slam",
        "map": "gen:office:800:train",
        "max_cycles": 2500,
        "episode.ends_at_coverage": 0.95,
    },
}
"""Id -> dotted settings that differ from the defaults. Of v0, the last three are oracles and an ablation."""
PURPOSES: dict[str, str] = {
    "twc/Explore-v0": "the defaults: three robots, map `twin-01`, velocity commands",
    "twc/ExploreTwin01-v0": "a corridor with four rooms that look alike (TWC-SLAM, scene #01)",
    "twc/ExploreTwin02-v0": "repeated exits along three walks (TWC-SLAM, scene #02)",
    "twc/ExploreOffice-v0": "a generated office of 800 m2",
    "twc/ExploreFrontier-v0": "an action selects a frontier; all robots decide at the same time: a start for learning",
    "twc/ExploreFrontierAsync-v0": "the same, but each robot decides as soon as it has arrived",
    "twc/ExploreHard-v0": "the office with most things gone wrong: legged robots with twice the drift, fewer and "
    "repeated signs, half of the access points, one mapper per robot, lossy short-range links",
    "twc/ExploreKnownStarts-v0": "oracle: relative start poses are known",
    "twc/ExploreTruePoses-v0": "oracle: true poses are known, as most exploration benchmarks assume",
    "twc/ExploreNoMerging-v0": "ablation: maps are never merged",
    "twc/ExploreQuick-v1": "nothing special: small and quick",
    "twc/ExploreOffice-v1": "finding each other in a large building with a short-sighted scanner",
    "twc/ExploreEntrance-v1": "spreading out: all robots start at one entrance and share a map at once",
    "twc/ExplorePeers-v1": "meeting, and passing maps on: no central mapper, short links that walls weaken",
    "twc/ExploreMall-v1": "eight robots and much floor",
    "twc/ExploreBare-v1": "no wrong merges: no signs, few access points",
    "twc/ExploreRadio-v1": "accuracy without scan matching: WiFi and signs; scans only for driving and drawing",
    "twc/ExploreReturn-v1": "coming back: a part of the building was mapped in an earlier session; find that map, and "
    "the rest of the building",
    "twc/ExploreWard-v1": "a crowd: people, doors and beds that move, and staff who lift robots out of their way",
    "twc/ExploreMixed-v1": "unlike robots, handheld, wheeled and legged, among people and doors that move",
}
"""Id -> what the task is for."""
SUITES: dict[str, tuple[str, ...]] = {"v1": tuple(task for task in TASKS if task.endswith("-v1"))}
"""The tasks that `twc-env benchmark --suite` plays together."""


def task_config(task: str) -> EnvConfig:
    """The complete configuration of a standard task. Raises ConfigError for an unknown id."""
    from twc_env.config import EnvConfig, override
    from twc_env.errors import ConfigError, one_of

    if not isinstance(task, str) or task not in TASKS:
        raise ConfigError(f"unknown task {task!r}{one_of(task, TASKS)}")
    return override(EnvConfig(), TASKS[task])
