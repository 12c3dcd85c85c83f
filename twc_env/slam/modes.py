"""The SLAM engine for each value of `slam.mode`."""

from __future__ import annotations

from twc_env.config import EnvConfig
from twc_env.errors import ConfigError
from twc_env.records.lasting_map import LastingMap
from twc_env.slam.dead_reckoning import DeadReckoning
from twc_env.slam.engine import CooperativeSlam
from twc_env.slam.map_localisation import MapLocalisation

Engine = CooperativeSlam | DeadReckoning


def make_engine(config: EnvConfig, robot_count: int, prior: LastingMap | None = None) -> Engine:
    """A new engine as configured, for the start of an episode; prior: the map that `slam.prior` names.

    Raises ConfigError if `slam.mode` and prior do not fit: localisation needs one, `off` has no use for any, and only
    localisation takes a map without places.
    """
    if config.slam.mode == "off":
        if prior is not None:
            raise ConfigError("slam.mode is 'off': without an engine slam.prior is of no use; leave one of them")
        return DeadReckoning(config, robot_count)
    if config.slam.mode == "localisation":
        if prior is None:
            raise ConfigError("slam.mode is 'localisation': name the map to find poses in by slam.prior (--prior FILE)")
        return MapLocalisation(config, robot_count, prior)
    if prior is not None and not len(prior.poses):
        raise ConfigError(
            f"slam.prior is {config.slam.prior!r}, a plain map without places to begin with: set "
            "slam.mode=localisation, or give a map that --save wrote"
        )
    return CooperativeSlam(config, robot_count, prior)
