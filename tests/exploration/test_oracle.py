import numpy as np
import pytest

import twc_env

STEPS = 150


@pytest.mark.parametrize("topology", ["central", "peer"])
def test_with_true_starts_all_robots_share_a_correct_frame_from_the_first_step(explore, topology):
    log = explore(STEPS, max_cycles=STEPS, config={"slam.oracle": "starts", "link.topology": topology})
    assert len(log.env.belief("robot_2").teammates) == 2
    if topology == "central":
        assert all(observation["team"][:, 0].all() for observation in log.observations[0].values())
    figures = log.env.result().figures
    assert figures["merged_robots"] == 3 and figures["wrong_merges"] == 0
    assert figures["team_ate_m"] < 0.1


def test_with_true_poses_the_estimate_is_exact_to_a_millimetre(explore):
    log = explore(STEPS, max_cycles=STEPS, config={"slam.oracle": "poses", "odometry.drift": 3.0})
    assert log.env.config.odometry.drift == 0.0
    result = log.env.result()
    assert result.figures["team_ate_m"] < 1e-3
    assert result.figures["closures"]["proposed"] == 0
    assert result.figures["wall_iou"] > 0.05
    belief = log.env.belief("robot_1")
    apart = np.hypot(*(belief.teammates[0][:2] - belief.pose_map_robot[:2]))
    true = log.env.state().reshape(3, 6)
    assert apart == pytest.approx(np.hypot(*(true[0, :2] - true[1, :2])), abs=1e-3)


def test_without_merging_robots_stay_in_separate_groups(explore):
    log = explore(400, max_cycles=400, config={"slam.merging.enabled": False})
    assert log.env.result().figures["merged_robots"] == 1
    assert any(c.status == "pending" for c in log.env.engine.team.closures), "nobody met: nothing was refused"


def test_without_an_oracle_the_engine_gets_no_true_starts(explore, monkeypatch):
    told = []
    monkeypatch.setattr(twc_env.CooperativeSlam, "give_starts", lambda self, poses: told.append(poses))
    explore(3)
    assert told == []


@pytest.mark.parametrize("oracle", ["starts", "poses"])
@pytest.mark.parametrize("topology", ["central", "peer"])
def test_an_episode_with_one_keyframe_per_robot_can_be_finished(explore, oracle, topology):
    log = explore(2, robots=2, config={"slam.oracle": oracle, "link.topology": topology}, max_cycles=2)
    assert log.env.agents == []
    assert log.env.result().figures["merged_robots"] == 2
