"""A short training run shared by several tests, and its task."""

import os
from dataclasses import replace

import pytest


@pytest.fixture(scope="session")
def torch():
    """The module torch; skips if it is not installed, except in continuous integration, which must have it."""
    if "CI" not in os.environ:
        for name in ("torch", "stable_baselines3"):
            pytest.importorskip(name, reason="needs torch and stable-baselines3: pip install 'twc_env[train]'")
    import torch

    return torch


@pytest.fixture(scope="session")
def task(torch):
    from twc_env.training.run_folder import Task

    return Task(
        area_m2=100.0,
        buildings=2,
        robots=2,
        max_cycles=80,
        overrides={"lidar.beam_count": 60, "action.decision_max_s": 2.0},
    )


@pytest.fixture(scope="session")
def settings(torch):
    from twc_env.training.ppo import Settings

    return Settings(seed=3, environments=2, workers=0, rollout_steps=16, batch_size=32, epochs=2)


@pytest.fixture(scope="session")
def train(torch):
    from twc_env.training import ppo

    def run(task, settings, steps, folder, resume=False):
        return ppo.train(task, replace(settings, steps=steps), folder, resume, show_progress=False)

    return run


@pytest.fixture(scope="session")
def weights_of(torch):
    """The arrays in a run folder."""
    from twc_env.training.checkpoint import load

    return lambda folder: load(folder / "model.safetensors")[0]


@pytest.fixture(scope="session")
def run(train, task, settings, tmp_path_factory):
    """A run folder after 128 decisions of training."""
    folder = tmp_path_factory.mktemp("ppo")
    train(task, settings, 128, folder)
    return folder
