"""Without laser, robots share a map only as long as their relative pose is sufficiently certain."""

import copy

import numpy as np
import pytest

import agents
from twc_env.config import EnvConfig, override
from twc_env.exploration.environment import ExplorationEnv
from twc_env.records.geometry import between
from twc_env.records.messages import LoopCandidate, LoopClosure
from twc_env.slam.engine import CooperativeSlam
from twc_env.slam.matching.loop_verification import SIGN_ALONE_STD
from twc_env.slam.merging import merge_trial
from twc_env.slam.merging.map_optimiser import MapOptimiser
from twc_env.slam.merging.merge_trial import MergeTrials

NO_SIGNS = {"slam.cues.lidar": False, "slam.cues.text": False}
BLIND = {
    "slam.merging.wifi_check": False,
    "slam.merging.contradiction_max": 1.0,
    "slam.merging.signs_read_alike_min": 0,
}
MET_STEP = 60


@pytest.mark.parametrize("building", ["train/0010", "train/0015"])
def test_teams_without_laser_merge_and_never_wrongly(building):
    changes = {"map": building, "robots": 4, "max_cycles": 1000, "slam.cues.lidar": False, "link.topology": "central"}
    env = ExplorationEnv(config=override(EnvConfig(), changes))
    env.reset(seed=0)
    policy = agents.make_policy("nearest-frontier", env.config)
    policy.reset(0, env.possible_agents)
    while env.agents:
        env.step(policy.act({agent: env.belief(agent) for agent in env.agents}))
    figures = env.result().figures
    assert figures["wrong_merges"] == 0 and figures["merged_robots"] >= 2


def met(team, true_poses, count: int) -> list[LoopClosure]:
    """`count` true closures, each by its own sign, along the paths of robots 0 and 1 so far."""
    first, second = (true_poses[team.keyframe_steps(robot), robot] for robot in (0, 1))
    made = []
    for k in np.linspace(0, min(len(first), len(second)) - 1, count).astype(int).tolist():
        pose = between(first[k], second[k])
        candidate = LoopCandidate((0, k), (1, k), pose, "twc", np.array([3.0 * len(made), 0.0]), text_similarity=1.0)
        made.append(LoopClosure(candidate, pose, np.diag(np.square(SIGN_ALONE_STD)), 0.0, "accepted"))
    return made


def meet(team, true_poses, count: int = 5) -> None:
    for closure in met(team, true_poses, count):
        team._graph.add_closure(closure)
        team._graph.set_pending([closure])
    team._retry_merges()


@pytest.fixture(scope="module")
def strayed(recorded):
    """A team without signs of which two robots met early, and its groups after every step."""
    config, frames, true_poses = recorded
    engine, groups = CooperativeSlam(override(config, NO_SIGNS | BLIND), 3), []
    for step, now in enumerate(frames):
        engine.update(now)
        if step == MET_STEP:
            meet(engine.team, true_poses)
        groups.append([group.robots for group in engine.team.groups])
    return engine, groups


def test_a_group_is_split_when_relative_poses_become_uncertain(strayed):
    _, groups = strayed
    assert groups[MET_STEP] == [(0, 1), (2,)]
    assert sorted(groups[-1]) == [(0,), (1,), (2,)]


def test_a_group_with_unknown_covariance_is_not_split(met_early, monkeypatch):
    """As if the information matrix of their closures were singular."""
    meet(*met_early)
    assert met_early[0]._trials.uncertain_split((0, 1)) is None
    monkeypatch.setattr(merge_trial, "frame_stds", lambda *_: np.full((2, 2, 2), np.nan))
    assert met_early[0]._trials.uncertain_split((0, 1)) is None


def test_closures_of_a_split_group_are_pending_and_no_merge_counts_as_undone(strayed):
    engine, _ = strayed
    assert engine.team.merges_undone == 0
    assert {closure.status for closure in engine.team.closures} == {"pending"}


def test_a_split_group_is_merged_again_after_another_meeting(strayed, recorded):
    engine, true_poses = copy.deepcopy(strayed[0]), recorded[2]
    meet(engine.team, true_poses, 12)
    assert engine.team.groups[0].robots == (0, 1)


@pytest.fixture
def met_early(recorded):
    """A team without scan matching, on the step after which two of its robots meet, and the true poses."""
    config, frames, true_poses = recorded
    engine = CooperativeSlam(override(config, NO_SIGNS | BLIND), 3)
    for now in frames[: MET_STEP + 1]:
        engine.update(now)
    return engine.team, true_poses


def test_maps_are_merged_into_the_solution_that_the_trial_found(met_early, monkeypatch):
    team, true_poses = met_early
    found, real = [], MergeTrials.merged
    monkeypatch.setattr(MergeTrials, "merged", lambda *args: found.append(real(*args)) or found[-1])
    monkeypatch.setattr(MapOptimiser, "optimise", lambda *_, **__: None)
    meet(team, true_poses)
    nodes, poses = found[-1]
    assert team.groups[0].robots == (0, 1)
    np.testing.assert_allclose(team._graph.poses[nodes], poses, atol=1e-12)
