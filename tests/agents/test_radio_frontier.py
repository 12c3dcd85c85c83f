import numpy as np

from agents import radio_prior
from agents.radio_frontier import RadioFrontier
from twc_env.config import EnvConfig
from twc_env.messages import Belief, GridMap


def belief(radio):
    seen = np.zeros((60, 60), np.int16)
    seen[20:40, 20:40] = -10
    return Belief(0, 0, np.zeros(3), GridMap(seen, np.zeros(2), 0.1), radio_map=radio)


def test_a_frontier_with_free_floor_beyond_is_wanted_more_and_seen_floor_counts_nothing():
    levels = np.zeros((60, 60), np.int16)
    levels[:, 20:] = -5  # free to the right, of which the middle is seen already
    agent = RadioFrontier(EnvConfig())
    centres = np.array([[2.0, 3.0], [4.0, 3.0]])
    left, right = agent.extra_penalty_m(belief(GridMap(levels, np.zeros(2), 0.1)), centres)
    assert left > right == 0.0
    assert not agent.extra_penalty_m(belief(None), centres).any()


def test_pairs_are_resumed_and_compared(tmp_path, monkeypatch):
    calls = []

    def run(config, agent, seed):
        calls.append(agent)
        return (50.0 if agent == "radio-frontier" else 60.0 + seed), True

    monkeypatch.setattr(radio_prior, "time_to_cover_s", run)
    first = radio_prior.compare(["test/0000", "test/0001"], 10, tmp_path)
    again = radio_prior.compare(["test/0000", "test/0001"], 10, tmp_path)
    assert len(calls) == 4
    assert first.saved_s == again.saved_s == 10.5
    assert 10.0 <= first.interval_s[0] <= first.interval_s[1] <= 11.0
