import numpy as np
import pytest

import twc_env
from tests.soak.attempts import attempt_all
from tests.soak.malformed import action_fuzz
from tests.soak.malformed.action_fuzz import broken_steps
from twc_env.errors import ActionError
from twc_env.exploration import actions as action_blocks
from twc_env.exploration.environment import ExplorationEnv


def fuzzed(count, seed):
    return attempt_all(broken_steps(count, seed), ActionError)


def test_the_error_of_an_unknown_agent_names_it():
    env = twc_env.parallel_env(robots=2, max_cycles=5)
    env.reset(seed=0)
    good = {agent: np.zeros(2) for agent in env.agents}
    with pytest.raises(ActionError, match="'robot_7'"):
        env.step({**good, "robot_7": np.zeros(2)})
    before = env.frames_of_step
    with pytest.raises(ActionError, match="dict"):
        env.step(None)
    assert env.frames_of_step is before


def test_the_fuzzer_detects_other_exceptions(monkeypatch):
    monkeypatch.setattr(action_blocks, "check_agents", lambda actions, agents: None)
    assert fuzzed(300, 1).wrong


def test_the_fuzzer_detects_side_effects_of_a_rejected_action(monkeypatch):
    honest = ExplorationEnv.step

    def careless(self, actions):
        try:
            return honest(self, actions)
        except ActionError:
            self._world.step(np.zeros((2, 2)))
            raise

    monkeypatch.setattr(ExplorationEnv, "step", careless)
    monkeypatch.setattr(action_fuzz, "KINDS", ("velocity",))
    assert any("rejected velocity actions changed the episode" in fault for fault in fuzzed(200, 1).wrong)
