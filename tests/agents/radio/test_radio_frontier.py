import numpy as np
from twc_env.agents.radio.radio_frontier import radio_penalty_m

from twc_env.records.messages import Belief, GridMap


def belief(radio):
    seen = np.zeros((60, 60), np.int16)
    seen[20:40, 20:40] = -10
    return Belief(0, 0, np.zeros(3), GridMap(seen, np.zeros(2), 0.1), radio_map=radio)


def test_a_frontier_with_predicted_floor_is_preferred_and_seen_floor_does_not_count():
    levels = np.zeros((60, 60), np.int16)
    levels[:, 20:] = -5  # predicted free on the right, whose middle has been seen
    centres = np.array([[2.0, 3.0], [4.0, 3.0]])
    left, right = radio_penalty_m(belief(GridMap(levels, np.zeros(2), 0.1)), centres)
    assert left > right == 0.0
    assert not radio_penalty_m(belief(None), centres).any()
