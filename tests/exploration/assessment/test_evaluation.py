import json
import math
from dataclasses import replace

import numpy as np
import pytest

import twc_env
from twc_env.exploration.assessment import map_scores
from twc_env.records.geometry import compose, inverse
from twc_env.records.messages import GridMap
from twc_env.slam.merging.merge_review import MergeReview

KEYS = {
    "map", "robots", "seed", "steps", "sim_time_s", "coverage_believed", "coverage_true", "coverage_correct", "map_iou",
    "merged_robots", "wrong_merges", "team_ate_m", "per_robot_ate_m", "epe_m", "odometry_ate_m",
    "odometry_coverage_correct", "closures", "bytes_sent", "path_length_m", "collisions", "stuck_share",
    "config_digest", "version",
}  # fmt: skip
CLOSURE_KEYS = {"proposed", "accepted", "correct", "precision", "recall"}
STEPS = 500


@pytest.fixture(scope="module")
def log(explore):
    return explore(STEPS, max_cycles=STEPS)


@pytest.fixture(scope="module")
def result(log):
    return log.env.result()


@pytest.fixture(scope="module")
def perfect(explore):
    """One robot without odometry drift and range noise."""
    settings = {"odometry.drift": 0.0, "lidar.range_noise_std_m": 0.0}
    return explore(STEPS, robots=1, max_cycles=STEPS, config=settings).env.result()


def test_the_report_has_every_figure_under_its_name(result):
    assert set(result.figures) >= KEYS
    assert set(result.figures["closures"]) == CLOSURE_KEYS


def test_the_figures_are_plain_finite_values(result, perfect):
    for figures in (result.figures, perfect.figures):
        text = json.dumps(figures, allow_nan=False)
        assert set(json.loads(text)) == set(figures)


def test_precision_and_recall_without_closures_are_none():
    env = twc_env.parallel_env(robots=1, max_cycles=5)
    env.reset(seed=0)
    closures = env.result().figures["closures"]
    assert closures == {"proposed": 0, "accepted": 0, "correct": 0, "precision": None, "recall": None}


def test_the_report_contains_the_config_of_the_episode(log, result):
    figures = result.figures
    assert (figures["map"], figures["robots"], figures["seed"], figures["steps"]) == ("twin-01", 3, 0, STEPS)
    assert figures["sim_time_s"] == pytest.approx(STEPS * 0.1)
    assert figures["version"] == twc_env.__version__
    assert result.config == log.env.config


def test_perfect_sensors_give_a_nearly_perfect_report(perfect):
    figures = perfect.figures
    assert figures["odometry_ate_m"] < 1e-6
    assert figures["team_ate_m"] < 0.03
    assert figures["epe_m"] < 0.06
    assert figures["per_robot_ate_m"] == pytest.approx([figures["team_ate_m"]], abs=0.01)
    assert figures["coverage_correct"] == pytest.approx(figures["coverage_true"], abs=0.01)
    assert figures["coverage_correct"] > 0.3
    assert figures["merged_robots"] == 1
    assert figures["wrong_merges"] == 0
    assert figures["closures"]["precision"] in (None, 1.0)


def test_shares_lie_between_zero_and_one(result):
    for key in ("coverage_believed", "coverage_true", "coverage_correct", "map_iou", "stuck_share"):
        assert 0.0 <= result.figures[key] <= 1.05, key
    assert result.figures["coverage_correct"] <= result.figures["coverage_believed"] + 1e-9


def test_dead_reckoning_is_worse_than_slam(result):
    assert result.figures["odometry_ate_m"] > 2 * result.figures["team_ate_m"]
    assert result.figures["odometry_ate_m"] > 0.2


def test_the_paths_have_one_pose_per_robot_and_step(log, result):
    for poses in (result.true_poses, result.estimated_poses, result.odometry_poses):
        assert poses.shape == (STEPS + 1, 3, 3)
        assert np.isfinite(poses).all()
    assert result.odometry_poses[0] == pytest.approx(result.true_poses[0])
    assert result.true_poses[-1] == pytest.approx(log.env.state().reshape(3, 6)[:, :3], abs=1e-4)


def test_groups_partition_the_team_and_have_one_map_each(result):
    assert sorted(robot for group in result.groups for robot in group) == [0, 1, 2]
    assert len(result.groups) == len(result.grids) == len(result.pose_building_map)
    assert result.viewers == result.groups, "of a central mapper"
    sizes = [len(group) for group in result.groups]
    assert sizes == sorted(sizes, reverse=True)
    assert result.figures["merged_robots"] == sizes[0]


def test_the_alignment_maps_estimated_onto_true_paths(result):
    for group, pose in zip(result.groups, result.pose_building_map, strict=True):
        for robot in group:
            aligned = compose(pose, result.estimated_poses[:, robot])
            error = np.hypot(*(aligned - result.true_poses[:, robot])[:, :2].T)
            assert np.sqrt((error**2).mean()) < 0.3


def test_counts_of_closures_agree_with_the_list(result):
    figures, rows = result.figures["closures"], result.closures
    accepted = [row for row in rows if row["status"] == "accepted"]
    assert figures["proposed"] == len(rows) > 0
    assert figures["accepted"] == len(accepted)
    assert figures["correct"] == sum(row["correct"] for row in accepted)
    assert figures["precision"] == pytest.approx(figures["correct"] / len(accepted))
    for row in rows:
        assert row["status"] in ("accepted", "pending", "rejected")
        assert (row["reason"] == "") == (row["status"] == "accepted")


def test_the_ends_of_a_correct_closure_are_close_in_the_building_frame(result):
    rows = [row for row in result.closures if row["status"] == "accepted" and row["correct"]]
    assert rows
    for row in rows:
        assert math.dist(row["target_m"], row["source_m"]) < 6.0
        assert result.floorplan.cells().is_free(np.array([row["target_m"], row["source_m"]])).all()


def test_repeated_evaluation_changes_neither_result_nor_episode(explore, log, result):
    again = log.env.result()
    assert again.figures == result.figures
    watched = twc_env.parallel_env(robots=3, max_cycles=40)
    plain = explore(40, max_cycles=40)
    watched.reset(seed=0, options={"starts": "map"})
    for actions, rewards in zip(plain.actions, plain.rewards, strict=True):
        watched.result()
        assert watched.step(actions)[1] == rewards
    assert watched.result().figures == plain.env.result().figures


def test_a_result_does_not_change_in_later_steps(explore):
    log = explore(30)
    result = log.env.result()
    before = [grid.log_odds.copy() for grid in result.grids]
    poses, nodes = result.true_poses.copy(), result.graph["nodes"].copy()
    for _ in range(30):
        log.env.step(dict.fromkeys(log.env.agents, np.array([1.0, 0.4], np.float32)))
    assert all(np.array_equal(grid.log_odds, old) for grid, old in zip(result.grids, before, strict=True))
    assert np.array_equal(result.true_poses, poses)
    assert np.array_equal(result.graph["nodes"], nodes)


def test_a_result_right_after_reset_is_complete():
    env = twc_env.parallel_env(robots=2, max_cycles=5)
    env.reset(seed=0)
    result = env.result()
    assert (result.figures["steps"], result.figures["path_length_m"]) == (0, 0.0)
    assert 0.0 < result.figures["coverage_correct"] < 1.0
    assert all(isinstance(grid, GridMap) for grid in result.grids)


def test_the_last_info_contains_every_scalar_figure():
    env = twc_env.parallel_env(robots=2, max_cycles=5)
    env.reset(seed=0)
    for _ in range(5):
        infos = env.step(dict.fromkeys(env.agents, np.array([1.0, 0.4])))[-1]
    numbers = {name: value for name, value in env.result().figures.items() if isinstance(value, (int, float))}
    assert len(numbers) > 20
    for info in infos.values():
        assert {name: value for name, value in info.items() if name != "reward_terms"} == numbers


def test_a_moved_building_gets_the_same_report(explore, log, result):
    plan = log.env.floorplan.moved(np.array([12.0, -30.0, 0.8]))
    moved = explore(STEPS, max_cycles=STEPS, floorplan=plan).env.result()
    for key in ("team_ate_m", "odometry_ate_m", "epe_m", "path_length_m"):
        assert moved.figures[key] == pytest.approx(result.figures[key], abs=1e-3), key
    for key in ("merged_robots", "wrong_merges", "bytes_sent", "collisions"):
        assert moved.figures[key] == result.figures[key], key
    assert moved.figures["coverage_correct"] == pytest.approx(result.figures["coverage_correct"], abs=0.02)
    turned = compose(inverse(result.pose_building_map[0]), inverse(np.array([12.0, -30.0, 0.8])))
    assert compose(turned, moved.pose_building_map[0]) == pytest.approx(np.zeros(3), abs=1e-3)


def test_a_lossy_link_costs_bytes_but_not_accuracy(explore, result):
    lossy = explore(STEPS, max_cycles=STEPS, config={"link.loss_probability": 0.5}).env.result()
    assert lossy.figures["bytes_sent"] > 1.5 * result.figures["bytes_sent"]
    assert lossy.figures["wrong_merges"] == 0
    assert lossy.figures["team_ate_m"] < 0.3


@pytest.mark.parametrize(
    ("settings", "is_wrong"),
    [({"slam.pose_graph.robust": "dcs", "slam.merging.undo": False}, True), ({}, False)],
    ids=["stays", "is put right"],
)
def test_a_wrong_merge_stays_counted_whether_or_not_it_is_undone(
    monkeypatch, wrong_merges, explore, settings, is_wrong
):
    """Evidence for merges is falsified until four seconds after the first merge."""
    merged_at, review_of = [], MergeReview.wrong

    def wrong(review, step, one_by_one):
        if review.merges and not merged_at:
            merged_at.append(step)
        if merged_at and step >= merged_at[0] + 40:
            wrong_merges()
        return review_of(review, step, one_by_one)

    monkeypatch.setattr(MergeReview, "wrong", wrong)
    figures = explore(STEPS, max_cycles=STEPS, config=settings).env.result().figures
    assert figures["wrong_merges"] >= 1
    assert figures["merged_robots"] >= 2
    assert (figures["team_ate_m"] > 1.0) == is_wrong


def test_a_result_between_two_evaluations_adds_nothing_to_later_ones(monkeypatch):
    env = twc_env.parallel_env(robots=2, max_cycles=6, config={"reward.period_steps": 3})
    env.reset(seed=0)
    found, score_view = [], map_scores.score_view
    for step in range(1, 7):
        env.step(dict.fromkeys(env.agents, np.zeros(2)))
        wrong = ((0, 1),) if step == 4 else ()
        with monkeypatch.context() as lie:
            lie.setattr(map_scores, "score_view", lambda *given, w=wrong: replace(score_view(*given), wrong_pairs=w))
            found.append(env.result().figures["wrong_merges"])
    assert found == [0, 0, 0, 1, 0, 0]


def test_maps_are_evaluated_once_per_step(monkeypatch):
    evaluated, score_view = [], map_scores.score_view
    monkeypatch.setattr(map_scores, "score_view", lambda *given: evaluated.append(given[0]) or score_view(*given))
    env = twc_env.parallel_env(map="twin-02", robots=2, max_cycles=20, render_mode="rgb_array")
    env.reset(seed=0)
    for step in (1, 2):
        env.step(dict.fromkeys(env.agents, np.array([1.0, 0.0])))
        env.render()
        env.episode.caption()
        env.result()
        assert len(evaluated) == step * len(env.engine.views())


def test_maps_changed_within_a_step_are_evaluated_again(explore):
    env = explore(300, robots=3).env
    moment = env.snapshot()
    env.engine.finish()
    alone = env.result().figures
    env.restore(moment)
    assert env.result().figures != alone
    env.engine.finish()
    assert env.result().figures == alone
