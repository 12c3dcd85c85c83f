"""Editors, `help` and type checkers see the arguments of the functions that make environments."""

import inspect

import pettingzoo
import pytest

import twc_env
from twc_env.exploration.environment import ExplorationEnv


def arguments(function) -> list[inspect.Parameter]:
    return list(inspect.signature(function).parameters.values())


@pytest.mark.parametrize("name", ["parallel_env", "env", "raw_env"])
def test_the_arguments_shown_are_those_of_the_environment(name):
    assert arguments(getattr(twc_env, name)) == arguments(ExplorationEnv)


def test_the_arguments_reach_the_environment():
    team = twc_env.parallel_env("twin-02", 2, 50, {"lidar.beam_count": 60}, "rgb_array", None, "twc/ExploreFrontier-v0")
    assert (team.config.map, team.config.robots, team.config.max_cycles) == ("twin-02", 2, 50)
    assert (team.config.lidar.beam_count, team.config.action.kind, team.render_mode) == (60, "frontier", "rgb_array")
    assert twc_env.env("twin-02", robots=1, max_cycles=5).possible_agents == ["robot_0"]


def test_what_is_returned_is_shown_too():
    assert inspect.signature(twc_env.parallel_env).return_annotation == "ExplorationEnv"
    assert inspect.signature(twc_env.env).return_annotation == "pettingzoo.AECEnv"
    assert isinstance(twc_env.env(max_cycles=5), pettingzoo.AECEnv)


def test_every_argument_is_explained():
    text = twc_env.parallel_env.__doc__
    assert [a.name for a in arguments(twc_env.parallel_env) if f"        {a.name}: " not in text] == []


def test_every_task_says_what_it_is_for():
    from twc_env.tasks import PURPOSES

    assert list(PURPOSES) == list(twc_env.TASKS)
