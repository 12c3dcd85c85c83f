"""The SLAM engine for each value of `slam.mode`."""

from __future__ import annotations

from twc_env.config import EnvConfig
from twc_env.slam.dead_reckoning import DeadReckoning
from twc_env.slam.engine import CooperativeSlam

Engine = CooperativeSlam | DeadReckoning


def make_engine(config: EnvConfig, robot_count: int) -> Engine:
    """A new engine as configured, for the start of an episode."""
    return DeadReckoning(config, robot_count) if config.slam.mode == "off" else CooperativeSlam(config, robot_count)
