from dataclasses import fields

import numpy as np
import pytest

import twc_env
from twc_env import metrics
from twc_env.config import RewardConfig
from twc_env.exploration.assessment.map_evaluation import MapEvaluators
from twc_env.exploration.assessment.map_scores import scores_of
from twc_env.exploration.assessment.rewards import (
    POTENTIALS,
    EvaluatedMap,
    Standing,
    Transition,
    standing_of,
    terms,
    weigh,
    weights_of,
)

STEPS = 300


def mapped_shares(result) -> dict[tuple[int, ...], float]:
    """Share of the floor that each group has mapped correctly at the end, recomputed."""
    cells = result.floorplan.cells()
    floor_m2 = cells.free.sum() * cells.resolution_m**2
    return {
        robots: metrics.correct_area_m2(
            grid.log_odds, grid.origin_m, grid.resolution_m, pose, cells.free, cells.origin_m, cells.resolution_m
        )
        / floor_m2
        for robots, grid, pose in zip(result.groups, result.grids, result.pose_building_map, strict=True)
    }


def total(log, agent="robot_0") -> float:
    return sum(rewards[agent] for rewards in log.rewards)


@pytest.fixture(scope="module")
def team(explore):
    return explore(STEPS, max_cycles=STEPS)


@pytest.mark.parametrize("steps", [STEPS, 47])
def test_rewards_of_a_single_robot_sum_to_its_coverage(explore, steps):
    log = explore(steps, robots=1, max_cycles=steps)
    result = log.env.result()
    assert total(log) > 0.05
    assert total(log) == pytest.approx(mapped_shares(result)[0,], abs=1e-9)
    assert total(log) == pytest.approx(result.figures["coverage_correct"], abs=1e-9)


def test_coverage_above_one_is_clipped():
    standing = standing_of([EvaluatedMap((0,), 1, True, 1.0007)], [0.0])
    assert standing.team[0] == standing.own[0][0] == 1.0


def test_rewards_of_a_team_sum_to_the_coverage_of_its_best_correct_group(team):
    result = team.env.result()
    assert result.figures["wrong_merges"] == 0
    assert total(team) == pytest.approx(max(mapped_shares(result).values()), abs=1e-9)


def test_all_robots_of_a_team_get_the_same_reward(team):
    for rewards in team.rewards:
        assert len(set(rewards.values())) == 1


def test_the_map_is_evaluated_periodically_and_at_the_last_step(explore):
    log = explore(25, robots=1, max_cycles=25, config={"reward.period_steps": 10})
    paid = [step for step, rewards in enumerate(log.rewards, start=1) if rewards["robot_0"] != 0]
    assert paid == [10, 20, 25]


def test_cached_counts_give_the_same_area_as_a_full_count(wander):
    env = twc_env.parallel_env(map="twin-02", robots=3, max_cycles=400)
    env.reset(seed=1)
    cells, evaluated = env.floorplan.cells(), 0
    while env.agents:
        ranges_m = env.frames.ranges_m
        env.step({a: wander(ranges_m[k], env.episode.steps, k) for k, a in enumerate(env.agents)})
        if env.episode.steps % 50 == 0:
            for score in scores_of(env.engine, env.episode.record, cells):
                where = score.grid, score.pose_building_map, cells
                area_m2 = env.episode.record.map_evaluators.correct_area_m2(*where)
                assert area_m2 == MapEvaluators().correct_area_m2(*where)
                evaluated += area_m2 > 0
    assert evaluated > 8


def test_the_terms_have_the_names_of_their_weights(team):
    names = {f.name for f in fields(RewardConfig)} - {"period_steps", "sharing"}
    for infos in team.infos[1:]:
        for info in infos.values():
            assert set(info["reward_terms"]) == names


def test_the_reward_is_the_weighted_sum_of_the_terms(explore):
    weights = {"reward.coverage": 2.5, "reward.collision": -0.75}
    env = twc_env.parallel_env(robots=2, max_cycles=120, config=weights)
    env.reset(seed=0)
    touched = 0.0
    while env.agents:
        ahead = dict.fromkeys(env.agents, np.array([1.0, 0.0], np.float32))
        _, rewards, _, _, infos = env.step(ahead)
        for agent, info in infos.items():
            values = info["reward_terms"]
            touched += values["collision"]
            assert rewards[agent] == pytest.approx(2.5 * values["coverage"] - 0.75 * values["collision"])
    assert touched > 0, "nobody ran into a wall: the weight of a collision was not tried"


def test_the_bytes_term_is_the_data_sent_in_the_step(wander):
    env = twc_env.parallel_env(map="twin-02", robots=2, max_cycles=100)
    env.reset(seed=1)
    told, sent_before = 0, env.episode.bytes_sent
    while env.agents:
        ranges_m = env.frames.ranges_m
        *_, infos = env.step({a: wander(ranges_m[k], env.episode.steps, k) for k, a in enumerate(env.agents)})
        sent, sent_before = env.episode.bytes_sent - sent_before, env.episode.bytes_sent
        told += sent > 0 and not env.episode.world.contacts.any() and env.episode.steps % 10 > 0
        for info in infos.values():
            assert info["reward_terms"]["bytes"] == pytest.approx(min(sent / 2 / 10_000, 1.0))
    assert told > 5


def test_weights_change_the_reward_but_not_the_episode(explore, same):
    plain, weighted = (explore(40, config={"reward.coverage": w}) for w in (1.0, 3.0))
    assert total(weighted) == pytest.approx(3 * total(plain))
    for a, b in zip(plain.observations, weighted.observations, strict=True):
        assert all(same(a[agent], b[agent]) for agent in a)


def team_of(groups, errors_m=(0.0, 0.0, 0.0)):
    maps = [EvaluatedMap(robots, len(robots), is_right, share) for robots, is_right, share in groups]
    return standing_of(maps, errors_m)


def test_terms_of_one_transition_have_the_expected_values():
    before = team_of([((0, 1), True, 0.25), ((2,), True, 0.5)], (0.0, 0.5, 2.0))
    after = team_of([((0, 1, 2), True, 0.75)], (0.0, 0.0, 0.25))
    transition = Transition(before, after, np.array([False, True, False]), 2500.0, 200)
    team = {"coverage": 0.25, "merge": 1.0, "localisation": pytest.approx(2.75 / 3 - 0.5)}
    assert terms(transition, "team")[0] == team | {"collision": 0.0, "time": 0.005, "bytes": 0.25}
    own = {"coverage": 0.5, "merge": 0.5, "localisation": 0.5}
    assert terms(transition, "individual")[1] == own | {"collision": 1.0, "time": 0.005, "bytes": 0.25}
    weights = RewardConfig(coverage=2.0, merge=1.0, collision=-1.0, bytes=-4.0)
    assert weigh(terms(transition, "individual"), weights_of(weights))[1] == 1.0 + 0.5 - 1.0 - 1.0


def test_the_correct_group_with_the_largest_coverage_counts():
    assert team_of([((0, 1), True, 0.8), ((2,), True, 0.3)]).team == [0.8, 0.5, 1.0]
    assert team_of([((0, 1), True, 0.2), ((2,), True, 0.3)]).team == [0.3, 0.0, 1.0]


def test_a_wrongly_merged_group_has_no_coverage():
    assert team_of([((0, 1), False, 0.8), ((2,), True, 0.3)]).team == [0.3, 0.0, 1.0]
    assert team_of([((0, 1, 2), False, 0.8)]).team[:2] == [0.0, 0.0]


@pytest.mark.parametrize("sharing", ["team", "individual"])
def test_every_term_lies_between_0_and_1_and_potentials_add_up_to_less(explore, sharing):
    log = explore(200, max_cycles=200, config={"reward.sharing": sharing})
    sums = dict.fromkeys(POTENTIALS, 0.0)
    for infos in log.infos[1:]:
        for name, value in infos["robot_0"]["reward_terms"].items():
            assert (-1.0 if name in POTENTIALS else 0.0) <= value <= 1.0
            if name in POTENTIALS:
                sums[name] += value
    assert all(0.0 <= value <= 1.0 + 1e-9 for value in sums.values())
    assert sums["coverage"] > 0.05 and sums["localisation"] > 0.5


def test_potentials_are_zero_before_the_first_scan():
    nothing = Standing.nothing(2)
    assert not any(nothing.team) and not np.any(nothing.own)


@pytest.mark.usefixtures("wrong_merges")
def test_an_injected_wrong_merge_is_counted_and_not_rewarded(explore):
    log = explore(STEPS, max_cycles=STEPS, config={"slam.pose_graph.robust": "dcs", "slam.merging.undo": False})
    result = log.env.result()
    areas = mapped_shares(result)
    merged = result.groups[0]
    assert len(merged) >= 2, "no two robots met: nothing was planted"
    assert result.figures["wrong_merges"] >= 1
    paid_for = max((area for robots, area in areas.items() if len(robots) == 1), default=0.0)
    assert total(log) == pytest.approx(paid_for, abs=1e-9)
    assert total(log) < areas[merged] or paid_for >= areas[merged]
