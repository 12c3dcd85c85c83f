"""Policies that come with the package."""

import pytest

from twc_env.errors import DataError
from twc_env.suite.entries import entries
from twc_env.suite.models import model_in_task

pytestmark = pytest.mark.usefixtures("torch")


def test_the_team_learned_plays_the_policy_of_the_task_which_is_small_and_has_a_card():
    from twc_env.training.shipped import shipped

    folder = shipped("twc/ExploreQuick-v1")
    assert (folder / "model.safetensors").stat().st_size < 2_000_000 and "nearest-frontier" in (
        folder / "card.md"
    ).read_text()
    env, act = model_in_task(entries(["twc/ExploreQuick-v1"], ["learned"], "test", 1)[0])
    seen, _ = env.reset(seed=0)
    assert set(act(seen)) == set(env.agents)
    with pytest.raises(DataError, match=r"no policy for twc/ExploreMall-v1 .* train one with twc-env train mappo"):
        shipped("twc/ExploreMall-v1")
