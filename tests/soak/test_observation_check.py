import numpy as np

from tests.soak import observation_check
from tests.soak.__main__ import main
from tests.soak.observation_check import ACTIONS, EPISODE_STEPS, check_observations
from twc_env.exploration.environment import ExplorationEnv


def test_every_block_stays_in_its_space_changes_and_shares_no_memory(monkeypatch):
    monkeypatch.setattr(observation_check, "ACTIONS", (ACTIONS[0], ACTIONS[3]))
    report = check_observations(300)
    assert report.faults == []
    assert report.steps == 300
    assert report.blocks > 10 * report.steps


def test_blocks_outside_their_space_constant_or_sharing_memory_are_reported(monkeypatch):
    honest = ExplorationEnv.step

    def careless(self, actions):
        observations, *rest = honest(self, actions)
        for observation in observations.values():
            observation["pose"] = np.full(8, np.nan, np.float32)
            observation["wifi"] = observations["robot_0"]["wifi"]
            observation["signs"] = np.zeros_like(observation["signs"])
        return observations, *rest

    monkeypatch.setattr(ExplorationEnv, "step", careless)
    monkeypatch.setattr(observation_check, "ACTIONS", ACTIONS[:1])
    faults = " ".join(check_observations(EPISODE_STEPS).faults)
    for words in ("pose left its space", "wifi shares memory", "signs never changed"):
        assert words in faults
    assert "team" not in faults


def test_a_run_shorter_than_an_episode_reports_no_constant_blocks(monkeypatch, capsys):
    monkeypatch.setattr(observation_check, "ACTIONS", ACTIONS[:1])
    assert main(["--observations", "1"]) == 0
    assert "constant blocks were not searched for: velocity, synchronous" in capsys.readouterr().out


def test_the_command_ends_with_an_error_if_there_are_faults(monkeypatch, capsys):
    monkeypatch.setattr(observation_check, "ACTIONS", ACTIONS[:1])
    monkeypatch.setitem(observation_check._SETTINGS, "max_cycles", 2)
    assert main(["--observations", "2"]) == 2
    assert "never changed" in capsys.readouterr().err
