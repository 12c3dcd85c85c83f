"""stable-baselines3 and sb3-contrib on rows of robots."""

import numpy as np
import pytest

import twc_env
from tests.vector.test_teams import CHOICES, SMALL, same
from twc_env.errors import ActionError, ConfigError

pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")
from twc_env.vector.sb3 import TeamVecEnv

FLAT = {**SMALL, "observation.kind": "flat"}


@pytest.mark.parametrize("shape", [(3, 2), (4, 1), (2, 2, 2), (2,)])
def test_actions_of_another_number_of_rows_are_refused(shape):
    rows = TeamVecEnv(2, SMALL)
    rows.reset()
    with pytest.raises(ActionError, match=r"shape \(4, 2\), one row per robot; got"):
        rows.step(np.zeros(shape))
    with pytest.raises(ConfigError, match="seed must be a whole number of at least 0; got '1'"):
        TeamVecEnv(2, SMALL, seed="1")


@pytest.mark.parametrize("actions", [None, "forward", [[0.1], [0.1, 0.2]]], ids=["None", "text", "ragged"])
def test_rows_of_actions_that_are_no_array_of_numbers_are_named_in_one_line(actions):
    rows = TeamVecEnv(2, SMALL)
    rows.reset()
    with pytest.raises(ActionError, match=rf"shape \(4, 2\), one row per robot; got {type(actions).__name__}"):
        rows.step(actions)


@pytest.mark.parametrize("config", [SMALL, FLAT], ids=["dict", "flat"])
def test_rows_say_that_the_time_limit_ended_an_episode_what_was_seen_last_and_what_it_paid(config):
    config = {**config, "max_cycles": 3}
    rows, alone = TeamVecEnv(2, config, seed=4), twc_env.parallel_env(config=config)
    rows.reset()
    alone.reset(seed=5)  # the second environment, whose robots are rows 2 and 3
    paid = 0.0
    for step in range(3):
        _, rewards, done, infos = rows.step(np.full((4, 2), 0.5, np.float32))
        seen, *_ = alone.step(dict.fromkeys(alone.agents, np.full(2, 0.5, np.float32)))
        paid = paid + rewards
        assert done.tolist() == [step == 2] * 4 and ["TimeLimit.truncated" in info for info in infos] == done.tolist()
    assert all(info["TimeLimit.truncated"] is True for info in infos)
    assert [info["episode"]["l"] for info in infos] == [3] * 4
    assert [info["episode"]["r"] for info in infos] == pytest.approx(paid.tolist())
    assert same([info["terminal_observation"] for info in infos[2:]], list(seen.values()))
    *_, infos = rows.step(np.zeros((4, 2), np.float32))
    assert not any("episode" in info for info in infos)


def test_options_of_a_reset_are_refused_where_no_row_could_follow_them():
    rows = TeamVecEnv(2, SMALL)
    for nothing in (None, {}, [{}] * 4):
        rows.set_options(nothing)
    for options in ({"split": "test"}, [{}, {}, {}, {"starts": "map"}]):
        with pytest.raises(AttributeError, match="take no options; got"):
            rows.set_options(options)


@pytest.mark.parametrize("kind", ["dict", "flat"])
def test_rows_say_what_may_be_chosen_as_maskable_policies_ask_for_it(kind):
    from stable_baselines3.common.vec_env import VecFrameStack

    teams = TeamVecEnv(2, {**CHOICES, "max_cycles": 900, "observation.kind": kind})
    rows = VecFrameStack(teams, 2)
    assert rows.has_attr("action_masks")
    rows.reset()
    for _ in range(3):
        *_, infos = rows.step(teams.teams.sample().reshape(-1))
        masks = np.stack(rows.env_method("action_masks"))
        assert masks.dtype == bool and not masks.all() and masks.any(axis=1).all()
        wanted = np.stack([info["action_mask"] for info in infos]) > 0
        assert np.array_equal(masks, wanted)
    assert np.array_equal(rows.env_method("action_masks", indices=[2]), masks[2:3])
    rows.close()
    with pytest.raises(ConfigError, match=r"action\.kind must be 'frontier'; it is 'velocity'"):
        TeamVecEnv(1, SMALL).env_method("action_masks")


def test_sb3_contrib_learns_with_masks():
    pytest.importorskip("sb3_contrib", reason="needs sb3-contrib")
    from sb3_contrib import MaskablePPO

    rows = TeamVecEnv(2, CHOICES)
    model = MaskablePPO("MultiInputPolicy", rows, n_steps=16, batch_size=32, n_epochs=1, seed=0, device="cpu")
    model.learn(64)
    allowed = model.rollout_buffer.action_masks.astype(bool)
    chosen = model.rollout_buffer.actions.astype(int)
    assert model.num_timesteps == 64
    assert allowed.shape == (len(chosen), rows.action_space.n)
    assert not allowed.all(axis=1).any(), "masks of the environments, not of ones"
    assert np.take_along_axis(allowed, chosen, axis=1).all()
    rows.close()


@pytest.mark.parametrize(
    ("policy", "config"), [("MultiInputPolicy", CHOICES), ("MlpPolicy", {**SMALL, "observation.kind": "flat"})]
)
def test_stable_baselines_trains_one_policy_on_rows_of_robots(policy, config):
    from stable_baselines3 import PPO

    rows = TeamVecEnv(2, config, seed=3)
    assert rows.num_envs == 4
    model = PPO(policy, rows, n_steps=32, batch_size=32, n_epochs=1, seed=0, device="cpu")
    before = [p.detach().clone() for p in model.policy.parameters()]
    model.learn(128)
    assert model.num_timesteps == 128
    assert any(bool((a != b).any()) for a, b in zip(before, model.policy.parameters(), strict=True))
    assert len(model.ep_info_buffer) >= 2
    rows.close()
