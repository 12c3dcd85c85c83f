import gymnasium
import pettingzoo
import pytest

import twc_env
from twc_env.config import digest, override
from twc_env.errors import ConfigError

# Another digest means other results: register a new version of the environment, note it in CHANGELOG.md under
# "Environment versions", then change its line.
PINNED = {
    "twc/Explore-v0": "17a40728f799",
    "twc/ExploreTwin01-v0": "17a40728f799",
    "twc/ExploreTwin02-v0": "fc0dae906f8d",
    "twc/ExploreOffice-v0": "840ceeeca503",
    "twc/ExploreFrontier-v0": "6113aaed19a3",
    "twc/ExploreFrontierAsync-v0": "3f0e35950650",
    "twc/ExploreHard-v0": "056d90f47f88",
    "twc/ExploreKnownStarts-v0": "06696854976b",
    "twc/ExploreTruePoses-v0": "4526bcfe07bc",
    "twc/ExploreNoMerging-v0": "fe687a7c5ffe",
    "twc/ExploreQuick-v1": "1471a1d79726",
    "twc/ExploreOffice-v1": "cb9c5bfc7810",
    "twc/ExploreEntrance-v1": "920ec6905107",
    "twc/ExplorePeers-v1": "05d74954064f",
    "twc/ExploreMall-v1": "c85bb57b38a2",
    "twc/ExploreBare-v1": "4441aeb0f9a5",
    "twc/ExploreRadio-v1": "31d04f0556bc",
    "twc/ExploreReturn-v1": "a1f5e5a98a4b",
    "twc/ExploreWard-v1": "a162b6db083e",
    "twc/ExploreMixed-v1": "bc50e7ee6082",
}


@pytest.mark.parametrize("task", twc_env.TASKS)
def test_every_task_has_its_pinned_config_digest(task):
    assert digest(twc_env.task_config(task)) == PINNED[task]


def test_all_tasks_but_the_first_two_differ():
    assert digest(twc_env.EnvConfig()) == PINNED["twc/Explore-v0"]
    assert PINNED["twc/Explore-v0"] == PINNED["twc/ExploreTwin01-v0"], "the default map is twin-01"
    assert len(set(PINNED.values())) + 1 == len(twc_env.TASKS) == len(PINNED)


@pytest.mark.filterwarnings("ignore:.*The environment twc/ExploreOffice-v0 is out of date")  # there is a v1
@pytest.mark.parametrize("task", twc_env.TASKS)
def test_every_task_can_be_made_by_its_id_and_overridden(task):
    parallel = pettingzoo.make("parallel", task, max_cycles=3)
    assert parallel.config.max_cycles == 3
    for key, value in twc_env.TASKS[task].items():
        if key in ("world", "team"):  # short for several others
            continue
        section, _, name = key.rpartition(".")
        holder = parallel.config
        for part in section.split(".") if section else ():
            holder = getattr(holder, part)
        assert name == "max_cycles" or getattr(holder, name) == value
    single = gymnasium.make(task, max_cycles=3, config={"lidar.beam_count": 36}, disable_env_checker=True)
    own = parallel.config.robot  # of a mixed team each robot has its own scanner
    assert single.observation_space["lidar"].shape == (dict(own[0])["lidar.beam_count"] if own else 36,)
    assert single.unwrapped.parallel.config.lidar.beam_count == 36


def test_the_error_of_a_misspelt_task_suggests_the_nearest():
    with pytest.raises(ConfigError, match="did you mean 'twc/ExploreHard-v0'"):
        twc_env.parallel_env(task="twc/ExploreHrd-v0")


def test_the_hard_task_can_be_run():
    env = twc_env.parallel_env(task="twc/ExploreHard-v0", max_cycles=30)
    env.reset(seed=0)
    while env.agents:
        env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    assert env.result().figures["robots"] == 4


def test_a_config_that_contradicts_the_task_is_rejected():
    hard = twc_env.task_config("twc/ExploreHard-v0")
    for config in (hard, override(hard, {"lidar.beam_count": 60})):
        assert twc_env.parallel_env(task="twc/ExploreHard-v0", config=config).config == config
    with pytest.raises(ConfigError, match="other settings than twc/ExploreHard-v0"):
        twc_env.parallel_env(task="twc/ExploreHard-v0", config=twc_env.EnvConfig())


@pytest.mark.parametrize("task", [3, ("twc/Explore-v0",)])
def test_a_task_that_is_not_a_string_is_rejected(task):
    with pytest.raises(ConfigError, match="unknown task"):
        twc_env.parallel_env(task=task)


@pytest.mark.parametrize("task", [[1], 7, {}])
def test_a_task_that_is_no_text_is_refused_in_one_line(task):
    with pytest.raises(ConfigError, match=r"unknown task .*; known are twc/Explore-v0"):
        twc_env.parallel_env(task=task)
