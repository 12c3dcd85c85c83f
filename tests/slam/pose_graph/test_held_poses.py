import numpy as np

from twc_env.config import PoseGraphConfig
from twc_env.records.geometry import between, compose
from twc_env.slam.pose_graph.held_poses import contracted
from twc_env.slam.pose_graph.robust_back_end import refit_closures
from twc_env.slam.pose_graph.solver import Graph


def held_graph(random: np.random.Generator) -> tuple[np.ndarray, tuple]:
    """Ten held poses, five others, odometry among the others, and closures to and from held poses, with noise."""
    poses = np.column_stack([random.uniform(-20, 20, (15, 2)), random.uniform(-3, 3, 15)])
    ends = np.array([[k, k + 1] for k in range(14) if k != 9] + [[2, 11], [8, 12], [13, 5], [14, 0], [7, 14]])
    measured = compose(between(poses[ends[:, 0]], poses[ends[:, 1]]), random.normal(0, 0.02, (len(ends), 3)))
    turned = random.normal(size=(len(ends), 3, 3))
    information = turned @ np.swapaxes(turned, 1, 2) + 20 * np.eye(3)
    is_closure = np.arange(len(ends)) >= 13
    return poses, (ends, measured, information, is_closure, np.ones(len(ends), bool))


def test_a_fit_with_one_pose_for_all_held_ones_is_the_fit_that_holds_them_all():
    poses, parts = held_graph(np.random.default_rng(3))
    config, held = PoseGraphConfig(iterations_max=100), np.arange(10)
    whole = refit_closures(poses.copy(), Graph(*parts[:4]), parts[4], config, held)
    is_left, few = contracted(poses[:10], parts)
    small = refit_closures(poses[[0, *range(10, 15)]], Graph(*few[:4]), few[4], config, 0)
    assert np.abs(whole.poses[10:] - poses[10:]).max() > 0.005
    assert np.allclose(small.poses[1:], whole.poses[10:], atol=2e-3)
    assert np.count_nonzero(is_left) == len(few[0]) == 9
