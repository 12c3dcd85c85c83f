"""Figures of whole episodes worked out once more from what an episode left behind, slowly and by other means."""

import numpy as np
import pytest

import twc_env

SETTINGS = {
    "merged and apart": {"max_cycles": 220},
    "alone": {"robots": 1, "max_cycles": 60},
    "one breaks down": {"max_cycles": 80, "failure.robots": 1, "failure.robots_step": 20},
    "one never works": {"robots": 2, "max_cycles": 40, "failure.robots": 1, "failure.robots_step": 0},
    "peers": {"max_cycles": 120, "link.topology": "peer"},
    "no engine": {"max_cycles": 60, "slam.mode": "off"},
}


@pytest.fixture(scope="module", params=SETTINGS)
def result(request):
    from agents.policy import make_policy

    env = twc_env.parallel_env(config=SETTINGS[request.param])
    env.reset(seed=0)
    policy = make_policy("nearest-frontier", env.config)
    policy.reset(0, env.possible_agents)
    while env.agents:
        env.step(policy.act({agent: env.belief(agent) for agent in env.agents}))
    return env.result()


def turned(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def fitted(points: np.ndarray, onto: np.ndarray) -> np.ndarray:
    """The points (n, 2), moved by the rigid motion that brings them nearest: Kabsch, by singular values."""
    here, there = points.mean(axis=0), onto.mean(axis=0)
    u, _, vt = np.linalg.svd((points - here).T @ (onto - there))
    rotation = u @ np.diag([1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return (points - here) @ rotation + there


def rms(away_m: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(away_m**2, axis=-1))))


def shown_free(result, at_m: np.ndarray) -> np.ndarray:
    """Whether the largest group's map shows places (n, 2) of the building as free."""
    grid, (x, y, heading) = result.grids[0], result.pose_building_map[0]
    if not grid.log_odds.size:
        return np.zeros(len(at_m), bool)
    cells = np.floor(((at_m - [x, y]) @ turned(heading) - grid.origin_m) / grid.resolution_m).astype(int)
    is_inside = ((cells >= 0) & (cells < grid.log_odds.shape[::-1])).all(axis=1)
    column, row = np.where(is_inside[:, None], cells, 0).T
    return is_inside & (grid.log_odds[row, column] < 0)


def test_covered_floor_is_what_the_map_shows_free_where_floor_is(result):
    cells = result.floorplan.cells()
    rows, columns = np.nonzero(cells.free)
    centres = cells.origin_m + (np.column_stack([columns, rows]) + 0.5) * cells.resolution_m
    right = shown_free(result, centres).sum() * cells.resolution_m**2
    floor = len(centres) * cells.resolution_m**2
    believed = (result.grids[0].log_odds < 0).sum() * result.grids[0].resolution_m ** 2
    figures = result.figures
    assert figures["coverage_correct"] == pytest.approx(right / floor, abs=2e-4)  # cells that an edge runs through
    assert figures["coverage_believed"] == pytest.approx(believed / floor)
    assert figures["map_iou"] == pytest.approx(right / (floor + max(believed, right) - right), abs=2e-4)


def test_errors_of_paths_are_those_of_kabsch(result):
    figures, true = result.figures, result.true_poses
    estimated = result.estimated_poses
    each = [rms(fitted(estimated[:, r, :2], true[:, r, :2]) - true[:, r, :2]) for r in range(true.shape[1])]
    assert figures["per_robot_ate_m"] == pytest.approx(each, abs=1e-9)
    odometry = fitted(result.odometry_poses[..., :2].reshape(-1, 2), true[..., :2].reshape(-1, 2))
    assert figures["odometry_ate_m"] == pytest.approx(rms(odometry - true[..., :2].reshape(-1, 2)), abs=1e-9)
    if result.config.link.topology == "central":
        away = []
        for group in result.groups:
            own, truth = (poses[:, list(group), :2].reshape(-1, 2) for poses in (estimated, true))
            away.append(fitted(own, truth) - truth)
        assert figures["team_ate_m"] == pytest.approx(rms(np.concatenate(away)), abs=1e-9)
    assert figures["merged_robots"] == max(map(len, result.groups))


def test_end_points_and_lengths_are_those_of_the_paths(result):
    figures, true = result.figures, result.true_poses
    gaps = []
    for robot in range(true.shape[1]):
        ends = []
        for poses in (true, result.estimated_poses):
            first, last = poses[0, robot], poses[-1, robot]
            ends.append((last[:2] - first[:2]) @ turned(first[2]))
        gaps.append(np.linalg.norm(ends[0] - ends[1]))
    assert figures["epe_m"] == pytest.approx(np.mean(gaps), abs=1e-9)
    steps_m = np.linalg.norm(np.diff(true[..., :2], axis=0), axis=-1)
    assert figures["path_length_m"] == pytest.approx(steps_m.sum())
    assert figures["sim_time_s"] == pytest.approx(0.1 * len(steps_m))
