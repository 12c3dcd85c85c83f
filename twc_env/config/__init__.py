"""Every number the environment can be configured with: sections for the world, the engine and the environment.

A config is a frozen value: build it once, hand each module its section, never edit it. `from_dict` and `load` refuse
keys they do not know and values of the wrong type or out of range; `digest` names the values in logs and tables.
"""

from twc_env.config.environment import ActionConfig, EnvConfig, ObservationConfig, RewardConfig
from twc_env.config.radio_presets import RADIO_PRESETS
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
from twc_env.config.values import digest, from_dict, load, override, radio_preset, to_dict
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

__all__ = [
    "RADIO_PRESETS",
    "ROBOTS_MAX",
    "ActionConfig",
    "BuildingConfig",
    "CellConfig",
    "CuesConfig",
    "DynamicsConfig",
    "EnvConfig",
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
    "PlaceRecognitionConfig",
    "PoseGraphConfig",
    "RadioConfig",
    "RadioSlamConfig",
    "RewardConfig",
    "SignsConfig",
    "SlamConfig",
    "VerificationConfig",
    "digest",
    "from_dict",
    "load",
    "override",
    "radio_preset",
    "to_dict",
]
