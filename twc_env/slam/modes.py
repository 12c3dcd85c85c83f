"""Which engine runs inside the environment: one name of `slam.mode`, one class."""

from __future__ import annotations

from twc_env.config import EnvConfig
from twc_env.slam.dead_reckoning import DeadReckoning
from twc_env.slam.engine import CooperativeSlam

Engine = CooperativeSlam | DeadReckoning

MODES: dict[str, type[CooperativeSlam] | type[DeadReckoning]] = {"cooperative": CooperativeSlam, "off": DeadReckoning}


def make_engine(config: EnvConfig, robot_count: int) -> Engine:
    """The engine that the config asks for, at the start of an episode."""
    return MODES[config.slam.mode](config, robot_count)
