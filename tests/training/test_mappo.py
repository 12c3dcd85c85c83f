"""Multi-agent PPO: its advantages in time, and what it sees."""

from dataclasses import replace

import numpy as np
import pytest

from twc_env.errors import DataError

pytestmark = pytest.mark.usefixtures("torch")


@pytest.fixture(scope="module")
def tiny(torch):
    from twc_env.training.mappo import Settings

    return Settings(
        seed=3, steps=120, environments=2, workers=0, rollout_steps=8, epochs=2, minibatches=2, hidden_size=8
    )


@pytest.fixture(scope="module")
def play(torch):
    from twc_env.training.mappo import train

    return lambda task, settings, folder, resume=False: train(task, settings, folder, resume, show_progress=False)


@pytest.fixture(scope="module")
def whole(play, task, tiny, tmp_path_factory):
    """A run that was not interrupted."""
    folder = tmp_path_factory.mktemp("mappo")
    play(task, tiny, folder)
    return folder


def decision(reward, time_steps, is_last=False):
    from twc_env.training.mappo import Decision

    return Decision({}, 0, 0, 0.0, reward, time_steps, is_last)


def test_advantages_discount_each_decision_by_its_duration_and_stop_at_the_end_of_an_episode(tiny):
    from twc_env.training.mappo import Learner

    learner = object.__new__(Learner)
    learner._settings, learner._discount = replace(tiny, gae_lambda=0.9), 0.99
    first = [decision(1.0, 10), decision(0.5, 30, is_last=True), decision(0.2, 5)]
    second = [decision(0.3, 7)]
    values = np.array([0.4, 0.6, 0.1, 0.2])
    found = learner._advantages([first, [], second], values, [0.8, None, None])
    end = 0.5 - 0.6
    after = 0.2 + 0.99**5 * 0.8 - 0.1
    assert found == pytest.approx([1.0 + 0.99**10 * 0.6 - 0.4 + 0.99**10 * 0.9 * end, end, after, 0.3 - 0.2])


def test_a_decision_earns_what_is_rewarded_until_the_next_one_of_the_same_robot(task, tiny):
    from twc_env.training.mappo import Rollouts

    settings = replace(tiny, discount=1.0, rollout_steps=30)
    task = replace(task, overrides={**task.overrides, "action.timing": "synchronous", "action.decision_max_s": 1.0})
    rollouts = Rollouts(task, settings)
    rollouts.begin()
    mask = rollouts._seen["action_mask"]
    sequences, episodes = rollouts.collect(lambda seen: np.zeros(seen["action_mask"].shape), 0)
    rollouts.close()
    assert mask.shape[:2] == (2, 2) and len(sequences) == 4 and len(episodes) >= 2
    for own in sequences:
        lengths, scores = [0], [0.0]
        for each in own:
            lengths[-1] += each.time_steps
            scores[-1] += each.reward
            assert 0 < each.time_steps <= 80 and each.seen["action_mask"][each.action] == 1
            if each.is_last:
                lengths.append(0)
                scores.append(0.0)
        assert all(length == 80 for length in lengths[:-1]), "robots decide from the first step to the last"
        played = [episode["score"] for episode in episodes]
        assert all(min(abs(score - each) for each in played) < 1e-6 for score in scores[:-1])


def test_the_state_is_seen_from_the_robot_that_decides():
    from twc_env.training.mappo import state_of

    state = np.array([[1.0, 1.0, np.pi / 2, 0, 0, 0, 1.0, 4.0, 0.0, 0, 0, 0]])
    first, second = state_of(state, np.array([0]))[0]
    assert first.tolist() == pytest.approx([0, 0, 1, 0, 0, 0, 1, 0])
    assert second[[0, 1, 2, 3, 6, 7]] == pytest.approx([3 / 13, 0, 0, -1, 0, 3 / 13], abs=1e-6)


def test_another_task_or_algorithm_is_not_resumed(play, task, tiny, whole, run):
    with pytest.raises(DataError, match=r"was trained with --robots 2 instead of 3; use the same settings"):
        play(replace(task, robots=3), tiny, whole, resume=True)
    with pytest.raises(
        DataError, match=r"was trained with --area 100\.0 instead of 300\.0, --set .*; use the same settings"
    ):
        play(replace(task, area_m2=300.0, overrides={"lidar.beam_count": 90}), tiny, whole, resume=True)
    with pytest.raises(DataError, match=r"was trained with ppo instead of mappo; use the same"):
        play(task, tiny, run, resume=True)


def test_the_critic_sees_the_truth_and_the_shipped_policy_does_not(whole, weights_of):
    names = {name.partition(".")[0] for name in weights_of(whole)}
    assert names == {"actor", "critic", "optimizer", "rollouts"}
    actor = [name for name in weights_of(whole) if name.startswith("actor.")]
    assert actor and not any("state" in name or "gained" in name or "robot" in name for name in actor)


@pytest.mark.parametrize("name", ["twc/ExploreFrontier-v0", "twc/ExploreFrontierAsync-v0", "twc/ExploreQuick-v1"])
@pytest.mark.parametrize("algorithm", ["mappo", "ppo"])
def test_registered_tasks_are_trained_in_their_own_settings(algorithm, name, tmp_path):
    from twc_env.training import mappo, ppo
    from twc_env.training.run_folder import Task

    task = Task(name, max_cycles=40, overrides={"lidar.beam_count": 60})
    expected = "views" if name.endswith("-v1") else "frontiers"
    assert (task.config.action.kind, task.config.action.goals) == ("frontier", expected)
    module = {"mappo": mappo, "ppo": ppo}[algorithm]
    settings = module.Settings(steps=8, environments=1, workers=0, rollout_steps=4, epochs=1, hidden_size=8)
    assert module.train(task, settings, tmp_path, show_progress=False).exists()


def test_held_out_buildings_of_a_task_are_those_of_its_splits():
    from twc_env.training.run_folder import Task

    task = Task("twc/ExploreOffice-v1")
    assert task.training_maps == ()
    assert task.held_out(7) == {"map": "gen:office+ward+ring:2000:test/0007"}
    assert task.held_out(7, "validation") == {"map": "gen:office+ward+ring:2000:validation/0007"}
    assert Task("twc/ExploreFrontier-v0").held_out(3) == {"map": Task("twc/ExploreFrontier-v0").config.map}
