"""All settings, in sections for the simulated world, the SLAM engine and the environment.

A config is immutable. `from_dict` and `load` reject unknown keys and values of the wrong type or out of range; `digest`
identifies a config in logs and tables.
"""

from twc_env.config.clutter import ClutterConfig
from twc_env.config.environment import ActionConfig, EnvConfig, EpisodeConfig, ObservationConfig, RewardConfig
from twc_env.config.lidar_presets import LIDAR_PRESETS
from twc_env.config.mixed_teams import has_one_scanner, robot_configs, shared_config, start_times_s
from twc_env.config.people import PEOPLE_MAX, PeopleConfig
from twc_env.config.radio_presets import RADIO_PRESETS
from twc_env.config.robot_presets import ROBOT_PRESETS, TEAM_PRESETS
from twc_env.config.robots import ROBOT_SETTINGS
from twc_env.config.slam import (
    CuesConfig,
    KeyframeConfig,
    KVisibilityConfig,
    LocalMapConfig,
    MergingConfig,
    OdometryFilterConfig,
    PlaceRecognitionConfig,
    PoseGraphConfig,
    RadioSlamConfig,
    SlamConfig,
    VerificationConfig,
)
from twc_env.config.values import (
    code_named_in,
    digest,
    from_dict,
    lidar_preset,
    load,
    override,
    radio_preset,
    to_dict,
    world_of,
    world_preset,
)
from twc_env.config.world import (
    ROBOTS_MAX,
    BuildingConfig,
    CellConfig,
    DynamicsConfig,
    FailureConfig,
    HighBandConfig,
    LidarConfig,
    LinkConfig,
    OdometryConfig,
    RadioConfig,
    SignsConfig,
)
from twc_env.config.world_presets import WORLD_PRESETS

__all__ = [
    "LIDAR_PRESETS",
    "PEOPLE_MAX",
    "RADIO_PRESETS",
    "ROBOTS_MAX",
    "ROBOT_PRESETS",
    "ROBOT_SETTINGS",
    "TEAM_PRESETS",
    "WORLD_PRESETS",
    "ActionConfig",
    "BuildingConfig",
    "CellConfig",
    "ClutterConfig",
    "CuesConfig",
    "DynamicsConfig",
    "EnvConfig",
    "EpisodeConfig",
    "FailureConfig",
    "HighBandConfig",
    "KVisibilityConfig",
    "KeyframeConfig",
    "LidarConfig",
    "LinkConfig",
    "LocalMapConfig",
    "MergingConfig",
    "ObservationConfig",
    "OdometryConfig",
    "OdometryFilterConfig",
    "PeopleConfig",
    "PlaceRecognitionConfig",
    "PoseGraphConfig",
    "RadioConfig",
    "RadioSlamConfig",
    "RewardConfig",
    "SignsConfig",
    "SlamConfig",
    "VerificationConfig",
    "code_named_in",
    "digest",
    "from_dict",
    "has_one_scanner",
    "lidar_preset",
    "load",
    "override",
    "radio_preset",
    "robot_configs",
    "shared_config",
    "start_times_s",
    "to_dict",
    "world_of",
    "world_preset",
]
