"""Other tools (gymnasium, TorchRL, RLlib, stable-baselines3) accept the environment: each runs a few steps."""

import importlib
import pickle
from functools import partial

import gymnasium
import numpy as np
import pytest

import twc_env
from twc_env.errors import ConfigError, DataError
from twc_env.vector.without_infos import WithoutInfos

ID = "twc/Explore-v0"
SMALL = {"lidar.beam_count": 60}


def needs(*modules: str, extra: str):
    """The last of these modules; skips the test if one is not installed."""
    found = [pytest.importorskip(name, reason=f"needs the extra {extra!r}") for name in modules]
    return found[-1]


def shown_team(max_cycles=8, config=SMALL):
    return twc_env.parallel_env(robots=2, max_cycles=max_cycles, config=config, render_mode="rgb_array")


def make_alone():
    return gymnasium.make(ID, max_cycles=8, config=SMALL)


@pytest.mark.parametrize("mode", [gymnasium.vector.AutoresetMode.NEXT_STEP, gymnasium.vector.AutoresetMode.SAME_STEP])
def test_gymnasium_vectorises_the_single_agent_environment_with_its_declared_autoreset_mode(mode):
    envs = gymnasium.make_vec(
        ID, 2, "sync", vector_kwargs={"autoreset_mode": mode}, max_cycles=8, config=SMALL, map="twin-01"
    )
    assert envs.metadata["autoreset_mode"] is mode
    observations, _ = envs.reset(seed=3)
    alone = make_alone()
    assert np.array_equal(observations["lidar"][0], alone.reset(seed=3)[0]["lidar"])
    actions = np.full((2, 2), 0.5, np.float32)
    ends = []
    for _ in range(10):
        observations, rewards, _, truncated, _ = envs.step(actions)
        ends.append(bool(truncated.all()))
        assert rewards.shape == (2,)
    assert [k for k, is_end in enumerate(ends) if is_end] == [7]
    assert envs.observation_space.contains(observations)
    envs.close()


def test_the_spec_of_the_single_agent_environment_has_the_episode_length():
    env = gymnasium.wrappers.TimeAwareObservation(make_alone(), flatten=False, normalize_time=True)
    env.reset(seed=3)
    truncated, shares = False, []
    while not truncated:
        observation, _, _, truncated, _ = env.step(np.zeros(2, np.float32))
        shares.append(float(observation["time"][0]))
    assert shares == [k / 8 for k in range(1, 9)]
    assert gymnasium.make(ID, max_episode_steps=5, config=SMALL).spec.max_episode_steps == 5


def test_action_masks_of_the_single_agent_environment_pass_through_wrappers():
    env = gymnasium.make(ID, max_cycles=400, config={**SMALL, "action.kind": "frontier"})
    observation, _ = env.reset(seed=0)
    for _ in range(2):
        masks = env.get_wrapper_attr("action_masks")()
        assert masks.dtype == bool and np.array_equal(masks, observation["action_mask"] > 0) and not masks.all()
        observation, *_ = env.step(masks.argmax())
    with pytest.raises(ConfigError, match=r"action\.kind must be 'frontier'; it is 'velocity'"):
        alone = make_alone()
        alone.reset(seed=0)
        alone.get_wrapper_attr("action_masks")()


def test_gymnasium_gives_equal_results_with_and_without_worker_processes():
    played = []
    for kind in (gymnasium.vector.SyncVectorEnv, partial(gymnasium.vector.AsyncVectorEnv, context="spawn")):
        envs = kind([make_alone], autoreset_mode=gymnasium.vector.AutoresetMode.NEXT_STEP)
        envs.reset(seed=5)
        for _ in range(4):
            observations, *_ = envs.step(np.full((1, 2), 0.5, np.float32))
        played.append({key: block.copy() for key, block in observations.items()})
        envs.close()
    assert all(np.array_equal(played[0][key], played[1][key]) for key in played[0])


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning", "ignore::FutureWarning")
def test_torchrl_collects_a_rollout_of_a_team():
    needs("torch", "tensordict", extra="torchrl")
    wrapper = needs("torchrl.envs.libs.pettingzoo", extra="torchrl").PettingZooWrapper
    check = importlib.import_module("torchrl.envs.utils").check_env_specs

    team = twc_env.parallel_env(robots=2, max_cycles=8, config=SMALL)
    env = wrapper(team, categorical_actions=True)
    env.set_seed(3)
    rollout = env.rollout(20)
    robots = rollout["next", "robot"]
    assert rollout.batch_size == (8,)
    assert robots["reward"].shape == (8, 2, 1)
    assert robots["observation", "lidar"].shape == (8, 2, 60)
    assert bool(robots["truncated"][-1].all())
    assert float(robots["reward"].sum()) > 0
    check(wrapper(twc_env.parallel_env(robots=2, max_cycles=8, config=SMALL)))
    env.close()


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning", "ignore::FutureWarning")
def test_torchrl_samples_frontiers_within_the_mask():
    needs("torch", "tensordict", extra="torchrl")
    wrapper = needs("torchrl.envs.libs.pettingzoo", extra="torchrl").PettingZooWrapper
    team = twc_env.parallel_env(robots=2, max_cycles=100, config={**SMALL, "action.kind": "frontier"})
    env = wrapper(WithoutInfos(team), categorical_actions=True)
    robots = env.rollout(5)["robot"]
    assert bool(robots["action_mask"].gather(-1, robots["action"][..., None]).all())
    assert not bool(robots["action_mask"].all())
    env.close()


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning", "ignore::FutureWarning")
def test_torchrl_plays_the_turn_based_environment_within_the_mask():
    needs("torch", "tensordict", extra="torchrl")
    wrapper = needs("torchrl.envs.libs.pettingzoo", extra="torchrl").PettingZooWrapper
    team = twc_env.env(robots=2, max_cycles=1000, config={**SMALL, "action.kind": "frontier"})
    env = wrapper(WithoutInfos(team), use_mask=True, categorical_actions=True)
    rollout = env.rollout(5)
    assert rollout.batch_size == (5,)
    for robot, acts in (("robot_0", [1, 0, 1, 0, 1]), ("robot_1", [0, 1, 0, 1, 0])):
        assert rollout[robot, "mask"].flatten().int().tolist() == acts
        assert bool(rollout[robot, "action_mask"].gather(-1, rollout[robot, "action"][..., None]).all())
    env.close()


def test_without_infos_the_turn_based_environment_is_the_same_but_for_its_infos():
    settings = {"robots": 2, "max_cycles": 2, "config": SMALL}
    told, silent = twc_env.env(**settings), WithoutInfos(twc_env.env(**settings))
    for env in (told, silent):
        env.reset(seed=3)
    for _ in silent.agent_iter():
        (seen, *rest, _), (blocks, *others, nothing) = told.last(), silent.last()
        assert rest == others and nothing == {}
        assert all(np.array_equal(seen[name], blocks[name]) for name in seen)
        for env in (told, silent):
            env.step(None if rest[1] or rest[2] else np.full(2, 0.5, np.float32))
    assert not told.agents and not silent.agents


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning", "ignore::FutureWarning")
def test_torchrl_makes_the_single_agent_environment_by_its_id():
    needs("torch", "tensordict", extra="torchrl")
    env = needs("torchrl.envs.libs.gym", extra="torchrl").GymEnv(ID, max_cycles=8, config=SMALL)
    assert env.rollout(20).batch_size == (8,)
    env.close()


@pytest.mark.filterwarnings("ignore")
def test_rllib_runs_a_team():
    needs("ray", "ray.rllib", extra="ray")
    wrapper = needs("ray.rllib.env.wrappers.pettingzoo_env", extra="ray").ParallelPettingZooEnv
    env = wrapper(twc_env.parallel_env(robots=2, max_cycles=8, config=SMALL))
    observations, _ = env.reset(seed=3)
    spaces = env.get_observation_space("robot_0")
    assert set(observations) == {"robot_0", "robot_1"}
    assert all(spaces.contains(observation) for observation in observations.values())
    steps, is_over, paid = 0, False, 0.0
    while not is_over:
        actions = {agent: env.get_action_space(agent).sample() for agent in observations}
        observations, rewards, _, truncations, _ = env.step(actions)
        steps, is_over, paid = steps + 1, truncations["__all__"], paid + sum(rewards.values())
    assert steps == 8
    assert paid > 0
    env.close()


@pytest.mark.parametrize("name", ["map", "overview"])
def test_the_default_cnn_of_stable_baselines3_takes_images_of_36_cells_and_no_smaller_ones(name):
    needs("stable_baselines3", extra="train")
    from stable_baselines3.common.torch_layers import CombinedExtractor

    def channels(cells):
        sizes = {"observation.overview": True, "observation.overview_cells": 36, f"observation.{name}_cells": cells}
        space = twc_env.parallel_env(config=SMALL | sizes).observation_space("robot_0")
        assert space[name].shape[1:] == (cells, cells)
        return CombinedExtractor(space).extractors[name]

    assert channels(36).features_dim == 256
    with pytest.raises(RuntimeError, match="Kernel size"):
        channels(35)


@pytest.mark.filterwarnings("ignore")
def test_gymnasium_records_a_video_of_the_single_agent_environment(tmp_path):
    needs("moviepy", extra="moviepy of gymnasium[other]")
    env = gymnasium.wrappers.RecordVideo(
        gymnasium.make(ID, max_cycles=8, config=SMALL, render_mode="rgb_array"), str(tmp_path), disable_logger=True
    )
    env.reset(seed=0)
    for _ in range(8):
        env.step(np.array([0.5, 0.1], np.float32))
    env.close()
    assert [path.suffix for path in tmp_path.glob("*.mp4")] == [".mp4"]


def test_one_gif_is_written_per_episode(tmp_path):
    image = pytest.importorskip("PIL.Image", reason="needs the extra 'viz'")
    from twc_env.pictures.video import RecordEpisodes

    env = RecordEpisodes(shown_team(), tmp_path / "films", every=2)
    for seed in (0, 1):
        env.reset(seed=seed)
        while env.agents:
            env.step({agent: np.array([0.9, 0.5], np.float32) for agent in env.agents})
    env.reset(seed=2)
    env.close()
    assert sorted(path.name for path in (tmp_path / "films").iterdir()) == ["twin-01-seed0.gif", "twin-01-seed1.gif"]
    with image.open(tmp_path / "films" / "twin-01-seed0.gif") as film:
        assert film.n_frames == 5
        assert film.info["duration"] == 200  # two time steps of a tenth of a second


@pytest.mark.parametrize("api", ["gymnasium", "turns"])
def test_films_of_other_apis_are_refused_with_the_remedy(api, tmp_path):
    import gymnasium

    from twc_env.pictures.video import RecordEpisodes

    made = {
        "gymnasium": lambda: gymnasium.make("twc/Explore-v0", render_mode="rgb_array", disable_env_checker=True),
        "turns": lambda: twc_env.env(robots=2, render_mode="rgb_array"),
    }[api]()
    with pytest.raises(ConfigError, match=r"wrap twc_env\.parallel_env"):
        RecordEpisodes(made, tmp_path)


def test_long_actions_are_recorded_at_every_time_step(tmp_path):
    image = pytest.importorskip("PIL.Image", reason="needs the extra 'viz'")
    from twc_env.pictures.video import RecordEpisodes

    env = RecordEpisodes(shown_team(30, {**SMALL, "action.kind": "waypoint"}), tmp_path, every=3)
    env.reset(seed=0)
    decisions = 0
    while env.agents:
        env.step({agent: np.array([0.9, 0.5], np.float32) for agent in env.agents})
        decisions += 1
    assert decisions < 10
    with image.open(tmp_path / "twin-01-seed0.gif") as film:
        assert film.n_frames == 11


def test_a_closed_recorder_records_no_more_frames(tmp_path, monkeypatch):
    pytest.importorskip("PIL", reason="needs the extra 'viz'")
    from twc_env.pictures import video

    team = shown_team(4)
    made, filmed = video.film_frame, []
    monkeypatch.setattr(video, "film_frame", lambda *given: filmed.append(given) or made(*given))
    film = video.RecordEpisodes(team, tmp_path, every=1)
    film.reset(seed=0)
    film.step(dict.fromkeys(team.agents, np.zeros(2, np.float32)))
    before = len(filmed)
    film.close()
    team.reset(seed=0)
    team.step(dict.fromkeys(team.agents, np.zeros(2, np.float32)))
    assert before > 0 and len(filmed) == before


def test_a_closed_recorder_records_again_from_the_next_reset(tmp_path):
    image = pytest.importorskip("PIL.Image", reason="needs the extra 'viz'")
    from twc_env.pictures.video import RecordEpisodes

    film = RecordEpisodes(shown_team(8), tmp_path, every=2)
    for seed in (0, 1, 2):
        film.reset(seed=seed)
        while film.agents:
            film.step(dict.fromkeys(film.agents, np.zeros(2, np.float32)))
        film.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"twin-01-seed{k}.gif" for k in range(3)]
    for path in tmp_path.iterdir():
        with image.open(path) as shown:
            assert shown.n_frames == 5


@pytest.mark.parametrize(("steps", "frames"), [(0, 0), (1, 2), (2, 2), (5, 4), (6, 4)])
@pytest.mark.parametrize("end", ["reset", "close"])
def test_the_film_of_an_abandoned_episode_ends_with_its_last_step(tmp_path, monkeypatch, end, steps, frames):
    pytest.importorskip("PIL", reason="needs the extra 'viz'")
    from twc_env.pictures import video

    films = []
    monkeypatch.setattr(video, "write_film", lambda _path, frames, _duration_ms: films.append(len(frames)))
    film = video.RecordEpisodes(shown_team(), tmp_path, every=2)
    film.reset(seed=0)
    for _ in range(steps):
        film.step({agent: np.array([0.9, 0.5], np.float32) for agent in film.agents})
    getattr(film, end)()
    assert films == [frames] * (frames > 0)


def test_films_are_960_pixels_wide_and_named_by_map_and_seed(tmp_path):
    image = pytest.importorskip("PIL.Image", reason="needs the extra 'viz'")
    from twc_env.exploration.drawing import palette
    from twc_env.pictures.video import RecordEpisodes, film_name

    env = RecordEpisodes(shown_team(2), tmp_path, every=1)
    for _ in range(2):
        env.reset(seed=7)
        while env.agents:
            env.step({agent: np.array([0.9, 0.5], np.float32) for agent in env.agents})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["twin-01-seed7-2.gif", "twin-01-seed7.gif"]
    with image.open(tmp_path / "twin-01-seed7.gif") as film:
        assert film.width == 960
        colours = np.unique(np.asarray(film.convert("RGB")).reshape(-1, 3), axis=0)
    violet = tuple(int(palette.CLOSURE[k : k + 2], 16) for k in (1, 3, 5))
    assert violet in {tuple(map(int, colour)) for colour in colours}  # thin lines of the legend keep their colour
    assert film_name("gen:office:800:7", 3) == "gen-office-800-7-seed3.gif"
    assert film_name("plans/my flat.yaml", 0) == "my-flat-seed0.gif"


def test_recording_needs_rgb_array_and_does_not_affect_the_episode(tmp_path, same_last=("lidar", "map")):
    from twc_env.pictures.video import RecordEpisodes

    with pytest.raises(ConfigError, match="rgb_array"):
        RecordEpisodes(twc_env.parallel_env(), tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(DataError, match="choose another folder"):
        RecordEpisodes(twc_env.parallel_env(render_mode="rgb_array"), tmp_path / "file")
    plain = shown_team()
    filmed = RecordEpisodes(pickle.loads(pickle.dumps(plain)), tmp_path)
    seen = []
    for env in (plain, filmed):
        env.reset(seed=4)
        for _ in range(5):
            observations, *_ = env.step({agent: np.array([0.9, 0.5], np.float32) for agent in env.agents})
        seen.append(observations["robot_1"])
    assert all(np.array_equal(seen[0][key], seen[1][key]) for key in same_last)


def test_environments_with_neighbouring_seeds_play_different_episodes():
    """Each played the seeds after its first one: the second began with what the first played next."""
    envs = gymnasium.make_vec(ID, 3, "sync", max_cycles=2, config=SMALL)
    envs.reset(seed=5)
    seeds = [[env.unwrapped.parallel.episode.seed for env in envs.envs]]
    for _ in range(12):
        envs.step(envs.action_space.sample())
        now = [env.unwrapped.parallel.episode.seed for env in envs.envs]
        seeds += [now] if now != seeds[-1] else []
    assert seeds[0] == [5, 6, 7] and len(seeds) > 3
    assert len({seed for row in seeds for seed in row}) == 3 * len(seeds)
    again = gymnasium.make(ID, max_cycles=2, config=SMALL)
    again.reset(seed=6)
    again.reset()
    assert again.unwrapped.parallel.episode.seed == seeds[1][1]  # decided by the first seed


def test_only_episodes_of_time_steps_tell_wrappers_how_many_steps_they_have():
    choices = gymnasium.make(ID, max_cycles=400, config={**SMALL, "action.kind": "frontier"})
    assert make_alone().spec.max_episode_steps == 8 and choices.spec.max_episode_steps is None
