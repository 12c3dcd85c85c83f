"""The evolution strategy: which way it steps, and that both teams of a pair have the same chances."""

import numpy as np
import pytest

from twc_env.errors import ConfigError

pytestmark = pytest.mark.usefixtures("torch")


def test_the_step_goes_along_changes_that_scored_more_whatever_the_unit_of_the_score():
    from twc_env.training.evolution import step_of

    random = np.random.default_rng(0)
    changes, slope = random.standard_normal((4000, 3)), np.array([0.03, 0.0, -0.04])
    scores = 0.7 + np.stack([changes @ slope, -changes @ slope], 1) + random.normal(0.0, 0.001, (4000, 2))
    assert step_of(changes, scores) == pytest.approx([0.6, 0.0, -0.8], abs=0.03)
    assert step_of(changes, 100.0 * scores) == pytest.approx(step_of(changes, scores))
    assert (step_of(changes, np.full((4000, 2), 0.7)) == 0.0).all()


def test_a_pair_with_equal_weights_plays_equal_episodes_and_weights_matter(task):
    from twc_env.training.encoder import rule_for
    from twc_env.training.evolution import Episodes, Settings

    episodes = Episodes(task, Settings(environments=4, workers=0))
    rule = rule_for(episodes.space)
    weights = np.tile([weight for weight, _ in rule.values()], (4, 1))
    weights[3, list(rule).index("stay")] = 20.0
    played, decisions = episodes.play(weights, [7, 7, 8, 8])
    episodes.close()
    assert played[0] == played[1] and decisions > 20
    assert played[2]["score"] > played[3]["score"]


def test_teams_that_do_not_make_pairs_are_refused_before_anything_is_written(task, tmp_path):
    from twc_env.training.evolution import Settings, train

    with pytest.raises(ConfigError, match="--environments must be even, as teams play in pairs; got 3"):
        train(task, Settings(environments=3, workers=0), tmp_path / "run")
    assert not (tmp_path / "run").exists()
