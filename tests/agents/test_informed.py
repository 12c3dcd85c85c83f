"""When the oracle follows its tours, and when it does as information-gain."""

from dataclasses import replace

import numpy as np
import pytest
from twc_env.agents.policy import begin, make_policy

import twc_env
from twc_env.planning import LatencyTours


def _actions(name: str, doors: float, steps: int = 12) -> np.ndarray:
    """(steps, robots, 2) in a small office of which this share of the doors opens and closes."""
    config = {"clutter.door_share": doors}
    env = twc_env.parallel_env(map="gen:office:150:3", robots=2, max_cycles=steps, config=config)
    env.reset(seed=2)
    policy, found = make_policy(name, env.config), []
    begin(policy, name, env, 2)
    while env.agents:
        actions = policy.act({agent: env.belief(agent) for agent in env.agents})
        found.append([actions[agent] for agent in env.agents])
        env.step(actions)
    return np.array(found)


@pytest.mark.parametrize(("doors", "is_alike"), [(0.8, True), (0.5, False)])
def test_the_oracle_follows_tours_but_where_most_doors_open_and_close(doors, is_alike):
    assert np.array_equal(_actions("informed", doors), _actions("information-gain", doors)) == is_alike


def _begun(agent: str, **more):
    env = twc_env.parallel_env(map="gen:office:150:3", robots=2, max_cycles=100, **more)
    env.reset(seed=2)
    policy = make_policy(agent, env.config)
    begin(policy, agent, env, 2)
    return policy, {agent: env.belief(agent) for agent in env.agents}


def test_signs_that_are_in_no_map_any_more_are_not_read():
    """As those that a robot read before it was carried away."""
    policy, beliefs = _begun("informed")
    policy.act(beliefs)
    policy.state.read[:] = 1
    bare = {agent: replace(belief, signs=()) for agent, belief in beliefs.items()}
    policy._plan_tours(policy._route, bare, policy._poses(), 0)
    assert not policy.state.read.any()


def test_what_is_random_after_the_tours_still_follows_from_the_seed():
    drawn = []
    for seed in (2, 3):
        policy, beliefs = _begun("informed")
        policy.reset(seed, list(beliefs))
        policy._looks[:] = 1000  # there is nothing left to see
        policy.state.is_merged[:] = True
        known = {agent: replace(belief, grid=policy._grid, pose_map_robot=pose) for (agent, belief), pose in
                 zip(beliefs.items(), policy._poses(), strict=True)}  # fmt: skip
        policy._plan_tours(policy._route, known, policy._poses(), 50)
        assert policy._route is None
        drawn.append(policy.random.random())
    assert drawn[0] != drawn[1]


def _planned_for(monkeypatch, agent: str, is_merged: bool):
    """The states that tours are planned for in one step, and the policy."""
    policy, beliefs = _begun(agent)
    policy.act(beliefs)
    policy.state.is_merged[:] |= is_merged
    found = []
    monkeypatch.setattr(LatencyTours, "plan", lambda self, state, *_: found.append((state, self.links)))
    policy.improve(policy._route, 10.0, 5)
    return found, policy


def test_who_does_not_know_of_merging_plans_as_if_there_were_one_map(monkeypatch):
    ((state, links),), policy = _planned_for(monkeypatch, "informed-no-merging", is_merged=False)
    assert state.is_merged.all()
    assert not policy.state.is_merged.all()
    assert links is None
    assert (state.seen == np.bitwise_or.reduce(policy.state.seen, axis=0)).all()
    assert (policy.state.seen[0] != policy.state.seen[1]).any()


@pytest.mark.parametrize(("is_merged", "groups"), [(False, [1, 1]), (True, [2])])
def test_who_knows_the_plan_alone_plans_for_the_robots_of_each_map(monkeypatch, is_merged, groups):
    found, policy = _planned_for(monkeypatch, "informed-plan-only", is_merged)
    assert [len(state.places) for state, _ in found] == groups
    assert sorted(place for state, _ in found for place in state.places) == sorted(policy.state.places)


def test_robots_that_know_the_plan_alone_know_of_nobody_in_another_map():
    policy, beliefs = _begun("informed-plan-only")
    told = beliefs["robot_0"]
    assert policy.known_to(told) == []
    assert policy.known_to(replace(told, teammates={1: told.pose_map_robot})) == [1]


def test_who_knows_the_poses_alone_sees_of_the_plan_what_anybody_has_mapped():
    policy, beliefs = _begun("informed-poses-only")
    policy.act(beliefs)
    levels, plan = policy._grid.log_odds, policy._plan_grid.log_odds
    assert set(np.unique(plan[levels != 0] - levels[levels != 0])) == {0}
    mapped = [np.count_nonzero(belief.grid.log_odds < 0) for belief in beliefs.values()]
    assert 0.9 * max(mapped) < np.count_nonzero(levels < 0) < sum(mapped) + 50
    assert np.count_nonzero(levels < 0) < 0.5 * np.count_nonzero(plan < 0)
    assert np.count_nonzero(levels > 0)
