import dataclasses
import gc
import pickle
import weakref
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import pettingzoo
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import api_test, max_cycles_test, parallel_api_test, parallel_seed_test, seed_test, state_test
from pettingzoo.utils.wrappers import TerminateIllegalWrapper

import twc_env

ID = "twc/Explore-v0"
ROBOTS = [1, 2, 3]


def still(env) -> dict:
    return {agent: np.zeros(2, np.float32) for agent in env.agents}


@pytest.mark.parametrize("robots", ROBOTS)
def test_pettingzoo_accepts_the_parallel_environment(robots):
    parallel_api_test(twc_env.parallel_env(robots=robots, max_cycles=40), num_cycles=100)


@pytest.mark.filterwarnings(  # the observation is a Dict, which PettingZoo allows
    "ignore:Observation is not a NumPy array", "ignore:Observation space for each agent probably should be"
)
@pytest.mark.parametrize("robots", ROBOTS)
def test_pettingzoo_accepts_the_turn_based_environment(robots):
    api_test(twc_env.env(robots=robots, max_cycles=40), num_cycles=60)


def test_pettingzoo_seed_tests_pass():
    seed_test(lambda: twc_env.env(max_cycles=30), num_cycles=30)
    parallel_seed_test(lambda: twc_env.parallel_env(max_cycles=30), num_cycles=30)


def test_pettingzoo_max_cycles_test_passes():
    max_cycles_test(twc_env)


def test_pettingzoo_state_test_passes():
    state_test(twc_env.env(max_cycles=30), twc_env.parallel_env(max_cycles=30), num_cycles=20)


def test_gymnasium_accepts_the_single_agent_environment():
    check_env(gymnasium.make(ID, max_cycles=40).unwrapped, skip_render_check=True)


def test_stable_baselines_accepts_the_single_agent_environment():
    checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="needs the extra 'train'")
    checker.check_env(gymnasium.make(ID, max_cycles=40).unwrapped, warn=False, skip_render_check=True)


def test_both_registries_make_the_environment_by_its_id():
    parallel = pettingzoo.make("parallel", ID, robots=2, max_cycles=5)
    turns = pettingzoo.make("aec", ID, robots=2, max_cycles=5)
    assert parallel.possible_agents == turns.possible_agents == ["robot_0", "robot_1"]
    observations, _ = parallel.reset(seed=3)
    turns.reset(seed=3)
    for agent in parallel.possible_agents:
        assert np.array_equal(turns.observe(agent)["lidar"], observations[agent]["lidar"])
    parallel_api_test(parallel, num_cycles=10)


def test_the_single_agent_environment_equals_a_team_of_one(same):
    single = gymnasium.make(ID, robots=1, max_cycles=20)
    team = twc_env.parallel_env(robots=1, max_cycles=20)
    action = np.array([0.7, 0.2], np.float32)
    assert same(single.reset(seed=4)[0], team.reset(seed=4)[0]["robot_0"])
    for _ in range(20):
        seen, reward, terminated, truncated, _ = single.step(action)
        observations, rewards, terminations, truncations, _ = team.step({"robot_0": action})
        assert same(seen, observations["robot_0"])
        assert (reward, terminated, truncated) == tuple(of["robot_0"] for of in (rewards, terminations, truncations))
    assert truncated
    assert single.unwrapped.result().figures == team.result().figures


def test_the_single_agent_environment_accepts_numpy_seeds_and_rejects_invalid_ones(same):
    single = gymnasium.make("twc/Explore-v0", max_cycles=5)
    assert same(single.reset(seed=np.int64(4))[0], single.reset(seed=4)[0])
    for seed in (-1, np.int64(-1), 0.5):
        with pytest.raises(twc_env.ConfigError, match="seed must be a whole number of at least 0"):
            single.reset(seed=seed)


@pytest.mark.parametrize(
    ("arguments", "remedy"),
    [
        ({"robots": 3}, r"robots=3: this is the view of one robot; a team is twc_env\.parallel_env\(robots=3\)"),
        ({"config": {"robots": 3}}, "config asks for 3 robots, .* also give robots=1 for the first"),
        ({"config": {"team": "turtlebots"}}, "config asks for 3 robots"),
        ({"max_cycle": 9}, "unexpected keyword argument 'max_cycle'; .* did you mean max_cycles"),
        ({"beams": 90}, "unexpected keyword argument 'beams'; .* settings go into config"),
    ],
)
def test_the_error_of_the_single_agent_environment_for_unknown_arguments_names_the_remedy(arguments, remedy):
    with pytest.raises(twc_env.ConfigError, match=remedy):
        gymnasium.make(ID, **arguments)


def test_the_first_robot_of_a_team_s_settings_plays_alone_if_asked():
    single = gymnasium.make(ID, robots=1, config={"team": "turtlebots"})
    assert single.unwrapped.parallel.possible_agents == ["robot_0"]


@pytest.mark.parametrize("make", [twc_env.parallel_env, twc_env.env, partial(pettingzoo.make, "parallel", ID)])
def test_the_error_of_an_unknown_argument_suggests_the_nearest(make):
    with pytest.raises(twc_env.ConfigError, match=r"argument 'robot'; known are map, .* did you mean robots"):
        make(robot=3)
    with pytest.raises(twc_env.ConfigError, match="settings go into config"):
        make(beams=90)


@pytest.mark.parametrize("robots", ROBOTS)
def test_every_observation_lies_in_its_space(robots, explore):
    log = explore(60, robots=robots)
    for observations in log.observations:
        for agent, observation in observations.items():
            assert log.env.observation_space(agent).contains(observation)


def test_spaces_are_the_same_objects_for_every_agent_and_call():
    env = twc_env.parallel_env(robots=3)
    for space in (env.observation_space, env.action_space):
        assert len({id(space(agent)) for agent in env.possible_agents for _ in range(2)}) == 1


def test_all_agents_are_truncated_together_at_the_last_step():
    env = twc_env.parallel_env(robots=2, max_cycles=6)
    env.reset(seed=0)
    for step in range(6):
        assert env.agents == env.possible_agents
        observations, rewards, terminations, truncations, infos = env.step(still(env))
        for values in (observations, rewards, terminations, truncations, infos):
            assert list(values) == env.possible_agents
        assert not any(terminations.values())
        assert set(truncations.values()) == {step == 5}
    assert env.agents == []


def test_a_step_after_the_end_raises_an_error_that_names_reset():
    env = twc_env.parallel_env(robots=1, max_cycles=1)
    env.reset(seed=0)
    env.step(still(env))
    with pytest.raises(twc_env.TwcError, match="a running episode, and this one is over: call reset") as caught:
        env.step({})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "use",
    [
        lambda env: env.step({"robot_0": np.zeros(2)}), lambda env: env.belief("robot_0"), lambda env: env.result(),
        lambda env: env.state(), lambda env: env.snapshot(), lambda env: env.frames, lambda env: env.contacts,
        lambda env: env.episode, lambda env: env.engine, lambda env: env.np_random,
    ],
)  # fmt: skip
def test_access_to_the_episode_before_the_first_reset_raises(use):
    with pytest.raises(twc_env.TwcError, match="call reset"):
        use(twc_env.parallel_env(robots=1))


def test_an_unfinished_episode_can_be_reset(same):
    env = twc_env.parallel_env(robots=2, max_cycles=50)
    first, _ = env.reset(seed=1)
    for _ in range(7):
        env.step(still(env))
    again, _ = env.reset(seed=1)
    assert env.agents == env.possible_agents
    assert all(same(first[agent], again[agent]) for agent in first)
    twice, _ = env.reset(seed=1)
    assert all(same(first[agent], twice[agent]) for agent in first)


@pytest.mark.parametrize(
    "config", [{}, {"action.kind": "frontier", "observation.overview": True}, {"slam.mode": "off"}]
)
def test_a_reset_frees_the_last_episode_without_garbage_collection(config):
    env = twc_env.parallel_env(map="gen:office:100:1", max_cycles=20, config=config)
    env.reset(seed=0)
    env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    left = weakref.ref(env.episode), weakref.ref(env.belief("robot_0").grid.log_odds)
    collects = gc.isenabled()
    gc.disable()
    try:
        env.reset(seed=1)
        assert [what() is None for what in left] == [True, True]
    finally:
        (gc.enable if collects else gc.disable)()


def test_without_a_seed_episodes_follow_deterministically_from_the_first(same):
    env, twin = twc_env.parallel_env(robots=1), twc_env.parallel_env(robots=1)
    first, second = env.reset(seed=5)[0], env.reset()[0]
    assert not same(first["robot_0"], second["robot_0"])
    twin.reset(seed=5)
    assert same(second["robot_0"], twin.reset()[0]["robot_0"])


@pytest.mark.parametrize("options", [None, {}, {"unknown": 1}, {"starts": "map"}, {"starts": "random"}])
def test_unknown_reset_options_are_ignored(options):
    observations, infos = twc_env.parallel_env(robots=2).reset(seed=0, options=options)
    assert list(observations) == list(infos) == ["robot_0", "robot_1"]


def test_robots_start_at_the_poses_in_the_options():
    env = twc_env.parallel_env(robots=2)
    starts = [(9.0, 1.2, 0.5), (9.8, 1.2, -1.0)]
    env.reset(seed=0, options={"starts": starts})
    assert np.allclose(env.episode.record.true_poses[0], starts)


def test_the_building_of_one_episode_does_not_affect_later_ones(same):
    env = twc_env.parallel_env(robots=1)
    settings, (first, _) = env.config, env.reset(seed=3)
    for split in ("train", "validation", "test"):
        env.reset(seed=3, options={"split": split})
        assert env.floorplan.name.startswith(f"{split}/")
        assert env.config == settings
    again, _ = env.reset(seed=3)
    assert env.floorplan.name == "twin-01" and same(first["robot_0"], again["robot_0"])


@pytest.mark.parametrize("config", ["mine.toml", Path("mine.toml")])
def test_the_error_of_a_file_name_as_config_names_load(config):
    with pytest.raises(twc_env.ConfigError, match=r"twc_env\.config\.load reads a file"):
        twc_env.parallel_env(config=config)


@pytest.mark.parametrize("starts", ["anywhere", ["map"], [[1, 2, 3]], [[1, 2, 3], [4]], None, [[0, 0, np.nan]] * 2])
def test_invalid_starts_are_rejected(starts):
    with pytest.raises(twc_env.ConfigError, match="starts must be"):
        twc_env.parallel_env(robots=2).reset(seed=0, options={"starts": starts})


@pytest.mark.parametrize(
    "options", ["x", 5, [], {"split": ["train"]}, {"split": None}, {"map": "a", "split": "train"}, {"maps": "a"}]
)
def test_invalid_reset_options_are_rejected(options):
    with pytest.raises(twc_env.TwcError, match=r"options|split"):
        twc_env.parallel_env(robots=2).reset(seed=0, options=options)


@pytest.mark.parametrize("options", [{"map": "twin-02", "starts": "anywhere"}, {"map": "nowhere"}])
def test_no_episode_is_running_after_a_failed_reset(options, same):
    env, twin = (twc_env.parallel_env(robots=2, max_cycles=5) for _ in range(2))
    env.reset(seed=0)
    with pytest.raises(twc_env.TwcError):
        env.reset(seed=1, options=options)
    assert env.agents == []
    for call in (lambda: env.step({}), env.result, env.state, env.snapshot, lambda: env.frames):
        with pytest.raises(twc_env.TwcError, match="reset"):
            call()
    assert same(env.reset(seed=2)[0]["robot_0"], twin.reset(seed=2)[0]["robot_0"])


@pytest.mark.parametrize("agent", ["robot_2", 0, None])
def test_the_error_of_a_belief_of_an_unknown_agent_lists_the_team(agent):
    env = twc_env.parallel_env(robots=2)
    env.reset(seed=0)
    with pytest.raises(twc_env.TwcError, match="the team is robot_0, robot_1"):
        env.belief(agent)


def test_settings_with_non_string_keys_are_rejected():
    with pytest.raises(twc_env.ConfigError, match="named by text"):
        twc_env.parallel_env(config={3: 4})


def test_an_unknown_render_mode_is_rejected():
    with pytest.raises(twc_env.ConfigError, match="rgb_array"):
        twc_env.parallel_env(render_mode="ascii")


def test_rendering_does_not_change_the_episode(explore, same):
    plain, drawn = explore(1), explore(1, render_mode="rgb_array")
    for step in range(30):
        actions = {agent: np.array([0.8, 0.3 * (step % 3)], np.float32) for agent in plain.env.agents}
        picture = drawn.env.render()
        with pytest.warns(UserWarning, match="render_mode='rgb_array' or 'human'"):
            assert plain.env.render() is None
        assert picture.dtype == np.uint8
        a, b = plain.env.step(actions), drawn.env.step(actions)
        assert all(same(a[0][agent], b[0][agent]) for agent in a[0])
        assert a[1] == b[1]


def test_the_error_of_an_invalid_floorplan_names_the_remedy():
    with pytest.raises(twc_env.ConfigError, match="must be a Floorplan; got 'twin-01': name a map or a file as `map`"):
        twc_env.parallel_env(floorplan="twin-01")


def test_np_random_follows_the_seed_and_does_not_affect_the_episode(same):
    env, other = (twc_env.parallel_env(map="twin-01", robots=1, max_cycles=6) for _ in range(2))
    env.reset(seed=3)
    other.reset(seed=3)
    drawn = env.np_random.random(5).tolist()
    moment, later = env.snapshot(), env.np_random.random(5).tolist()
    env.restore(moment)
    assert env.np_random.random(5).tolist() == later
    assert other.np_random.random(10).tolist() == drawn + later
    env.reset(seed=3)
    env.np_random.random(100)
    action = {"robot_0": np.array([0.5, 0.5])}
    assert same(env.step(action)[0]["robot_0"], other.step(action)[0]["robot_0"])


@pytest.mark.parametrize("space", ["observation_space", "action_space"])
def test_the_space_of_an_unknown_agent_is_refused_with_the_known_ones(space):
    env = twc_env.parallel_env(robots=2)
    with pytest.raises(twc_env.ConfigError, match="agents are robot_0, robot_1; got 'robot_7'"):
        getattr(env, space)("robot_7")


CHOICES = {"robots": 2, "max_cycles": 30, "config": {"action.kind": "frontier", "lidar.beam_count": 60}}


def test_an_illegal_choice_ends_the_game_under_the_wrapper_of_pettingzoo():
    env = TerminateIllegalWrapper(twc_env.env(**CHOICES), illegal_reward=-1)
    env.reset(seed=0)
    rewards = {}
    for agent in env.agent_iter(20):
        observation, rewards[agent], terminated, truncated, _ = env.last()
        env.step(None if terminated or truncated else int(np.argmin(observation["action_mask"])))
    assert not env.agents
    assert rewards == {"robot_0": -1.0, "robot_1": 0}


def test_the_turn_based_environment_has_what_the_parallel_one_has(same):
    turns, parallel = twc_env.env(**CHOICES).unwrapped, twc_env.parallel_env(**CHOICES)
    turns.reset(seed=1)
    parallel.reset(seed=1)
    assert same(turns.result().figures, parallel.result().figures)
    assert turns.config == parallel.config
    with pytest.raises(AttributeError, match="no_such_thing"):
        _ = turns.no_such_thing


def test_the_results_of_a_given_plan_bear_its_name():
    plan = twc_env.load_map("gen:office:100:3")
    env = twc_env.parallel_env(floorplan=plan, robots=1)
    env.reset(seed=0)
    assert env.result()["map"] == env.config.map == plan.name
    mine = twc_env.parallel_env(map="mine", floorplan=plan)
    assert mine.config.map == pickle.loads(pickle.dumps(mine)).config.map == "mine"
    assert twc_env.parallel_env(floorplan=dataclasses.replace(plan, name="")).config.map == "unnamed"


def test_a_setting_beside_a_preset_goes_before_it_nested_or_dotted():
    for beside in ({"lidar": {"beam_count": 90}}, {"lidar.beam_count": 90}):
        for task in (None, "twc/Explore-v0"):
            lidar = twc_env.parallel_env(task=task, config={"lidar.preset": "rplidar-a1", **beside}).config.lidar
            assert (lidar.beam_count, lidar.range_max_m) == (90, 12.0)


@pytest.mark.parametrize("name", ["max_cycles", "lidar.beam_count", "config", "task", "world"])
def test_settings_are_no_options_of_a_reset(name):
    env = twc_env.parallel_env(robots=1)
    with pytest.raises(twc_env.ConfigError, match=f"no '{name}': settings hold for all episodes"):
        env.reset(seed=0, options={name: 5})
    with pytest.raises(twc_env.ConfigError, match="did you mean 'map'"):
        env.reset(seed=0, options={"Map": "twin-02"})
    env.reset(seed=0, options={"of another environment": 1})


@pytest.mark.parametrize("kind", ["velocity", "frontier"])
def test_the_time_that_is_left_is_observed_on_request(kind):
    settings = {"observation.time_left": True, "action.kind": kind, "lidar.beam_count": 36}
    env = twc_env.parallel_env(robots=2, max_cycles=40, config=settings)
    seen, _ = env.reset(seed=0)
    left = [seen["robot_1"]["time_left"].item()]
    while env.agents:
        actions = {agent: env.action_space(agent).sample() for agent in env.agents}
        seen, *_ = env.step(actions)
        assert seen["robot_1"] in env.observation_space("robot_1")
        left.append(seen["robot_1"]["time_left"].item())
        assert left[-1] == pytest.approx(1.0 - env.episode.steps / 40)
    assert left[0] == 1.0 and left[-1] == 0.0
    flat = twc_env.parallel_env(robots=1, config={**settings, "observation.kind": "flat"})
    assert flat.observation_space("robot_0").shape[0] > 0
    assert "time_left" not in twc_env.parallel_env(robots=1).observation_space("robot_0").spaces


def test_gains_without_frontiers_are_refused():
    with pytest.raises(twc_env.ConfigError, match=r"for each of observation\.frontiers"):
        twc_env.parallel_env(config={"observation.gains": True})
