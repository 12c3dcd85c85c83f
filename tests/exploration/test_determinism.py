import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

EPISODE = """
import hashlib, sys
import numpy as np
import twc_env
from tests.conftest import wander_by_scan

if len(sys.argv) > 2:
    before = twc_env.parallel_env(config=twc_env.task_config("twc/ExploreHard-v0"))
    observations, _ = before.reset(seed=5)
    for step in range(150):
        scans = {agent: observations[agent]["lidar"] * 10 for agent in before.agents}
        observations, *_ = before.step({agent: wander_by_scan(scans[agent], step, 0) for agent in before.agents})

env = twc_env.parallel_env(map="twin-01", robots=3, max_cycles=500)
observations, infos = env.reset(seed=int(sys.argv[1]), options={"starts": "map"})
digest = hashlib.sha256()

def take(value):
    if isinstance(value, dict):
        for key in sorted(value):
            digest.update(str(key).encode())
            take(value[key])
    else:
        digest.update(np.ascontiguousarray(value).tobytes())

take(observations)
step = 0
while env.agents:
    scans = {agent: observations[agent]["lidar"] * 10 for agent in env.agents}
    actions = {agent: wander_by_scan(scans[agent], step, int(agent[-1])) for agent in env.agents}
    observations, rewards, terminations, truncations, infos = env.step(actions)
    for part in (observations, rewards, terminations, truncations, infos):
        take(part)
    for agent in env.possible_agents:
        belief = env.belief(agent)
        take(belief.pose_map_robot)
        take(belief.teammates)
    step += 1
result = env.result()
for grid in result.grids:
    take(grid.log_odds)
for part in (result.true_poses, result.estimated_poses, result.odometry_poses, result.graph["nodes"]):
    take(part)
print(step, len(result.closures), digest.hexdigest())
"""
ROOT = Path(__file__).parents[2]


def fresh_process(seed: int, hash_seed: str, *before: str) -> tuple[int, int, str]:
    """Steps, closures and digest of an episode in a new process; before: run another episode there first."""
    run = subprocess.run(
        [sys.executable, "-c", EPISODE, str(seed), *before],
        cwd=ROOT,
        env={**os.environ, "PYTHONHASHSEED": hash_seed},
        capture_output=True,
        text=True,
        check=True,
    )
    steps, closures, digest = run.stdout.split()
    return int(steps), int(closures), digest


@pytest.fixture(scope="module")
def episode():
    return fresh_process(0, "1")


def test_an_episode_is_bit_identical_in_another_process_after_another_episode(episode):
    assert episode[0] == 500
    assert episode[1] > 0, "no closure was tried: the digest would not cover the team's mapper"
    assert fresh_process(0, "2", "another task first") == episode


def test_episodes_differ_between_seeds(episode):
    assert fresh_process(1, "1")[2] != episode[2]


def steps_of(log) -> list:
    return list(zip(log.observations[1:], log.rewards, strict=True))


def test_a_second_episode_of_one_environment_repeats_the_first(explore, same_steps):
    first = explore(60, seed=3)
    explore(15, seed=4, env=first.env)
    assert same_steps(steps_of(explore(60, seed=3, env=first.env)), steps_of(first))


def test_seeds_of_the_spaces_do_not_change_the_episode(explore, same_steps):
    first = explore(30, seed=3)
    for agent in first.env.possible_agents:
        first.env.action_space(agent).seed(99)
        first.env.observation_space(agent).seed(99)
    assert same_steps(steps_of(explore(30, seed=3, env=first.env)), steps_of(first))


def test_global_random_generators_are_neither_used_nor_advanced(explore, same_steps):
    import random

    np.random.seed(1)  # noqa: NPY002
    random.seed(1)
    first = explore(20)
    assert np.random.random() == np.random.RandomState(1).random()  # noqa: NPY002
    assert random.random() == random.Random(1).random()
    np.random.seed(2)  # noqa: NPY002
    assert same_steps(steps_of(explore(20)), steps_of(first))
