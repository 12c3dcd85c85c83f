"""A short training run shared by several tests, and its task."""

import os
from functools import partial

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
        area_m2=100.0, buildings=2, max_cycles=80, overrides={"lidar.beam_count": 60, "action.decision_max_s": 2.0}
    )


@pytest.fixture(scope="session")
def settings(torch):
    from twc_env.training.ppo import Settings

    return Settings(seed=3, environments=2, workers=0, rollout_steps=16, batch_size=32, epochs=2)


@pytest.fixture(scope="session")
def train(torch):
    from twc_env.training import ppo

    return partial(ppo.train, show_progress=False)


@pytest.fixture(scope="session")
def policy_of(torch):
    """The policy in a run folder."""

    def read(folder):
        from twc_env.training.model_file import load_policy
        from twc_env.training.ppo import ChoicePolicy
        from twc_env.training.run_folder import read_settings, task_of
        from twc_env.training.team_notes import TeamNotes

        import twc_env

        env = twc_env.parallel_env(config=task_of(read_settings(folder)).config)
        seen = TeamNotes.space(env.observation_space("robot_0"))
        return load_policy(folder / "model.zip", ChoicePolicy, seen, env.action_space("robot_0"))

    return read


@pytest.fixture(scope="session")
def run(train, task, settings, tmp_path_factory):
    """A run folder after 128 decisions of training."""
    folder = tmp_path_factory.mktemp("ppo")
    train(task, settings, 128, folder)
    return folder
