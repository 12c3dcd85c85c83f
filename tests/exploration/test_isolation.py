import copy
import pickle

import gymnasium
import numpy as np
import pytest

import twc_env

SETTINGS = {"lidar.beam_count": 90, "robots": 2, "max_cycles": 60, "odometry.drift": 0.5, "reward.collision": -0.25}
COPIES = [copy.deepcopy, copy.copy, lambda env: pickle.loads(pickle.dumps(env))]
copied = pytest.mark.parametrize("copy_of", COPIES, ids=["deepcopy", "copy", "pickle"])


def play(env, steps: int = 15, seed: int = 0) -> list:
    """Run a short episode; returns observations and rewards."""
    env.reset(seed=seed)
    return [go_on(env, step) for step in range(steps)]


def go_on(env, step: int):
    action = np.array([0.8, 0.5 * np.sin(0.4 * step)], np.float32)
    return env.step(dict.fromkeys(env.agents, action))[:2]


@copied
def test_a_copy_keeps_config_and_behaviour(copy_of, same_steps):
    env = twc_env.parallel_env(map="twin-02", config=SETTINGS, render_mode="rgb_array")
    twin = copy_of(env)
    assert twin.config == env.config
    assert twin.config.lidar.beam_count == 90
    assert (twin.render_mode, twin.possible_agents) == (env.render_mode, env.possible_agents)
    assert twin.floorplan.digest == env.floorplan.digest
    assert twin.observation_space("robot_0") == env.observation_space("robot_0")
    assert same_steps(play(env), play(twin))


@copied
def test_a_copy_keeps_a_floorplan_passed_as_an_object(copy_of, same_steps):
    plan = twc_env.load_map("twin-01").moved(np.array([4.0, 3.0, 0.5]))
    env = twc_env.parallel_env(floorplan=plan, robots=1)
    twin = copy_of(env)
    assert np.array_equal(twin.floorplan.walls_m, plan.walls_m)
    assert same_steps(play(env), play(twin))


@copied
def test_copying_does_not_change_a_running_episode(copy_of, same_steps):
    env, untouched = (twc_env.parallel_env(config=SETTINGS) for _ in range(2))
    play(env, 10)
    play(untouched, 10)
    twin = copy_of(env)
    play(twin, 5, seed=9)
    assert same_steps([go_on(env, s) for s in range(10)], [go_on(untouched, s) for s in range(10)])


@copied
def test_later_changes_of_the_settings_dict_do_not_affect_copies(copy_of):
    settings = {"lidar": {"beam_count": 90}, "robots": 2}
    env = twc_env.parallel_env(config=settings)
    settings["robots"] = 5
    settings["lidar"]["beam_count"] = 8
    assert env.config.robots == 2
    assert copy_of(env).config == env.config


def test_wrapped_environments_can_be_copied_too(same):
    single = gymnasium.make("twc/Explore-v0", max_cycles=30, config={"lidar.beam_count": 90})
    twin = copy.deepcopy(single)
    assert same(single.reset(seed=1)[0], twin.reset(seed=1)[0])
    turns = twc_env.env(config=SETTINGS)
    other = pickle.loads(pickle.dumps(turns))
    for env in (turns, other):
        env.reset(seed=1)
    assert same(turns.observe("robot_0"), other.observe("robot_0"))


def test_a_dict_of_settings_is_not_modified():
    settings = {"lidar": {"beam_count": 90}, "odometry.drift": 0.5}
    before = copy.deepcopy(settings)
    twc_env.parallel_env(config=settings, robots=1)
    assert settings == before


def test_other_environments_do_not_affect_an_episode(same_steps):
    alone = twc_env.parallel_env(config=SETTINGS)
    expected = play(alone)
    env = twc_env.parallel_env(config=SETTINGS)
    env.reset(seed=0)
    found = []
    for step in range(15):
        other = twc_env.parallel_env(map="twin-01", robots=1 + step % 3, config={"lidar.beam_count": 45})
        other.reset(seed=step)
        go_on(other, step)
        found.append(go_on(env, step))
    assert same_steps(expected, found)


def test_metadata_are_not_shared_between_environments():
    first, second = twc_env.parallel_env(robots=1), twc_env.parallel_env(robots=1)
    first.metadata["render_fps"] = 99
    first.metadata["render_modes"].append("planted")
    third = twc_env.parallel_env(robots=1)
    for metadata in (second.metadata, third.metadata, twc_env.ExplorationEnv.metadata):
        assert metadata["render_fps"] != 99
        assert "planted" not in metadata["render_modes"]


def test_spaces_are_not_shared_between_environments():
    first, second = twc_env.parallel_env(robots=1), twc_env.parallel_env(robots=1)
    for name in ("action_space", "observation_space"):
        assert getattr(first, name)("robot_0") is not getattr(second, name)("robot_0")
        assert getattr(first, name)("robot_0") == getattr(second, name)("robot_0")


def test_an_episode_does_not_modify_the_floorplan():
    plan = twc_env.load_map("twin-01")
    before = pickle.dumps(plan)
    play(twc_env.parallel_env(floorplan=plan, robots=2))
    assert pickle.dumps(plan) == before


def test_overwriting_observations_and_actions_does_not_affect_the_episode(same):
    env, untouched = (twc_env.parallel_env(config=SETTINGS) for _ in range(2))
    first = env.reset(seed=0)[0]
    untouched.reset(seed=0)
    seen = first
    for step in range(15):
        for observation in seen.values():
            for array in observation.values():
                array[...] = 1
        action = np.array([0.8, 0.2], np.float32)
        seen, rewards, *_ = env.step(dict.fromkeys(env.agents, action))
        expected, expected_rewards, *_ = untouched.step(
            dict.fromkeys(untouched.agents, np.array([0.8, 0.2], np.float32))
        )
        action[...] = -1
        assert all(same(seen[agent], expected[agent]) for agent in seen), step
        assert rewards == expected_rewards


def test_observations_of_earlier_steps_do_not_change():
    env = twc_env.parallel_env(config=SETTINGS)
    kept = [env.reset(seed=0)[0]]
    before = [copy.deepcopy(kept[0])]
    for step in range(12):
        observations, _ = go_on(env, step)
        kept.append(observations)
        before.append(copy.deepcopy(observations))
    for now, then in zip(kept, before, strict=True):
        for agent in now:
            assert all(np.array_equal(now[agent][key], then[agent][key]) for key in now[agent])


def test_overwriting_a_belief_is_impossible_or_does_not_affect_the_episode(same_steps):
    env, untouched = (twc_env.parallel_env(config=SETTINGS) for _ in range(2))
    play(env, 8)
    play(untouched, 8)
    belief = env.belief("robot_0")
    for array in (belief.grid.log_odds, belief.grid.origin_m, belief.pose_map_robot, belief.ranges_m):
        if array.flags.writeable:
            array[...] = 7
    assert same_steps([go_on(env, s) for s in range(8)], [go_on(untouched, s) for s in range(8)])


def test_the_map_of_a_belief_goes_on_and_a_deep_copy_keeps_its_moment():
    env = twc_env.parallel_env(map="twin-01", robots=2, config={"lidar.beam_count": 90})
    env.reset(seed=3)
    ahead = dict.fromkeys(env.agents, np.array([0.5, 0.2], np.float32))
    belief = env.belief("robot_0")
    kept, seen = copy.deepcopy(belief), belief.grid.log_odds.copy()
    for _ in range(30):
        env.step(ahead)
    assert np.array_equal(kept.grid.log_odds, seen)
    assert not np.array_equal(belief.grid.log_odds, seen) and not belief.grid.log_odds.flags.writeable
