"""The table of what a learner loses without some of what it knows."""

import pytest

from twc_env import tasks
from twc_env.reproduce.learning import ablation


@pytest.fixture
def tiny(monkeypatch):
    """Episodes of less than a second, and small networks."""
    pytest.importorskip("torch", reason="needs the extra 'train'")
    from twc_env.training import mappo

    monkeypatch.setitem(tasks.TASKS, ablation.TASK, {**tasks.TASKS[ablation.TASK], "max_cycles": 40})
    sizes = {"environments": 1, "rollout_steps": 8, "epochs": 1, "minibatches": 1, "hidden_size": 8}
    settings = mappo.Settings
    monkeypatch.setattr(mappo, "Settings", lambda **given: settings(**{**sizes, **given}))


def test_a_row_is_the_lead_of_a_variant_over_the_whole_learner_in_the_same_buildings(rows_of, tiny):
    words = ["--steps", "8", "--buildings", "2", "--jobs", "1"]
    rule, whole, blind = rows_of(ablation, *words, "--variants", "rule", "mappo", "mappo-no-map")
    assert [row["variant"] for row in (rule, whole, blind)] == ["rule", "mappo", "mappo-no-map"]
    assert [row["over"] for row in (rule, whole, blind)] == [None, "rule", "mappo"]
    assert rule["lead"] is None and rule["steps"] == 0 and rule["learner"] is None
    assert whole["lead"] == pytest.approx(whole["mean_coverage"] - rule["mean_coverage"])
    assert blind["lead"] == pytest.approx(blind["mean_coverage"] - whole["mean_coverage"])
    assert blind["lead_low"] <= blind["lead"] <= blind["lead_high"]
    assert all(row["buildings"] == 2 and 0.0 < row["mean_coverage"] < 1.0 for row in (rule, whole, blind))


def test_a_finished_variant_is_kept_and_an_interrupted_one_goes_on(rows_of, tiny, tmp_path, monkeypatch):
    from twc_env.training import mappo

    begun, train = [], mappo.train

    def cut(task, settings, folder, resume, show):
        begun.append((folder.name, resume))
        if begun == [("rule", False), ("mappo", False)]:
            train(task, settings, folder, resume, show)
            raise KeyboardInterrupt  # the model is saved, that it is finished is not
        return train(task, settings, folder, resume, show)

    monkeypatch.setattr(mappo, "train", cut)
    words = ["--steps", "8", "--buildings", "1", "--jobs", "1", "--variants", "rule", "mappo"]
    with pytest.raises(KeyboardInterrupt):
        rows_of(ablation, *words)
    assert len(rows_of(ablation, *words)) == 2
    assert begun == [("rule", False), ("mappo", False), ("mappo", True)]


def test_each_variant_has_settings_that_its_learner_knows_and_is_compared_with_one_that_comes_before(tiny):
    pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")
    from twc_env.training import evolution, mappo, ppo

    seen = []
    for name, variant in ablation.VARIANTS.items():
        {"mappo": mappo, "es": evolution, "ppo": ppo}[variant.learner].Settings(**variant.settings)
        assert variant.over in [None, *seen]
        seen.append(name)
