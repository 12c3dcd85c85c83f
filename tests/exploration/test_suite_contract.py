"""The contracts of PettingZoo and Gymnasium on every task of the suite v1, an early end included."""

import gymnasium
import numpy as np
import pettingzoo
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test

import twc_env
from twc_env.tasks import SUITES
from twc_env.world.building.splits import FAMILY_SPLITS, family_of, is_set, split_names

TASKS = SUITES["v1"]
SOON = {"episode.ends_at_coverage": 0.002, "reward.period_steps": 5, "lidar.beam_count": 60}
"""An end that the first scans of a still team may bring, after five steps."""


def made(task, **settings):
    return pettingzoo.make("parallel", task, max_cycles=12, config={"lidar.beam_count": 60, **settings})


@pytest.mark.parametrize("task", TASKS)
def test_pettingzoo_accepts_every_task_and_an_episode_that_ends_early(task):
    parallel_api_test(made(task), num_cycles=30)
    parallel_api_test(made(task, **SOON), num_cycles=30)


@pytest.mark.filterwarnings(  # the observation is a Dict, which PettingZoo allows
    "ignore:Observation is not a NumPy array", "ignore:Observation space for each agent probably should be"
)
@pytest.mark.parametrize("task", TASKS)
def test_pettingzoo_accepts_every_task_turn_by_turn(task):
    api_test(pettingzoo.make("aec", task, max_cycles=8, config=SOON), num_cycles=40)


@pytest.mark.parametrize("task", TASKS)
def test_the_same_seed_gives_the_same_episode_in_every_task(task):
    parallel_seed_test(lambda: made(task, **SOON), num_cycles=10)


@pytest.mark.parametrize("task", TASKS)
def test_gymnasium_accepts_every_task_for_one_robot(task):
    check_env(gymnasium.make(task, max_cycles=12, config=SOON).unwrapped, skip_render_check=True)


@pytest.mark.parametrize("task", TASKS)
def test_an_early_end_terminates_all_robots_of_every_task_together(task):
    env = made(task, **SOON)
    ends = []
    for seed in range(3):
        env.reset(seed=seed)
        while env.agents:
            *_, terminations, truncations, _ = env.step({agent: np.zeros(2, np.float32) for agent in env.agents})
        assert len(set(terminations.values())) == len(set(truncations.values())) == 1
        assert terminations["robot_0"] != truncations["robot_0"]
        ends.append((terminations["robot_0"], env.episode.steps))
    assert set(ends) <= {(True, 5), (True, 10), (False, 12)}
    assert any(is_terminated for is_terminated, _ in ends), "what a team at rest sees is enough"


@pytest.mark.parametrize("task", TASKS)
def test_every_task_plays_in_the_training_split_of_its_own_family_and_ends_at_a_coverage(task):
    config = twc_env.task_config(task)
    assert is_set(config.map) and config.map.endswith(":train")
    assert {split: len(split_names(split, family_of(config.map))) for split in FAMILY_SPLITS} == FAMILY_SPLITS
    assert 0.9 <= config.episode.ends_at_coverage < 1.0
    env = made(task)
    env.reset(seed=3, options={"split": "test"})
    assert env.floorplan.name.startswith(f"{family_of(config.map)}:test/")
