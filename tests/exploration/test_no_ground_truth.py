"""Ground truth reaches neither estimates nor observations; each check is also tested with an injected leak."""

import dataclasses
import gc
import pickle
import types

import numpy as np
import pytest

import twc_env
from tests.soak.observation_check import ACTIONS, BLOCKS, random_actions
from twc_env.exploration.episode import Episode
from twc_env.exploration.observation.observations import ObservationBuilder
from twc_env.records.messages import Belief, SensorFrame
from twc_env.slam.engine import CooperativeSlam

STEPS = 150
MOTION = np.array([37.3, -81.9, 1.1])
EVERY_BLOCK = {"slam.k_visibility.enabled": True, **{f"observation.{name}": True for name in BLOCKS}}


class LeakyEnv(twc_env.ExplorationEnv):
    """Puts each robot's true position into its observation."""

    def step(self, actions):
        result = super().step(actions)
        for observation, true in zip(result[0].values(), self.state().reshape(-1, 6), strict=True):
            observation["pose"][:2] = true[:2]
        return result


def keyframes_of(env) -> list[tuple]:
    """(robot, step, pose) of every keyframe."""
    return [(k.robot, k.step, *k.pose_odom.tolist()) for path in env.engine.team.keyframes for k in path]


def largest_difference(first, second) -> float:
    """Largest absolute difference between observations of two logs; for `map`, the share of cells that differ."""
    worst = 0.0
    for a, b in zip(first.observations, second.observations, strict=True):
        for agent in a:
            for key in a[agent]:
                difference = np.abs(a[agent][key].astype(float) - b[agent][key].astype(float))
                worst = max(worst, (difference > 0).mean() if key == "map" else difference.max())
    return worst


@pytest.fixture(scope="module")
def here(explore):
    return explore(STEPS)


@pytest.fixture(scope="module")
def moved(explore, here):
    return explore(STEPS, floorplan=here.env.floorplan.moved(MOTION))


def test_observations_are_invariant_to_the_pose_of_the_building(here, moved):
    assert np.abs(here.env.state() - moved.env.state()).max() > 30
    assert largest_difference(here, moved) < 1e-4


def test_keyframes_are_invariant_and_rewards_nearly_so_to_the_pose_of_the_building(here, moved):
    gains = [sum(rewards["robot_0"] for rewards in log.rewards) for log in (here, moved)]
    assert gains[0] > 0.1
    assert gains[1] == pytest.approx(gains[0], rel=0.03)  # the cells of the true floor differ
    assert len(keyframes_of(here.env)) > 20
    assert np.array(keyframes_of(moved.env)) == pytest.approx(np.array(keyframes_of(here.env)), abs=1e-6)


def test_the_invariance_check_finds_a_leak_of_true_positions(explore, here):
    plans = here.env.floorplan, here.env.floorplan.moved(MOTION)
    first, second = (explore(5, env=LeakyEnv(robots=3, floorplan=plan)) for plan in plans)
    assert largest_difference(first, second) > 1.0


def blocks_that_differ(leak: str | None, action: tuple[str, str], steps: int) -> set[str]:
    """Names of the observation blocks that differ between two teams with equal actions in a building and the same
    building moved. `leak`: a block to which the true position is added."""
    config = {**EVERY_BLOCK, "action.kind": action[0], "action.timing": action[1], "action.decision_max_s": 3.0}
    plan = twc_env.load_map("twin-02")
    envs = [twc_env.parallel_env(floorplan=p, max_cycles=steps, config=config) for p in (plan, plan.moved(MOTION))]
    random, names = np.random.default_rng(0), set()
    seen = [env.reset(seed=0, options={"starts": "map"}) for env in envs]
    while True:
        if leak is not None:
            for env, (observations, *_) in zip(envs, seen, strict=True):
                for observation, true in zip(observations.values(), env.state().reshape(-1, 6), strict=True):
                    observation[leak].flat[0] += int(abs(true[0]))
        for agent, observation in seen[0][0].items():
            for name, block in observation.items():
                names |= set() if np.array_equal(block, seen[1][0][agent][name]) else {name}
        if not envs[0].agents:
            return names
        actions = random_actions(envs[0], seen[0][-1], random)
        seen = [env.step(actions) for env in envs]


@pytest.mark.parametrize("action", ACTIONS)
def test_every_block_is_invariant_to_the_pose_of_the_building_for_every_kind_of_action(action):
    assert blocks_that_differ(None, action, 200) == set()


@pytest.mark.parametrize("block", [*BLOCKS, "radio", "action_mask"])
def test_the_invariance_check_finds_a_leak_in_every_block(block):
    assert blocks_that_differ(block, ("frontier", "asynchronous"), 3) == {block}


def rebuild_errors(env, steps: int, wander, engine=None) -> int:
    """Number of observations that differ from those rebuilt from frames and beliefs; engine: one to replay the frames,
    None for the episode's own beliefs."""
    observations, _ = env.reset(seed=0, options={"starts": "map"})
    builder = ObservationBuilder(env.config)
    wrong = 0
    for step in range(steps):
        if engine is None:
            beliefs = [env.belief(agent) for agent in env.possible_agents]
        else:
            engine.update(pickle.loads(pickle.dumps(env.frames)))
            beliefs = [engine.belief(frame.robot) for frame in env.frames]
        builder.notice(*pickle.loads(pickle.dumps((env.frames, beliefs))))
        for agent, built in zip(env.possible_agents, builder.build(), strict=True):
            wrong += any(not np.array_equal(built[key], observations[agent][key]) for key in built)
        actions = {a: wander(o["lidar"] * 10, step, int(a[-1])) for a, o in observations.items()}
        observations = env.step(actions)[0]
    return wrong


def test_observations_can_be_rebuilt_from_frames_and_beliefs(wander):
    assert rebuild_errors(twc_env.parallel_env(robots=3), 60, wander) == 0


def test_the_rebuild_check_finds_a_leak_in_observations(wander):
    assert rebuild_errors(LeakyEnv(robots=3), 5, wander) == 4 * 3


def test_a_fresh_engine_gives_the_same_observations_from_the_recorded_frames(wander):
    env = twc_env.parallel_env(robots=3)
    assert rebuild_errors(env, 350, wander, CooperativeSlam(env.config, 3)) == 0


def test_the_replay_check_finds_a_leak_in_beliefs(wander, monkeypatch):
    def notice_near_the_truth(episode):
        pairs = zip(episode.engine.beliefs(), episode.world.poses, strict=True)
        near = [dataclasses.replace(b, pose_map_robot=b.pose_map_robot + 1e-3 * true) for b, true in pairs]
        episode._builder.notice(episode.frames, near)

    monkeypatch.setattr(Episode, "_notice", notice_near_the_truth)
    env = twc_env.parallel_env(robots=3)
    assert rebuild_errors(env, 5, wander, CooperativeSlam(env.config, 3)) > 0


def test_beliefs_are_invariant_to_the_pose_of_the_building(here, moved):
    for agent in here.env.possible_agents:
        a, b = here.env.belief(agent), moved.env.belief(agent)
        assert a.pose_map_robot == pytest.approx(b.pose_map_robot, abs=1e-6)
        assert a.teammates.keys() == b.teammates.keys()
        assert [s.text for s in a.signs] == [s.text for s in b.signs]
        assert np.array([s.position_m for s in a.signs]) == pytest.approx(np.array([s.position_m for s in b.signs]))
        assert np.mean(a.grid.log_odds != b.grid.log_odds) < 1e-3


def test_every_robot_starts_at_the_origin_of_its_map(here):
    for observation in here.observations[0].values():
        assert observation["pose"].tolist() == [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        assert not observation["team"][:, :4].any()


SKIPPED = (type, types.ModuleType, types.FunctionType, types.BuiltinFunctionType, types.FrameType)


def packages_within_reach(root: object) -> set[str]:
    """Modules of twc_env with objects that can be reached from `root` by references."""
    seen, waiting, modules = {id(root)}, [root], set()
    while waiting:
        item = waiting.pop()
        module = type(item).__module__
        if module.startswith("numba"):
            continue
        if module.startswith("twc_env"):
            modules.add(module)
        for other in gc.get_referents(item):
            if id(other) not in seen and not isinstance(other, SKIPPED):
                seen.add(id(other))
                waiting.append(other)
    return modules


def strangers(root: object) -> set[str]:
    """Those of them that may hold ground truth."""
    return {m for m in packages_within_reach(root) if m.startswith(("twc_env.world", "twc_env.exploration"))}


def test_engine_beliefs_and_frames_hold_no_reference_to_the_world(here):
    env = here.env
    assert strangers(env.engine) == set()
    for agent, frame in zip(env.possible_agents, env.frames, strict=True):
        assert strangers(env.belief(agent)) == set()
        assert strangers(frame) == set()


def test_the_reference_check_finds_a_reference_to_the_world(here):
    planted = CooperativeSlam(here.env.config, 1)
    planted.robots[0].notes = {"deep": [here.env]}
    assert "twc_env.world.world" in strangers(planted)


@pytest.mark.parametrize("record", [Belief, SensorFrame])
def test_records_for_agents_have_no_field_for_ground_truth(record):
    names = [f.name for f in dataclasses.fields(record)]
    assert not any("true" in name or "truth" in name or "building" in name for name in names)


def test_infos_contain_only_reward_terms(here):
    assert all(info == {} for info in here.infos[0].values())
    for infos in here.infos[1:]:
        for info in infos.values():
            assert set(info) == {"reward_terms"}
