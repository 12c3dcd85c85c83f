"""Short episodes with random-like motion, and their logs."""

from dataclasses import dataclass, field

import numpy as np
import pytest

import twc_env
from twc_env.slam.merging import map_merging
from twc_env.slam.merging.mutual_observations import MutualObservations, ObservationCounts


@dataclass
class Log:
    """Outputs of an environment per step; entry 0 of observations and infos is that of `reset`."""

    env: twc_env.ExplorationEnv
    actions: list[dict] = field(default_factory=list)
    observations: list[dict] = field(default_factory=list)
    rewards: list[dict] = field(default_factory=list)
    infos: list[dict] = field(default_factory=list)
    beliefs: list[list] = field(default_factory=list)


@pytest.fixture(scope="session")
def explore(wander):
    """Run a team for some steps from the start poses of the map, which are close enough for robots to meet."""

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


@pytest.fixture
def wrong_merges(monkeypatch):
    """Makes the engine merge two robots at their first closure, with a wrong relative pose; call it to end that."""

    def agree(targets, *_):
        return map_merging.MergeProposal(np.array([6.0, -4.0, 1.0]), np.ones(len(targets), bool), (9, 9, 9))

    lies = {"largest_agreement": agree, "wall_contradiction": lambda *_: 0.0, "wifi_difference": lambda *_: 0.0}
    told = [(map_merging, name, getattr(map_merging, name)) for name in lies]
    told.append((MutualObservations, "count", MutualObservations.count))
    for name, lie in lies.items():
        monkeypatch.setattr(map_merging, name, lie)
    monkeypatch.setattr(MutualObservations, "count", lambda *_: ObservationCounts(0, 0))
    return lambda: [monkeypatch.setattr(*honest) for honest in told]


def same_observation(a: dict, b: dict) -> bool:
    """Whether two observations of one agent are bit-identical."""
    return a.keys() == b.keys() and all(np.array_equal(a[key], b[key]) for key in a)


@pytest.fixture(scope="session")
def same():
    return same_observation


@pytest.fixture(scope="session")
def same_steps():
    """A function: whether the steps (observations, rewards, ...) of two episodes are bit-identical."""
    return lambda a, b: all(
        all(same_observation(x[0][agent], y[0][agent]) for agent in x[0]) and x[1:] == y[1:]
        for x, y in zip(a, b, strict=True)
    )
