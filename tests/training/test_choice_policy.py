"""Inputs of the choice policy, and its action mask."""

import numpy as np
import pytest

pytestmark = pytest.mark.usefixtures("torch")


def test_a_masked_choice_is_never_taken(task, run, policy_of):
    from twc_env.training.run_folder import read_settings, task_of

    model = policy_of(run)
    observation = {
        name: np.zeros((1, *space.shape), space.dtype) for name, space in model.observation_space.spaces.items()
    }
    assert task_of(read_settings(run)) == task
    for only in range(observation["action_mask"].shape[1]):
        observation["action_mask"][:] = 0
        observation["action_mask"][0, only] = 1
        for deterministic in (True, False):
            assert model.predict(observation, deterministic=deterministic)[0].tolist() == [only]


def test_the_policy_scores_each_choice_by_its_own_features(run, policy_of, torch):
    policy = policy_of(run)
    seen = {k: np.zeros((1, *s.shape), s.dtype) for k, s in policy.observation_space.items()}
    random = np.random.default_rng(0)
    seen["frontiers"] = random.uniform(-1, 1, seen["frontiers"].shape).astype(np.float32)
    seen["action_mask"][0, [0, 2, 5, -1]] = 1

    def chances(seen):
        tensors, _ = policy.obs_to_tensor(seen)
        return policy.get_distribution(tensors).distribution.probs[0].detach()

    first = chances(seen)
    assert first[[0, 2, 5, -1]].sum() == pytest.approx(1.0)
    swapped = {**seen, "frontiers": seen["frontiers"].copy()}
    swapped["frontiers"][0, [0, 5]] = seen["frontiers"][0, [5, 0]]
    assert torch.allclose(chances(swapped)[[5, 0]], first[[0, 5]], atol=1e-6)


def test_the_return_so_far_affects_the_value_but_not_the_policy(run, policy_of, torch):
    policy = policy_of(run)
    seen = {k: np.zeros((1, *s.shape), s.dtype) for k, s in policy.observation_space.items()}
    seen["action_mask"][:] = 1
    poor, rich = (policy.obs_to_tensor({**seen, "gained": np.array([[x]], np.float32)})[0] for x in (0.0, 0.8))
    logits = [policy.get_distribution(tensors).distribution.logits for tensors in (poor, rich)]
    assert torch.equal(*logits)
    assert not torch.equal(policy.predict_values(poor), policy.predict_values(rich))
