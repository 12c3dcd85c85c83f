"""The tables in docstrings, which are the environment's manual page, agree with spaces and rewards."""

import re
from dataclasses import fields

import numpy as np
import pytest

import twc_env
from twc_env.config import RewardConfig
from twc_env.exploration.assessment import rewards

PAGE = twc_env.ExplorationEnv.__doc__
NUMBERS = {"beams": 180, "n-1": 2, "slots + 3": 11}
EVERYTHING = {
    "action.kind": "frontier", "observation.overview": True, "observation.gains": True,
    "slam.k_visibility.enabled": True,
}  # fmt: skip


def rows(text):
    """Cells of the table rows that start with a name in backquotes, by that name."""
    cut = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in text.splitlines() if "|" in line]
    return {cells[0].strip("`"): cells[1:] for cells in cut if re.fullmatch(r"`\w+`", cells[0])}


def test_the_table_of_observations_lists_shape_type_and_range_of_every_block():
    space = twc_env.parallel_env(config=EVERYTHING).observation_space("robot_0")
    table = {name: cells for name, cells in rows(PAGE).items() if name in space.spaces}
    assert set(table) == set(space.spaces)
    for name, (shape, span, *_) in table.items():
        numbers, kind = re.fullmatch(r"\((.+?),?\) ?(\w*)", shape).groups()
        said = tuple(int(NUMBERS.get(part.strip(), part)) for part in numbers.split(", "))
        block = space[name]
        assert block.shape == said, name
        assert block.dtype == (kind or "float32"), name
        if ends := re.fullmatch(r"\[?(-?\d+)(?:, |\.\.)(\d+)\]?", span):
            low, high = map(float, ends.groups())
            assert (
                (block.low.min(), block.high.max()) == (low, high) if hasattr(block, "low") else (low, high) == (0, 1)
            )


@pytest.mark.parametrize("kind", ["velocity", "waypoint", "frontier"])
def test_the_table_of_actions_lists_every_space(kind):
    config = twc_env.EnvConfig()
    space = twc_env.parallel_env(config={"action.kind": kind}).action_space("robot_0")
    said = rows(PAGE)[kind][0].strip("`")
    if kind == "frontier":
        assert said == "Discrete(slots + 3)" and space.n == config.action.frontier_slots + 3
    else:
        low, high, length = map(int, re.findall(r"-?\d+", said))
        assert (space.low.min(), space.high.max(), space.shape, space.dtype) == (low, high, (length,), np.float32)


def test_the_table_of_rewards_lists_every_term_and_weight():
    table = rows(rewards.__doc__)
    assert tuple(table) == rewards.TERMS
    assert {field.name for field in fields(RewardConfig)} == {*table, "period_steps", "sharing"}
    assert {name for name, cells in table.items() if cells[-1] == "potential"} == set(rewards.POTENTIALS)


@pytest.mark.parametrize("topology", ["central", "peer"])
def test_a_teammate_in_contact_has_age_0_even_if_it_stands_still(topology):
    env = twc_env.parallel_env(robots=2, max_cycles=100, config={"link.topology": topology, "link.range_max_m": 1000.0})
    observations, _ = env.reset(seed=1)
    while env.agents:
        for agent in env.agents:
            assert observations[agent]["team"][0, 4] == 0.0
        observations, *_ = env.step({agent: np.zeros(2, np.float32) for agent in env.agents})
