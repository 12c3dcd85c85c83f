"""Every combination of observation, action and reward sharing passes the API tests."""

import itertools
from functools import partial

import numpy as np
import pytest
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, seed_test, state_test

import twc_env
from tests.soak.observation_check import ACTIONS, BLOCKS, random_actions
from twc_env.config import EnvConfig, override
from twc_env.exploration.episode import Episode
from twc_env.exploration.macro_actions import CandidateSearch, MacroActions
from twc_env.exploration.observation.observations import ObservationBuilder
from twc_env.planning.candidates import NOTHING, SPENT_M, features_of, find_candidates, find_views
from twc_env.planning.drivers import map_id
from twc_env.planning.path_finder import PathFinder
from twc_env.planning.terrain import Terrain
from twc_env.records.messages import Belief, GridMap
from twc_env.slam.engine import CooperativeSlam

ALL_BLOCKS = {f"observation.{name}": True for name in BLOCKS}


def settings(action=("velocity", "synchronous"), observation="dict", sharing="team", **more) -> dict:
    return {
        "action.kind": action[0],
        "action.timing": action[1],
        "action.decision_max_s": 2.0,
        "observation.kind": observation,
        "observation.map_cells": 24,
        "reward.sharing": sharing,
        "lidar.beam_count": 60,
        **more,
    }


@pytest.mark.filterwarnings(  # the observation may be a Dict, which PettingZoo allows
    "ignore:Observation is not a NumPy array", "ignore:Observation space for each agent probably should be"
)
@pytest.mark.parametrize(
    ("action", "observation", "sharing"), list(itertools.product(ACTIONS, ["dict", "flat"], ["team", "individual"]))
)
def test_pettingzoo_accepts_every_combination(action, observation, sharing):
    config = settings(action, observation, sharing, **(ALL_BLOCKS if sharing == "team" else {}))
    teams, turns = (
        partial(make, robots=2, max_cycles=40, config=config) for make in (twc_env.parallel_env, twc_env.env)
    )
    parallel_api_test(teams(), num_cycles=20)
    api_test(turns(), num_cycles=20)
    parallel_seed_test(teams, num_cycles=5)
    seed_test(turns, num_cycles=5)
    state_test(turns(), teams(), num_cycles=10)


def test_disabled_blocks_are_not_in_the_observation():
    off = {f"observation.{name}": False for name in BLOCKS if name != "pose"}
    observations, _ = twc_env.parallel_env(config=settings(**off)).reset(seed=0)
    assert set(observations["robot_0"]) == {"pose"}
    env = twc_env.parallel_env(config=settings(("frontier", "synchronous"), **off))
    assert set(env.reset(seed=0)[0]["robot_0"]) == {"pose", "frontiers", "action_mask"}


def test_a_flat_observation_concatenates_the_blocks_in_order():
    both = [twc_env.parallel_env(config=settings(observation=kind, **ALL_BLOCKS)) for kind in ("dict", "flat")]
    blocks, flat = (env.reset(seed=3)[0]["robot_1"] for env in both)
    joined = np.concatenate([np.ravel(b) / (255.0 if b.dtype == np.uint8 else 1.0) for b in blocks.values()])
    assert flat == pytest.approx(joined)
    assert both[1].observation_space("robot_1").contains(flat)


@pytest.mark.parametrize("action", ACTIONS[3:])
def test_the_mask_in_the_info_equals_that_in_the_observation(action):
    env = twc_env.parallel_env(map="twin-02", robots=2, max_cycles=120, config=settings(action))
    observations, infos = env.reset(seed=1)
    random, choices = np.random.default_rng(0), []
    while True:
        for agent, info in infos.items():
            assert np.array_equal(info["action_mask"], observations[agent]["action_mask"])
        if not env.agents:
            break
        choices.append(sum(info["action_mask"].sum() for info in infos.values()))
        observations, _, _, _, infos = env.step(random_actions(env, infos, random))
    assert choices[0] > len(infos), "only `stay` could be chosen at the start"


def test_the_action_of_a_busy_robot_is_ignored(same):
    config = settings(("frontier", "asynchronous"), **{"action.decision_max_s": 6.0})
    runs = []
    for busy_choice in ("stay", "first"):
        env = twc_env.parallel_env(map="twin-02", config=config, max_cycles=600)
        observations, infos = env.reset(seed=5)
        seen, were_busy = [], 0
        while env.agents:
            actions = {}
            for agent in env.agents:
                mask = infos[agent]["action_mask"]
                busy = not infos[agent]["is_deciding"]
                were_busy += busy
                assert not busy or mask.sum() == 1
                actions[agent] = 0 if busy and busy_choice == "first" else int(np.argmax(mask))
            observations, _, _, _, infos = env.step(actions)
            seen.append(observations)
        assert were_busy > 0
        runs.append(seen)
    assert len(runs[0]) == len(runs[1])
    assert all(same(a[agent], b[agent]) for a, b in zip(*runs, strict=True) for agent in a)


@pytest.mark.parametrize("kind", ["velocity", "frontier"])
def test_frontiers_of_robots_that_decide_nothing_are_of_the_present_map_and_of_the_last_period(kind, wander):
    config = {"action.kind": kind, "action.timing": "asynchronous", "observation.frontiers": True}
    env = twc_env.parallel_env(map="gen:office:100:1", robots=2, max_cycles=270, config=config)
    observations, infos = env.reset(seed=4)
    finder, slots, radius_m = PathFinder(), env.config.action.frontier_slots, env.config.dynamics.robot_radius_m
    maps, looked, jumps, busy = [(b.map_version, 0) for b in env.engine.beliefs()], [0, 0], 0, 0
    while env.agents:
        if kind == "frontier":
            actions = {agent: int(np.argmax(infos[agent]["action_mask"])) for agent in env.agents}
        else:
            ranges_m = [observations[agent]["lidar"] * 10 for agent in env.agents]
            actions = {a: wander(ranges_m[k], env.episode.steps, 3 * k) for k, a in enumerate(env.agents)}
        observations, _, _, _, infos = env.step(actions)
        for robot, (agent, info) in enumerate(infos.items()):
            belief = env.belief(agent)
            here = belief.pose_map_robot
            found = find_candidates(belief, Terrain.of(belief, radius_m), finder, slots)
            of_map = belief.map_version, len(belief.teammates)
            has_jumped = of_map != maps[robot]
            if has_jumped or env.episode.steps - looked[robot] >= 10 or info.get("is_deciding"):
                assert np.array_equal(observations[agent]["frontiers"], features_of(found, here, slots))
                looked[robot] = env.episode.steps
            jumps, busy, maps[robot] = jumps + has_jumped, busy + (not info.get("is_deciding", True)), of_map
    assert jumps and (busy or kind == "velocity")


@pytest.mark.parametrize("are_shown", [False, True])
def test_waypoint_steps_look_for_candidates_only_if_they_are_shown(are_shown):
    env = twc_env.parallel_env(config=settings(("waypoint", "synchronous"), **{"observation.frontiers": are_shown}))
    env.reset(seed=0)
    env.step({agent: np.full(2, 0.1) for agent in env.agents})
    assert any(len(found.frontiers_m) > 0 for found in env.episode.macro_actions.candidates) == are_shown


def test_a_waypoint_step_ends_with_the_last_or_with_the_first_arrival():
    lengths = {}
    for timing in ("synchronous", "asynchronous"):
        env = twc_env.parallel_env(config=settings(("waypoint", timing), **{"action.decision_max_s": 20.0}))
        env.reset(seed=0)
        goals = {"robot_0": [0.1, 0.0], "robot_1": [0.8, 0.3], "robot_2": [-0.6, 0.6]}
        _, _, _, _, infos = env.step(goals)
        lengths[timing] = infos["robot_0"]["time_steps"]
        if timing == "synchronous":
            assert all(info["is_deciding"] for info in infos.values())
        else:
            assert not all(info["is_deciding"] for info in infos.values())
    assert 0 < lengths["asynchronous"] < lengths["synchronous"] <= 200


def test_greedy_choices_explore_a_building():
    env = twc_env.parallel_env(map="gen:office:120:5", max_cycles=900, config={"action.kind": "frontier"})
    _, infos = env.reset(seed=0)
    total = 0.0
    while env.agents:
        _, rewards, _, _, infos = env.step({a: int(np.argmax(infos[a]["action_mask"])) for a in env.agents})
        total += rewards["robot_0"]
    assert total == pytest.approx(infos["robot_0"]["coverage_correct"])
    assert total > 0.9


@pytest.mark.parametrize("action", ACTIONS)
def test_every_block_can_be_rebuilt_from_the_frames_for_every_kind_of_action(action, monkeypatch):
    contacts, think = [], Episode._think
    monkeypatch.setattr(Episode, "_think", lambda self, now: (think(self, now), contacts.append(self.contacts)))
    more = {"slam.k_visibility.enabled": True, "action.decision_max_s": 3.0, "link.loss_probability": 0.3}
    config = settings(action, **ALL_BLOCKS, **more)
    env = twc_env.parallel_env(map="twin-02", max_cycles=200, config=config)
    random = np.random.default_rng(0)
    observations, infos = env.reset(seed=0, options={"starts": "map"})
    engine, builder = CooperativeSlam(env.config, 3), ObservationBuilder(env.config)
    search, macro_actions = CandidateSearch(env.config), MacroActions(env.config)
    seen = set()
    while env.agents:
        for frames in env.frames_of_step or [env.frames]:
            engine.update(frames, contacts.pop(0))
            beliefs = [engine.belief(robot) for robot in range(3)]
            builder.notice(frames, beliefs)
        looker = search if action[0] == "velocity" else macro_actions
        macro_actions.is_deciding[:] = [info.get("is_deciding", True) for info in infos.values()]
        looker.look(beliefs)
        built = builder.build(looker.candidates, [macro_actions.mask(robot) for robot in range(3)])
        for own, observation in zip(built, observations.values(), strict=True):
            assert own.keys() == observation.keys()
            for name in own:
                assert np.array_equal(own[name], observation[name]), name
                seen |= {name} if own[name].any() else set()
        observations, _, _, _, infos = env.step(random_actions(env, infos, random))
    assert seen == observations["robot_0"].keys()


VIEWS = {
    "action.kind": "frontier", "action.goals": "views", "action.decision_max_s": 1.0, "observation.gains": True
}  # fmt: skip


def test_the_first_choice_of_views_explores_a_building_and_is_made_anew_every_second():
    env = twc_env.parallel_env(map="gen:office:200:5", max_cycles=600, config=VIEWS)
    seen, infos = env.reset(seed=0)
    total, kinds = 0.0, set()
    while env.agents:
        for agent, info in infos.items():
            own = seen[agent]["frontiers"][: int(info["action_mask"][: env.config.action.frontier_slots].sum())]
            kinds |= {bool(row[4] > 0.0) for row in own}
        seen, rewards, _, _, infos = env.step({a: int(np.argmax(infos[a]["action_mask"])) for a in env.agents})
        assert infos["robot_0"]["time_steps"] <= 10
        total += rewards["robot_0"]
    assert total > 0.95 and kinds == {True, False}


@pytest.mark.parametrize("reverses", [False, True])
def test_robots_drive_backwards_to_goals_if_the_actions_say_so(reverses):
    env = twc_env.parallel_env(
        map="gen:office:200:5", robots=2, max_cycles=200, config={**VIEWS, "action.reverses": reverses}
    )
    _, infos = env.reset(seed=0)
    while env.agents:
        _, _, _, _, infos = env.step({a: int(np.argmax(infos[a]["action_mask"])) for a in env.agents})
    poses = np.asarray(env.result().true_poses)
    moved, heading = np.diff(poses[..., :2], axis=0), poses[:-1, :, 2]
    ahead_m = moved[..., 0] * np.cos(heading) + moved[..., 1] * np.sin(heading)
    assert ((ahead_m < -0.05).mean() > 0.1) == reverses


def test_the_view_to_which_another_robot_drives_moves_with_the_map():
    """The left half of 10 m is known; then its frame moves by 3 m, and robot 0 looks before the next tick."""
    log_odds, offered = np.zeros((100, 100), np.int16), []
    log_odds[:, :50] = -50
    macro_actions = MacroActions(override(EnvConfig(), {**VIEWS, "robots": 2}))
    stay = len(macro_actions.mask(0)) - 1
    for step, moved_m in enumerate((0.0, 3.0)):
        poses, grid = np.array([[2.5, 3.0, 0.0], [2.5, 5.0, 0.0]]), GridMap(log_odds, np.array([0.0, moved_m]), 0.1)
        poses[:, 1] += moved_m
        beliefs = [
            Belief(k, step, poses[k], grid, {1 - k: poses[1 - k]}, map_version=step, contact_steps={1 - k: step})
            for k in range(2)
        ]
        if step == 0:
            macro_actions.look(beliefs)
            macro_actions.assign({"robot_0": stay, "robot_1": 0}, ["robot_0", "robot_1"], beliefs)
        macro_actions.is_deciding[:] = True, False
        macro_actions.look(beliefs)
        offered.append(macro_actions.candidates[0])
    assert offered[1].frontiers_m == pytest.approx(offered[0].frontiers_m + [0.0, 3.0])
    assert offered[1].gains_m2 == pytest.approx(offered[0].gains_m2)


def test_views_to_which_a_robot_drove_are_not_offered_again():
    config = {**VIEWS, "action.timing": "asynchronous", "action.decision_max_s": 10.0}
    env = twc_env.parallel_env(map="gen:office:200:5", max_cycles=400, config=config)
    _, infos = env.reset(seed=0)
    near_m = []
    while env.agents:
        _, _, _, _, infos = env.step({a: int(np.argmax(infos[a]["action_mask"])) for a in env.agents})
        search = env.episode.macro_actions._search
        for robot, agent in enumerate(env.agents):
            if infos[agent]["is_deciding"] and search._spent_map[robot] == map_id(env.belief(agent)):
                places_m, spent_m = search.candidates[robot].frontiers_m, np.array(search._spent_m[robot])
                near_m += np.linalg.norm(places_m[:, None] - spent_m[None], axis=-1).ravel().tolist()
    assert len(near_m) > 20 and min(near_m) >= SPENT_M


def test_in_turn_one_robot_decides_at_a_time_in_every_period_and_when_it_has_arrived():
    config = {**VIEWS, "action.timing": "in-turn", "action.decision_max_s": 4.0}
    env = twc_env.parallel_env(map="gen:office:200:5", max_cycles=200, config=config)
    _, infos = env.reset(seed=0)
    decided, steps, early = [0] * 3, 0, 0
    while env.agents:
        (robot,) = [k for k, info in enumerate(infos.values()) if info["is_deciding"]]
        assert steps - decided[robot] <= 42
        early += 3 < steps - decided[robot] < 40
        decided[robot] = steps
        _, _, _, _, infos = env.step({a: int(np.argmax(infos[a]["action_mask"])) for a in env.agents})
        steps += infos["robot_0"]["time_steps"]
    assert early and min(decided) >= 158


def test_goals_of_robots_with_a_common_map_are_claimed(monkeypatch):
    claims = []

    def find(belief, terrain, finder, slots, range_m, claimed_m, spent_m):
        claims.append((len(belief.teammates), claimed_m))
        return find_views(belief, terrain, finder, slots, range_m, claimed_m, spent_m)

    monkeypatch.setattr("twc_env.exploration.macro_actions.find_views", find)
    for starts in ("starts", "none"):
        env = twc_env.parallel_env(
            map="gen:office:200:5", robots=2, max_cycles=100, config={**VIEWS, "slam.oracle": starts}
        )
        _, infos = env.reset(seed=0)
        claims.clear()
        while env.agents:
            goals_m = env.episode.macro_actions._drivers.goals_m.copy()
            _, _, _, _, infos = env.step({a: int(np.argmax(infos[a]["action_mask"])) for a in env.agents})
        assert any(len(claimed) for mates, claimed in claims if mates) == (starts == "starts")
        assert not any(len(claimed) for mates, claimed in claims if not mates)
        assert goals_m.any()


@pytest.mark.parametrize("goals", ["views", "frontiers"])
def test_what_a_view_shows_is_what_the_scanner_of_this_robot_would(monkeypatch, goals):
    ranges_m = []

    def find(belief, terrain, finder, slots, range_m, *others):
        ranges_m.append((belief.robot, range_m))
        return usual(belief, terrain, finder, slots, range_m, *others)

    name, usual = ("find_views", find_views) if goals == "views" else ("find_candidates", find_candidates)
    monkeypatch.setattr(f"twc_env.exploration.macro_actions.{name}", find)
    config = {**VIEWS, "action.goals": goals, "robot": ["wheeled", {"lidar.range_max_m": 3.5}]}
    config |= {"observation.gains": True, "observation.equal_shapes": True}
    env = twc_env.parallel_env(map="gen:office:200:5", max_cycles=20, config=config)
    env.reset(seed=0)
    assert dict(ranges_m) == {0: 10.0, 1: 3.5}


def test_a_robot_that_its_map_shuts_in_looks_through_narrower_gaps(monkeypatch):
    """Noise draws walls too thick; paths are found for a smaller radius, too."""
    floor = []

    def find(belief, terrain, *others):
        floor.append(int((terrain.cost > 0).sum()))
        return NOTHING if len(floor) % 2 else find_views(belief, terrain, *others)

    monkeypatch.setattr("twc_env.exploration.macro_actions.find_views", find)
    env = twc_env.parallel_env(map="gen:office:200:5", robots=1, max_cycles=20, config=VIEWS)
    _, infos = env.reset(seed=0)
    assert len(floor) >= 2 and floor[1] > floor[0]
    assert infos["robot_0"]["action_mask"][0] == 1


@pytest.mark.parametrize("heading", [0.5, 2.5, 5.0])
def test_a_robot_beside_a_wall_drives_to_a_waypoint(heading):
    """Its map showed a pocket of open floor around it alone; it had arrived at once, whatever it was told."""
    settings = {"action.kind": "waypoint", "lidar.beam_count": 180}
    env = twc_env.parallel_env(map="twin-01", robots=1, max_cycles=300, config=settings)
    env.reset(seed=0, options={"starts": [(21.33, 2.73, heading)]})
    random, decisions = np.random.default_rng(0), 0
    while env.agents:
        env.step({"robot_0": random.uniform(-1.0, 1.0, 2).astype(np.float32)})
        decisions += 1
    assert env.result()["path_length_m"] > 5.0 and decisions < 30
