"""The script that trains with TorchRL's own parts."""

from dataclasses import replace

import pytest


@pytest.mark.filterwarnings("ignore")
def test_torchrl_trains_a_shared_policy_with_a_centralised_critic(task):
    pytest.importorskip("torchrl", reason="needs the extra 'torchrl'")
    from twc_env.training import torchrl_mappo

    earned = torchrl_mappo.train(replace(task, max_cycles=40), 2)
    assert len(earned) == 2 and all(reward > 0.0 for reward in earned)
