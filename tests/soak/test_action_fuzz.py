import json

import numpy as np
import pytest

import twc_env
from tests.soak import action_fuzz
from tests.soak.__main__ import main
from tests.soak.action_fuzz import fuzz_actions
from twc_env.errors import ActionError
from twc_env.exploration import actions as action_blocks
from twc_env.exploration.environment import ExplorationEnv


def test_malformed_actions_of_every_kind_are_rejected_without_side_effects():
    report = fuzz_actions(900, seed=1)
    assert (report.escaped, report.changed) == ([], [])
    assert report.count == 900 == report.refused + report.accepted
    assert report.refused > 850
    assert report.steps_compared >= 3


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
    assert fuzz_actions(300, seed=1).escaped


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
    assert fuzz_actions(200, seed=1).changed == ["velocity"]


def test_the_command_prints_the_results(tmp_path, capsys):
    path = tmp_path / "fuzz.json"
    assert main(["--actions", "60", "--json", str(path)]) == 0
    assert "60 malformed actions" in capsys.readouterr().out
    assert json.loads(path.read_text())["actions"]["escaped"] == []
    with pytest.raises(SystemExit, match="2"):
        main(["--actions", "0"])
    assert "--actions" in capsys.readouterr().err
