from dataclasses import fields

import numpy as np
import pytest

import twc_env
from twc_env import metrics
from twc_env.config import RewardConfig
from twc_env.exploration.evaluation import GroupVerdict, rightly_mapped_m2
from twc_env.exploration.rewards import Transition, terms, weigh
from twc_env.messages import GridMap
from twc_env.slam import map_merging
from twc_env.slam.engine import View

STEPS = 300


def verdict(robots, area_m2, wrong_pairs=()):
    nothing = GridMap(np.zeros((0, 0), np.int16), np.zeros(2), 0.1)
    return GroupVerdict(View(None, 0, robots), robots, nothing, np.zeros(3), tuple(wrong_pairs), area_m2)


def mapped_areas(result) -> dict[tuple[int, ...], float]:
    """Correctly mapped area [m2] of each group at the end, measured anew."""
    cells = result.floorplan.cells()
    return {
        robots: metrics.correct_area_m2(
            grid.log_odds, grid.origin_m, grid.resolution_m, pose, cells.free, cells.origin_m, cells.resolution_m
        )
        for robots, grid, pose in zip(result.groups, result.grids, result.pose_building_map, strict=True)
    }


def total(log, agent="robot_0") -> float:
    return sum(rewards[agent] for rewards in log.rewards)


@pytest.fixture(scope="module")
def team(explore):
    return explore(STEPS, max_cycles=STEPS)


@pytest.mark.parametrize("steps", [STEPS, 47])
def test_rewards_of_a_robot_alone_add_up_to_the_area_it_mapped(explore, steps):
    log = explore(steps, robots=1, max_cycles=steps)
    result = log.env.result()
    free_m2 = result.floorplan.cells().free.sum() * 0.1**2
    assert total(log) > 30
    assert total(log) == pytest.approx(mapped_areas(result)[0,], abs=1e-6)
    assert total(log) == pytest.approx(result.figures["coverage_correct"] * free_m2, abs=1e-6)


def test_rewards_of_a_team_add_up_to_the_area_of_its_best_right_group(team):
    result = team.env.result()
    assert result.figures["wrong_merges"] == 0
    assert total(team) == pytest.approx(max(mapped_areas(result).values()), abs=1e-6)


def test_all_mates_get_the_same_for_the_map(team):
    for rewards in team.rewards:
        assert len(set(rewards.values())) == 1


def test_the_map_is_judged_at_its_period_and_at_the_last_step(explore):
    log = explore(25, robots=1, max_cycles=25, config={"reward.period_steps": 10})
    paid = [step for step, rewards in enumerate(log.rewards, start=1) if rewards["robot_0"] != 0]
    assert paid == [10, 20, 25]


def test_the_terms_have_the_names_of_their_weights(team):
    names = {f.name for f in fields(RewardConfig)} - {"period_steps"}
    for infos in team.infos[1:]:
        for info in infos.values():
            assert set(info["reward_terms"]) == names


def test_the_reward_is_the_weighted_sum_of_the_terms(explore):
    weights = {"reward.correct_area": 2.5, "reward.collision": -0.75}
    env = twc_env.parallel_env(robots=2, max_cycles=120, config=weights)
    env.reset(seed=0)
    touched = 0.0
    while env.agents:
        ahead = dict.fromkeys(env.agents, np.array([1.0, 0.0], np.float32))
        _, rewards, _, _, infos = env.step(ahead)
        for agent, info in infos.items():
            values = info["reward_terms"]
            touched += values["collision"]
            assert rewards[agent] == pytest.approx(2.5 * values["correct_area"] - 0.75 * values["collision"])
    assert touched > 0, "nobody ran into a wall: the weight of a collision was not tried"


def test_weights_change_the_reward_but_not_the_episode(explore, same):
    plain, weighted = (explore(40, config={"reward.correct_area": w}) for w in (1.0, 3.0))
    assert total(weighted) == pytest.approx(3 * total(plain))
    for a, b in zip(plain.observations, weighted.observations, strict=True):
        assert all(same(a[agent], b[agent]) for agent in a)


def test_terms_judge_one_transition():
    poses = np.zeros((2, 3))
    transition = Transition(poses, poses, np.array([False, True]), 12.5, 10.0)
    assert terms(transition, 0) == {"correct_area": 2.5, "collision": 0.0}
    assert terms(transition, 1) == {"correct_area": 2.5, "collision": 1.0}
    assert weigh(terms(transition, 1), RewardConfig(correct_area=2.0, collision=-1.0)) == 4.0


def test_the_largest_rightly_merged_group_counts():
    assert rightly_mapped_m2([verdict((0, 1), 80.0), verdict((2,), 30.0)]) == 80.0
    assert rightly_mapped_m2([verdict((0, 1), 20.0), verdict((2,), 30.0)]) == 30.0


def test_a_wrongly_merged_group_counts_nothing():
    wrong = verdict((0, 1), 80.0, [(0, 1)])
    assert rightly_mapped_m2([wrong, verdict((2,), 30.0)]) == 30.0
    assert rightly_mapped_m2([wrong]) == 0.0
    assert rightly_mapped_m2([]) == 0.0


@pytest.fixture
def wrong_merges(monkeypatch):
    """The first closure between two robots is believed at once, and laid down at a wrong place."""

    def agree(targets, *_):
        return map_merging.MergeProposal(np.array([6.0, -4.0, 1.0]), np.ones(len(targets), bool))

    monkeypatch.setattr(map_merging, "largest_agreement", agree)
    monkeypatch.setattr(map_merging, "wall_contradiction", lambda *_: 0.0)
    monkeypatch.setattr(map_merging, "wifi_agrees", lambda *_: True)


def test_a_planted_wrong_merge_is_seen_counted_and_not_paid(wrong_merges, explore):
    log = explore(STEPS, max_cycles=STEPS)
    result = log.env.result()
    areas = mapped_areas(result)
    merged = result.groups[0]
    assert len(merged) >= 2, "no two robots met: nothing was planted"
    assert result.figures["wrong_merges"] >= 1
    paid_for = max((area for robots, area in areas.items() if len(robots) == 1), default=0.0)
    assert total(log) == pytest.approx(paid_for, abs=1e-6)
    assert total(log) < areas[merged] or paid_for >= areas[merged]
