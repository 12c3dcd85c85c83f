"""Failed robots, link outages, and a receiver with an RSSI offset."""

import json
from unittest import mock

import numpy as np
import pytest

import twc_env
from twc_env.__main__ import main
from twc_env.config import FailureConfig
from twc_env.records.geometry import between, compose
from twc_env.records.messages import Contacts, SensorFrame
from twc_env.world.motion.failures import Failures, FrameLoss

STOP = 30


def play(steps, robot=(), **failure):
    """Run an episode in which robots drive ahead and turn slowly; returns true poses (steps + 1, 2, 3) and the env."""
    config = {"robots": 2, "robot": robot, **{f"failure.{key}": value for key, value in failure.items()}}
    env = twc_env.parallel_env(max_cycles=200, config=config)
    env.reset(seed=3)
    poses = [env.state().reshape(2, 6)[:, :3]]
    for _ in range(steps):
        env.step({agent: np.array([0.5, 0.3]) for agent in env.agents})
        poses.append(env.state().reshape(2, 6)[:, :3])
    return np.array(poses), env


def test_a_failed_robot_stops_and_sends_nothing_while_the_others_continue():
    poses, env = play(90, robots=1, robots_step=STOP)
    whole, _ = play(90)
    assert np.array_equal(poses[:STOP], whole[:STOP])
    assert np.hypot(*(poses[STOP + 5 :, 1, :2] - poses[STOP + 5, 1, :2]).T).max() < 1e-3
    assert np.hypot(*(poses[-1, 0, :2] - poses[STOP, 0, :2])) > 0.5
    assert env.engine.team.keyframes[1][-1].step < STOP
    assert "robot 1 not heard since 2.9 s" in env.result().figures["lacked"]


def test_keyframes_taken_in_a_link_outage_arrive_after_it():
    _, cut = play(95, link_begin_step=10, link_end_step=90)
    _, whole = play(95)
    lines = cut.result().figures["lacked"]
    assert [line for line in lines if "not heard" in line] == [
        f"robot {robot} not heard from 0.9 s to 9.0 s" for robot in (0, 1)
    ]
    assert [len(path) for path in cut.engine.team.keyframes] == [len(path) for path in whole.engine.team.keyframes]
    assert not any("not heard" in line for line in whole.result().figures["lacked"])


@pytest.mark.parametrize("listeners", [1, 3])
def test_failed_robots_neither_send_nor_receive(listeners):
    failures = Failures(FailureConfig(robots=1, robots_step=4), (0.0, 0.0, 0.0))
    everyone = np.ones((listeners, 3), bool)
    assert failures.contacts(3, Contacts(everyone, everyone)).heard.all()
    left = failures.contacts(4, Contacts(everyone, everyone)).heard
    assert left[:, 2].sum() == 0 and left[0, :2].all()
    assert listeners == 1 or not left[2].any()


@pytest.mark.parametrize("topology", ["central", "peer"])
def test_the_age_of_contact_grows_after_a_failure_and_in_a_cut(topology):
    failure = {"robots": 1, "robots_step": 40, "link_begin_step": 10, "link_end_step": 20}
    link = {"link.topology": topology, "link.range_max_m": 1000.0}
    config = {**link, **{f"failure.{key}": value for key, value in failure.items()}}
    env = twc_env.parallel_env(robots=3, max_cycles=60, config=config)
    env.reset(seed=3)
    for step in range(1, 61):
        observations, *_ = env.step({agent: np.array([0.5, 0.3]) for agent in env.agents})
        cut_s = 0.1 * (step - 9) if 10 <= step < 20 else 0.0
        failed_s = 0.1 * (step - 39) if step >= 40 else cut_s
        shares = observations["robot_0"]["team"][:, 4]
        assert 10.0 * shares / (1.0 - shares) == pytest.approx([cut_s, failed_s], abs=1e-5)


def test_a_device_offset_shifts_all_rssi():
    _, odd = play(3, device_offset_db=10.0)
    _, even = play(3)
    levels = [env.engine.team.keyframes[1][0].fingerprint for env in (odd, even)]
    common = np.isin(levels[0].macs, levels[1].macs)
    assert np.isin(levels[1].macs, levels[0].macs).all()
    assert levels[0].rssi_dbm[common] == pytest.approx(levels[1].rssi_dbm + 10.0, abs=1.0)


def test_a_failed_robot_cannot_be_pushed():
    env = twc_env.parallel_env(robots=2, max_cycles=200, config={"failure.robots": 1, "failure.robots_step": 0})
    env.reset(seed=3, options={"starts": np.array([[9.0, 1.2, 0.0], [9.8, 1.2, 0.0]])})
    for _ in range(40):
        env.step({agent: np.array([1.0, 0.0]) for agent in env.agents})
    pusher, pushed = env.state().reshape(2, 6)[:, :2]
    assert np.hypot(*(pushed - [9.8, 1.2])) < 0.02
    assert np.hypot(*(pusher - pushed)) > 0.38  # the robots touch


def test_a_failed_robot_has_empty_observations_and_no_frames():
    config = {"failure.robots": 1, "failure.robots_step": STOP, "observation.sign_memory_s": 1.0}
    env = twc_env.parallel_env(robots=2, max_cycles=2 * STOP, config=config)
    env.reset(seed=3)
    for step in range(1, 2 * STOP + 1):
        observations, *_ = env.step({agent: np.array([0.5, 0.3]) for agent in env.agents})
        assert [frame.robot for frame in env.frames] == ([0, 1] if step < STOP else [0])
        for block in ("lidar", "wifi"):
            assert observations["robot_1"][block].any() == (step < STOP) and observations["robot_0"][block].any()
    assert not observations["robot_1"]["signs"].any()


@pytest.mark.parametrize(("failed", "begin"), [(1, 0), (1, STOP), (2, STOP), (2, 1)])
@pytest.mark.parametrize("topology", ["central", "peer"])
def test_a_log_with_failed_robots_replays_exactly(tmp_path, topology, failed, begin):
    failure = [f"failure.robots_step={begin}", f"failure.robots={failed}", f"link.topology={topology}"]
    settings = [part for setting in failure for part in ("--set", setting)]
    record = ["record", "--steps", "90", "--robots", "2", *settings, "--out", str(tmp_path)]
    episodes: list = []
    real = twc_env.ExplorationEnv.reset

    def noted(env, **how):
        begun = real(env, **how)
        episodes.append(env.episode)
        return begun

    with mock.patch.object(twc_env.ExplorationEnv, "reset", noted):
        assert main(record) == 0
    replay = ["replay", str(tmp_path), "--truth", str(tmp_path / "truth.npz")]
    assert main([*replay, "--json", str(tmp_path / "found.json")]) == 0
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["steps"] == 91
    assert found["team_ate_m"] == pytest.approx(episodes[-1].result().figures["team_ate_m"], rel=1e-9)
    poses = [episodes[-1].engine.pose_map_robot(robot) for robot in range(2)]
    assert found["final_poses"] == np.round(poses, 6).tolist()


@pytest.mark.parametrize("timing", ["synchronous", "asynchronous"])
def test_no_long_action_waits_for_a_robot_that_has_failed_and_it_decides_nothing(timing):
    """Robot 1 fails on its way to a frontier; robot 0 stays for one second at a time."""
    action = {"action.kind": "frontier", "action.timing": timing, "action.decision_max_s": 6.0}
    config = {**action, "failure.robots": 1, "failure.robots_step": 5}
    env = twc_env.parallel_env(robots=2, max_cycles=60, config=config)
    _, infos = env.reset(seed=3)
    assert infos["robot_1"]["is_deciding"]
    stay, lengths = env.action_space("robot_0").n - 1, []
    while env.agents:
        _, _, _, _, infos = env.step({"robot_0": stay, "robot_1": 0})
        lengths.append(infos["robot_0"]["time_steps"])
        assert infos["robot_0"]["is_deciding"] and not infos["robot_1"]["is_deciding"]
        assert np.flatnonzero(infos["robot_1"]["action_mask"]).tolist() == [stay]
    assert lengths == [10] * 6


@pytest.mark.parametrize("timing", ["synchronous", "asynchronous", "in-turn"])
def test_steps_of_a_team_that_has_failed_take_the_longest_time(timing):
    action = {"action.kind": "waypoint", "action.timing": timing, "action.decision_max_s": 2.0}
    config = {**action, "failure.robots": 2, "failure.robots_step": 0}
    env = twc_env.parallel_env(robots=2, max_cycles=60, config=config)
    _, infos = env.reset(seed=3)
    assert not any(info["is_deciding"] for info in infos.values())
    while env.agents:
        _, _, _, _, infos = env.step({agent: np.zeros(2) for agent in env.agents})
        assert infos["robot_0"]["time_steps"] == 20


def test_robots_that_start_later_neither_move_nor_send_before_and_have_correct_headings_after():
    poses, env = play(90, start_spread_s=3.0)
    assert np.ptp(poses[:30, 1], axis=0).max() < 1e-9 and np.hypot(*(poses[-1, 1, :2] - poses[30, 1, :2])) > 0.3
    assert env.engine.team.keyframes[1][0].step == STOP and env.engine.team.keyframes[0][0].step == 0
    moved = between(poses[STOP, 1], poses[-1, 1])
    believed = between(env.episode.record.odom_poses[STOP, 1], env.episode.record.odom_poses[-1, 1])
    assert believed == pytest.approx(moved, abs=0.05)


@pytest.mark.parametrize(
    ("starts_s", "spread_s", "team_s"), [((3.0, 0.0), 0.0, 0.0), ((2.0, 1.0), 2.0, 0.0), ((0.0, 2.0), 0.0, 1.0)]
)
def test_each_robot_may_have_a_start_time_of_its_own(starts_s, spread_s, team_s):
    """Also the first one, and all: nobody moves before its time, and all do after it."""
    robots = [{"failure.start_s": start_s} if start_s else {} for start_s in starts_s]
    poses, env = play(60, robots, start_spread_s=spread_s, start_s=team_s)
    for robot, own_s in enumerate(starts_s):
        begun = round(10 * ((own_s or team_s) + robot * spread_s))
        assert np.ptp(poses[: begun + 1, robot], axis=0).max() < 1e-9
        assert np.hypot(*(poses[-1, robot, :2] - poses[begun, robot, :2])) > 0.3
        assert env.engine.team.keyframes[robot][0].step == begun


def test_the_frame_after_lost_ones_has_the_odometry_since_the_last_that_arrived():
    random, motions, arrived = np.random.default_rng(0), [], []
    loss = FrameLoss(0.6, 1, seed=3)
    for step in range(60):
        motions.append(random.normal(0.0, 0.1, 3))
        frames = loss.arriving([SensorFrame(0, step, 0.1 * step, motions[-1], motions[-1][2] / 0.1, np.ones(8))])
        arrived += frames
    last = arrived[-1].step
    whole, told = np.zeros(3), np.zeros(3)
    for motion in motions[: last + 1]:
        whole = compose(whole, motion)
    for frame in arrived:
        told = compose(told, frame.odometry)
    assert 10 < len(arrived) < 40 and told == pytest.approx(whole)
    turned = sum(frame.turn_rate_rad_s * n * 0.1 for frame, n in zip(arrived, counts_of(arrived), strict=True))
    assert turned == pytest.approx(sum(motion[2] for motion in motions[: last + 1]))


def counts_of(frames):
    """Number of time steps since the frame before, for each frame."""
    return np.diff([-1, *(frame.step for frame in frames)]).tolist()


def test_a_third_of_lost_frames_costs_no_more_than_their_age():
    _, env = play(150, frame_loss_probability=0.3)
    assert env.result().figures["team_ate_m"] < 0.15
