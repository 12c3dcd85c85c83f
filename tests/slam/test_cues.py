"""Every combination of cues on recorded drives: the engine with the measurements that the cues leave."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from tests.conftest import wander_by_scan
from twc_env.config import CuesConfig, from_dict
from twc_env.maps import load_map
from twc_env.records.geometry import between, compose
from twc_env.records.messages import Keyframe, SensorFrame, WifiScan
from twc_env.slam.cues import restricted_config, restricted_frame
from twc_env.slam.engine import CooperativeSlam
from twc_env.slam.radio.radio_similarity import CELL_ID_MIN
from twc_env.world.world import World

NAMES = ("text", "wifi", "lte", "lidar")
SUBSETS = [subset for size in range(5) for subset in itertools.combinations(NAMES, size)]
CONFIG = from_dict(
    {
        "robots": 1,
        "dynamics": {"time_step_s": 0.25},
        "lidar": {"beam_count": 90},
        "odometry": {"platform": "skid-steer"},
        "radio": {"cells": {"count": 60}},
    }
)


def with_cues(subset) -> CooperativeSlam:
    cues = CuesConfig(**{name: name in subset for name in NAMES})
    return CooperativeSlam(replace(CONFIG, slam=replace(CONFIG.slam, cues=cues)), 1)


def driven(seed):
    """Frames, true poses (steps, 3) and dead-reckoned poses (steps, 3), both relative to the first."""
    world = World(CONFIG, load_map("twin-02"))
    world.reset(seed)
    frames, truth, odometry = [], [], [np.zeros(3)]
    for step in range(500):
        frames += world.sense()
        truth.append(world.poses[0].copy())
        if step:
            odometry.append(compose(odometry[-1], frames[-1].odometry))
        world.step(wander_by_scan(frames[-1].ranges_m, step)[None])
    return frames, between(truth[0], np.array(truth)), np.array(odometry)


@pytest.fixture(scope="module")
def drives():
    return [driven(seed) for seed in range(10)]


def errors_m(subset, drives):
    """Mean position error [m] of the keyframes of each drive, and of odometry at the same steps: two (drives,)."""
    found = []
    for frames, truth, odometry in drives:
        engine = with_cues(subset)
        for frame in frames:
            engine.update([frame])
        engine.finish()
        steps, poses = engine.team.keyframe_steps(0), engine.team.poses_of(0)
        found.append([np.linalg.norm((path - truth[steps])[:, :2], axis=1).mean() for path in (poses, odometry[steps])])
    return np.transpose(found)


@pytest.fixture(scope="module")
def blind(drives):
    return errors_m((), drives)[0].mean()


@pytest.mark.parametrize("subset", SUBSETS, ids="+".join)
def test_no_combination_of_cues_is_worse_than_odometry(subset, drives, blind):
    errors, by_odometry = errors_m(subset, drives)
    error, odometry = errors.mean(), by_odometry.mean()
    assert odometry > 1.0
    assert error <= min(odometry, blind) + 0.02
    if "lidar" in subset:
        assert errors.max() < 0.05
    elif "text" in subset:
        assert error < 0.9 * blind
    elif "wifi" in subset:
        assert error < 0.75 * blind, "WiFi puts odometry right"


def test_a_disabled_cue_is_not_used():
    macs = np.array([1, 2, CELL_ID_MIN + 1])
    frame = SensorFrame(0, 0, 0.0, np.zeros(3), 0.0, np.ones(4), WifiScan(macs, np.array([-50.0, -60.0, -90.0])))
    assert restricted_frame(frame, CuesConfig(wifi=False)).wifi.macs.tolist() == [CELL_ID_MIN + 1]
    assert restricted_frame(frame, CuesConfig(lte=False)).wifi.macs.tolist() == [1, 2]
    listed = replace(frame, wifi=WifiScan(macs.tolist(), [-50.0, -60.0, -90.0]))
    assert restricted_frame(listed, CuesConfig(lte=False)).wifi.macs.tolist() == [1, 2]


def test_the_recogniser_follows_from_the_enabled_cues():
    def recogniser(**off):
        return restricted_config(
            replace(CONFIG, slam=replace(CONFIG.slam, cues=CuesConfig(**off)))
        ).slam.place_recognition

    assert recogniser().recogniser == "twc"
    assert recogniser(text=False).recogniser == "wifi"
    assert recogniser(wifi=False).recogniser == "text"
    assert recogniser(text=False, wifi=False).recogniser == "lidar"
    assert recogniser(lidar=False).proximity_m == 0.0


def test_a_robot_without_radio_has_no_radio_constraints(drives):
    frames, _, _ = drives[0]
    engine = with_cues(("wifi",))
    for frame in frames[:200]:
        engine.update([replace(frame, wifi=None)])
    keyframes: list[Keyframe] = engine.team.keyframes[0]
    assert len(keyframes) > 10
    poses = np.array([k.pose_odom for k in keyframes])
    assert engine.team.poses_of(0) == pytest.approx(poses, abs=1e-9)
