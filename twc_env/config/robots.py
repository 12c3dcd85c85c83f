"""Mixed teams: settings of single robots that differ from those of the team, in a short and in a full form."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
from operator import attrgetter
from typing import Any

from twc_env.config.checks import KINDS, is_too_great, plain_value
from twc_env.config.lidar_presets import LIDAR_PRESETS
from twc_env.config.robot_presets import ROBOT_PRESETS, TEAM_PRESETS
from twc_env.config.slam import OdometryFilterConfig
from twc_env.config.world import (
    DynamicsConfig,
    FailureConfig,
    LidarConfig,
    OdometryConfig,
    RadioConfig,
    SignsConfig,
)
from twc_env.errors import UNFIT, ConfigError, did_you_mean

Overrides = tuple[tuple[str, Any], ...]
"""Dotted settings of one robot and their values, by name."""
_NAMES: dict[str, tuple[type, tuple[str, ...]]] = {
    "dynamics": (
        DynamicsConfig,
        (
            "speed_max_m_s", "turn_rate_max_rad_s", "acceleration_max_m_s2", "turn_acceleration_max_rad_s2",
            "robot_radius_m",
        ),
    ),
    "odometry": (OdometryConfig, ("platform", "drift", "bumps_per_m", "threshold_slip_m")),
    "lidar": (LidarConfig, tuple(field.name for field in dataclasses.fields(LidarConfig))),
    "radio": (
        RadioConfig,
        (
            "scan_period_s", "device_offset_db", "device_offset_std_db", "device_sensitivity_std_db", "noise_std_db",
            "quantisation_db",
        ),
    ),
    "signs": (
        SignsConfig,
        (
            "period_s", "range_max_m", "field_of_view_rad", "incidence_max_rad", "focal_length_px", "height_min_px",
            "exposure_s", "bearing_noise_std_rad", "range_noise_std_m", "fragment_probability",
            "character_error_probability",
        ),
    ),
    "failure": (FailureConfig, ("start_s",)),
    "slam.odometry_filter": (
        OdometryFilterConfig,
        (
            "position_std_per_m", "position_std_m", "turn_std_rad", "odometry_turn_std_rad", "odometry_scale_std",
            "gyro_bias_std_rad_s", "gyro_bias_walk_rad_s",
        ),
    ),
}  # fmt: skip
"""Sections with settings that may differ between robots, and their names."""
ROBOT_SETTINGS = tuple(f"{section}.{name}" for section, (_, names) in _NAMES.items() for name in names)
"""All settings that may differ between the robots of a team."""


def overrides_of(robots: Any) -> tuple[Overrides, ...]:
    """The setting `robot` in full: presets replaced by what they set, names dotted and sorted.

    robots: a list with the name of a preset, or a table of settings, for each robot; or text, "handheld, wheeled" or
    JSON. Raises ConfigError for anything else.
    """
    if isinstance(robots, str):
        robots = _read(robots)
    if isinstance(robots, Mapping) or not isinstance(robots, Sequence):
        raise ConfigError(f"robot must be a list with a preset or a table of settings for each robot; got {robots!r}")
    return tuple(_overrides(f"robot[{number}]", robot) for number, robot in enumerate(robots))


def team_of(team: Any) -> tuple[Overrides, ...]:
    """The robots of a bundled team, or of a list of presets. Raises ConfigError for unknown names."""
    if isinstance(team, str) and team in TEAM_PRESETS:
        team = list(TEAM_PRESETS[team])
    names = _read(team) if isinstance(team, str) else team
    if not isinstance(names, Sequence) or not names:
        raise ConfigError(
            f"team must be {', '.join(TEAM_PRESETS)}, or robots such as 'handheld, wheeled', of "
            f"{', '.join(ROBOT_PRESETS)}; got {team!r}"
        )
    if isinstance(team, str) and len(names) == 1 and names[0] not in ROBOT_PRESETS:
        known = [*TEAM_PRESETS, *ROBOT_PRESETS]
        raise ConfigError(
            f"team must be {', '.join(TEAM_PRESETS)}, or robots such as 'handheld, wheeled', of "
            f"{', '.join(ROBOT_PRESETS)}; got {team!r}{did_you_mean(team, known)}"
        )
    return overrides_of(names)


def _read(text: str) -> Any:
    if not text.lstrip().startswith("["):
        return [name.strip() for name in text.split(",")] if text.strip() else []
    try:
        return json.loads(text)
    except UNFIT as error:
        raise ConfigError(f"robot is no list in JSON: {error}; got {text!r}") from error


def _overrides(where: str, robot: Any) -> Overrides:
    """The overrides of one robot."""
    if isinstance(robot, str):
        robot = {"preset": robot}
    try:
        given = dict(_flat(dict(robot)))
    except UNFIT:
        raise ConfigError(
            f"{where} must be the name of a preset or a table of settings; got {robot!r}: name one of "
            f"{', '.join(ROBOT_PRESETS)}"
        ) from None
    preset = given.pop("preset", None)
    if preset is not None:
        if not isinstance(preset, str) or preset not in ROBOT_PRESETS:
            raise ConfigError(
                f"{where}.preset must be one of {', '.join(ROBOT_PRESETS)}; got {preset!r}"
                f"{did_you_mean(str(preset), ROBOT_PRESETS)}"
            )
        own = dict(_overrides(where, ROBOT_PRESETS[preset]))
        if "lidar.preset" in given:  # leaves nothing of the scanner that the preset has
            own = {key: value for key, value in own.items() if not key.startswith("lidar.")}
        given = own | given
    scanner = given.pop("lidar.preset", None)
    if scanner is not None:
        if not isinstance(scanner, str) or scanner not in LIDAR_PRESETS:
            raise ConfigError(
                f"{where}.lidar.preset must be one of {', '.join(LIDAR_PRESETS)}; got {scanner!r}"
                f"{did_you_mean(str(scanner), LIDAR_PRESETS)}"
            )
        whole = dataclasses.asdict(LidarConfig(**LIDAR_PRESETS[scanner]))
        given = {f"lidar.{key}": value for key, value in whole.items()} | given
    return tuple(sorted((key, _typed(f"{where}.{key}", key, value)) for key, value in given.items()))


def _flat(settings: Mapping, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in settings.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _typed(where: str, key: str, value: Any) -> Any:
    """The value of a setting that a robot may have of its own. Raises ConfigError for others and for wrong types."""
    if key not in ROBOT_SETTINGS:
        names = [name for name in ROBOT_SETTINGS if name.endswith(f".{key}")]
        hint = f"; did you mean {' or '.join(names)}?" if names else did_you_mean(key, ROBOT_SETTINGS)
        listed = "; ".join(f"{section}: {', '.join(names)}" for section, (_, names) in _NAMES.items())
        raise ConfigError(
            f"{where} cannot differ between robots{hint}: set it for the team; possible are preset, lidar.preset; "
            f"{listed}"
        )
    section, _, name = key.rpartition(".")
    default = getattr(_NAMES[section][0](), name)
    value = plain_value(value)
    if isinstance(default, float) and type(value) is int and not is_too_great(value):
        value = float(value)
    if type(value) is not type(default):
        raise ConfigError(f"{where} must be {KINDS[type(default)]}; got {value!r}")
    return value


def sections_with(config: Any, number: int, overrides: Overrides) -> dict[str, Any]:
    """The sections of an `EnvConfig` that overrides of robot `number` change. Raises ConfigError for values out of
    range."""
    changes: dict[str, dict[str, Any]] = {}
    for key, value in overrides:
        section, _, name = key.rpartition(".")
        changes.setdefault(section, {})[name] = value
    if config.slam.oracle == "poses":  # as `exploration.settings.resolve` for the whole team
        changes.setdefault("odometry", {})["drift"] = 0.0
    sections: dict[str, Any] = {}
    try:
        for section, values in changes.items():
            whole = dataclasses.replace(attrgetter(section)(config), **values)
            if section.startswith("slam."):
                sections["slam"] = dataclasses.replace(config.slam, **{section.removeprefix("slam."): whole})
            else:
                sections[section] = whole
    except ConfigError as error:
        raise ConfigError(f"robot[{number}]: {error}") from None
    return sections
