"""What a training costs, on the smallest setting."""

import gc
from dataclasses import replace

import pytest

pytestmark = pytest.mark.usefixtures("torch")


def test_decisions_per_second_are_told_with_the_shares_of_all_parts(task):
    from twc_env.training.mappo import Settings
    from twc_env.training.throughput import throughput

    frozen = gc.get_freeze_count()
    settings = Settings(environments=2, workers=1, rollout_steps=8, epochs=1, minibatches=1, hidden_size=8)
    found = throughput(task, 2, settings)
    shared = throughput(task, 1, replace(settings, workers=2))
    for figures in (found, shared):
        shares = [figures[f"{part}_share"] for part in ("environments", "inference", "update")]
        assert min(shares) > 0.0 and sum(shares) == pytest.approx(1.0) and figures["decisions_per_s"] > 0.1
    assert 1.0 < found["robot_steps_per_cpu_s"] / found["decisions_per_cpu_s"] <= 20.0, "two seconds per decision"
    assert found["memory_mb"] > 50.0
    assert "memory_mb" not in shared, "nor CPU time: that of one process says little"
    assert gc.get_freeze_count() == frozen, "garbage is collected again"
