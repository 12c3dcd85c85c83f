"""The map that an earlier session left in a building: `slam.prior = "earlier-session:STEPS"`.

One robot of the same kind explores the building for that many time steps: it drives to the nearest frontier of its own
map, from a start of its own, with noise of its own. What its engine saves is the prior map. Nothing true enters it, and
it depends on the building, the world and the engine alone: all episodes in a building begin with the same map, whatever
actions, observations and rewards the team of today has.
"""

from __future__ import annotations

import dataclasses
from functools import lru_cache

from twc_env.config import EnvConfig, override, robot_configs
from twc_env.config.environment import ActionConfig, EpisodeConfig, ObservationConfig, RewardConfig
from twc_env.config.slam import EARLIER_SESSION
from twc_env.datasets.lasting_maps import prior_of
from twc_env.errors import ConfigError
from twc_env.exploration.episode import Episode
from twc_env.records.lasting_map import LastingMap
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.subsampling import subsampled
from twc_env.world.world import World

SEED = 2**31 - 1
"""Of the earlier session: episodes of a suite have the numbers of their buildings."""
MAPS_KEPT = 256
"""Maps of buildings that are kept in memory, of some 80 kB each."""


def prior_in(config: EnvConfig, plan: Floorplan) -> LastingMap | None:
    """The prior map of an episode in a building; None without one. Raises as `prior_of`, and ConfigError for a wrong
    number of steps."""
    name, colon, steps = config.slam.prior.partition(":")
    if name != EARLIER_SESSION:
        return prior_of(config)
    if not (colon and steps.isascii() and steps.isdigit() and 0 < int(steps) <= 1_000_000):
        raise ConfigError(
            f"slam.prior: {EARLIER_SESSION}:STEPS needs 1 to 1000000 time steps; got {config.slam.prior!r}"
        )
    alone = {"robots": 1, "robot": (), "slam.prior": "", "slam.mode": "cooperative", "max_cycles": int(steps)}
    same = override(robot_configs(config)[0], alone | {"link.topology": "central"})
    same = dataclasses.replace(
        same,
        action=ActionConfig(kind="frontier", timing="synchronous"),
        observation=ObservationConfig(),
        reward=RewardConfig(),
        episode=EpisodeConfig(),
    )
    return _explored(same, plan)


@lru_cache(maxsize=MAPS_KEPT)
def _explored(config: EnvConfig, plan: Floorplan) -> LastingMap:
    """What one robot saves after an episode with these settings."""
    episode = Episode(config, World(config, subsampled(plan, config.building)), SEED, "random", None)
    while not episode.is_over:
        episode.observe()
        episode.step({"robot_0": 0}, ["robot_0"])
    return episode.engine.lasting_map()
