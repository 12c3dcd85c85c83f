"""Small teams that wander, and what they left behind."""

from dataclasses import dataclass, field

import numpy as np
import pytest

import twc_env


@dataclass
class Log:
    """All that came out of an environment, step by step; entry 0 is that of `reset`."""

    env: twc_env.ExplorationEnv
    actions: list[dict] = field(default_factory=list)
    observations: list[dict] = field(default_factory=list)
    rewards: list[dict] = field(default_factory=list)
    infos: list[dict] = field(default_factory=list)
    beliefs: list[list] = field(default_factory=list)


@pytest.fixture(scope="session")
def explore(wander):
    """Run a team for some steps; it starts where the map says, close enough to meet."""

    def run(steps: int, seed: int = 0, env: twc_env.ExplorationEnv | None = None, **arguments) -> Log:
        env = twc_env.parallel_env(**{"map": "twin-01", "robots": 3, **arguments}) if env is None else env
        log = Log(env)
        observations, infos = env.reset(seed=seed, options={"starts": "map"})
        log.observations.append(observations)
        log.infos.append(infos)
        range_max_m = env.config.lidar.range_max_m
        for step in range(steps):
            actions = {
                agent: wander(observations[agent]["lidar"] * range_max_m, step, robot)
                for robot, agent in enumerate(env.agents)
            }
            observations, rewards, _, _, infos = env.step(actions)
            log.actions.append(actions)
            log.observations.append(observations)
            log.rewards.append(rewards)
            log.infos.append(infos)
            log.beliefs.append([env.belief(agent) for agent in env.possible_agents])
        return log

    return run


def same_observation(a: dict, b: dict) -> bool:
    """Whether two observations of one agent are equal to the last bit."""
    return a.keys() == b.keys() and all(np.array_equal(a[key], b[key]) for key in a)


@pytest.fixture(scope="session")
def same():
    return same_observation
