"""Episodes that end when enough of the floor is mapped, and where robots start."""

import numpy as np
import pytest

import twc_env
from twc_env.exploration.assessment.map_scores import floor_m2
from twc_env.vector.teams import VectorTeams

SMALL = {"map": "gen:office:100:1", "robots": 2, "max_cycles": 200}
"""A building of which the first scans show a good part."""


def played(share: float, still: bool = False, **settings):
    """The environment, and the results of all steps of an episode that ends at this share."""
    env = twc_env.parallel_env(config={**SMALL, "episode.ends_at_coverage": share, **settings})
    env.reset(seed=0)
    steps = []
    while env.agents:
        actions = {agent: np.array([0.0 if still else 0.4, 0.8], np.float32) for agent in env.agents}
        steps.append(env.step(actions))
    return env, steps


def test_an_episode_is_terminated_once_the_share_is_mapped_and_not_truncated():
    env, steps = played(0.2)
    *_, (_, _, terminations, truncations, infos) = steps
    assert 10 <= len(steps) < 200 and len(steps) % env.config.reward.period_steps == 0
    assert set(terminations.values()) == {True} and set(truncations.values()) == {False}
    assert not any(any(step[2].values()) or any(step[3].values()) for step in steps[:-1])
    assert infos["robot_0"]["steps"] == len(steps)
    assert sum(step[4]["robot_0"]["reward_terms"]["coverage"] for step in steps) >= 0.2
    best = max(score.correct_area_m2 for score in env.episode.map_scores()) / floor_m2(env.floorplan.cells())
    assert env.episode.coverage == best, "the last map is evaluated exactly"
    with pytest.raises(twc_env.TwcError, match="call reset"):
        env.step({})


def test_the_end_comes_at_the_first_evaluation_that_reaches_the_share():
    _, steps = played(0.0)
    covered = np.cumsum([step[4]["robot_0"]["reward_terms"]["coverage"] for step in steps])
    assert len(steps) == 200
    assert set(steps[-1][3].values()) == {True}
    for share in (0.15, 0.25):
        _, ended = played(share)
        assert len(ended) == int(np.argmax(covered >= share)) + 1


def test_an_episode_whose_share_is_out_of_reach_is_truncated():
    _, steps = played(1.0, still=True, max_cycles=30)
    assert len(steps) == 30
    assert set(steps[-1][2].values()) == {False} and set(steps[-1][3].values()) == {True}


def test_the_last_step_of_the_budget_may_terminate_too():
    _, steps = played(0.0)
    share = sum(step[4]["robot_0"]["reward_terms"]["coverage"] for step in steps)
    _, steps = played(share - 1e-9)
    assert len(steps) <= 200 and set(steps[-1][2].values()) == {True}


def test_steps_of_many_time_steps_end_early_too():
    env = twc_env.parallel_env(config={**SMALL, "action.kind": "frontier", "episode.ends_at_coverage": 0.2})
    observations, _ = env.reset(seed=0)
    while env.agents:
        choices = {agent: int(observations[agent]["action_mask"].argmax()) for agent in env.agents}
        observations, _, terminations, _, infos = env.step(choices)
    assert terminations == {"robot_0": True, "robot_1": True}
    assert infos["robot_0"]["steps"] < 200


def test_learners_are_told_whether_an_episode_was_terminated_or_truncated():
    for share, is_terminated in ((0.2, True), (0.0, False)):
        config = {**SMALL, "max_cycles": 60, "episode.ends_at_coverage": share}
        teams = VectorTeams(1, config)
        teams.reset(0)
        ended = np.zeros(1, bool)
        while not ended.any():
            _, _, ended, infos = teams.step(np.full((1, 2, 2), 0.4, np.float32))
        assert [info["is_terminated"] for info in infos[0]] == [is_terminated] * 2
        teams.close()


def test_robots_at_an_entrance_start_side_by_side_and_see_each_other():
    env = twc_env.parallel_env(map="gen:office:800:7", robots=4, config={"episode.starts": "entrance"})
    places = []
    for seed in range(5):
        env.reset(seed=seed)
        poses = env.episode.record.true_poses[0]
        apart_m = np.hypot(*(poses[:, None, :2] - poses[None, :, :2]).T)[~np.eye(4, dtype=bool)]
        assert apart_m.min() >= 0.6 and apart_m.max() < 5.0
        walls = env.floorplan.home.wall_index
        assert walls.crossing(poses[0, :2], np.ascontiguousarray(poses[1:, :2]))[0].sum() == 0
        places.append(poses[0, :2])
    assert np.ptp(np.array(places), axis=0).max() > 5.0
    env.reset(seed=0, options={"starts": "random"})
    assert np.ptp(env.episode.record.true_poses[0, :, :2], axis=0).max() > 5.0


def test_a_set_of_buildings_gives_each_seed_its_own_and_options_choose_among_its_splits():
    env = twc_env.parallel_env(map="gen:office+ring:150:train", robots=1, max_cycles=5)
    names = []
    for seed in range(3):
        env.reset(seed=seed)
        names.append(env.floorplan.name)
        assert env.episode.config.map == env.floorplan.name
    assert len(set(names)) == 3 and all(name.startswith("gen:office+ring:150:train/") for name in names)
    env.reset(seed=0, options={"split": "test"})
    assert env.floorplan.name.startswith("gen:office+ring:150:test/")
    env.reset(seed=1)
    assert env.floorplan.name == names[1]
    own = twc_env.load_map("twin-01")
    given = twc_env.parallel_env(map="gen:office+ring:150:train", robots=1, max_cycles=5, floorplan=own)
    given.reset(seed=0)
    assert given.floorplan.name == "twin-01"
