"""Figures of episodes recomputed from their results by slow, independent implementations."""

import numpy as np
import pytest
from twc_env.agents import compare

import twc_env
from twc_env import metrics
from twc_env.config import EnvConfig, override

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
    from twc_env.agents.policy import make_policy

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
    """The points (n, 2) after rigid alignment with least squared error (Kabsch algorithm)."""
    here, there = points.mean(axis=0), onto.mean(axis=0)
    u, _, vt = np.linalg.svd((points - here).T @ (onto - there))
    rotation = u @ np.diag([1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return (points - here) @ rotation + there


def rms(away_m: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(away_m**2, axis=-1))))


def shown_free(result, at_m: np.ndarray) -> np.ndarray:
    """(n,) bool: whether the largest group's map shows points (n, 2) of the building frame as free."""
    grid, (x, y, heading) = result.grids[0], result.pose_building_map[0]
    if not grid.log_odds.size:
        return np.zeros(len(at_m), bool)
    cells = np.floor(((at_m - [x, y]) @ turned(heading) - grid.origin_m) / grid.resolution_m).astype(int)
    is_inside = ((cells >= 0) & (cells < grid.log_odds.shape[::-1])).all(axis=1)
    column, row = np.where(is_inside[:, None], cells, 0).T
    return is_inside & (grid.log_odds[row, column] < 0)


def test_coverage_is_the_floor_that_the_map_shows_as_free(result):
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


def test_trajectory_errors_equal_those_of_kabsch_alignment(result):
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


def test_end_point_error_and_path_length_follow_from_the_paths(result):
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


def nearest_wall(at_m: np.ndarray, walls_m: np.ndarray) -> tuple[float, int, float]:
    """Distance [m] of a point to the nearest of the walls (k, 2, 2), its index, and the position along it [m]."""
    begin, along = walls_m[:, 0], walls_m[:, 1] - walls_m[:, 0]
    length = np.linalg.norm(along, axis=1)
    share = np.clip(np.einsum("kd,kd->k", at_m - begin, along) / length**2, 0.0, 1.0)
    away = np.linalg.norm(begin + share[:, None] * along - at_m, axis=1)
    wall = int(np.argmin(away))
    return float(away[wall]), wall, float(share[wall] * length[wall])


def test_wall_thickness_is_wall_area_per_length_of_observed_stretches(result):
    grid, (x, y, heading), walls_m = result.grids[0], result.pose_building_map[0], result.floorplan.walls_m
    found = metrics.wall_thickness_m(
        grid.log_odds, grid.origin_m, grid.resolution_m, result.pose_building_map[0], walls_m
    )
    count, stretches = 0, {}
    for row, column in np.argwhere(grid.log_odds > 0):
        at = np.asarray(grid.origin_m) + (np.array([column, row]) + 0.5) * grid.resolution_m
        away, wall, along = nearest_wall(turned(heading) @ at + [x, y], walls_m)
        if away <= 1.0:
            length, count = float(np.linalg.norm(walls_m[wall, 1] - walls_m[wall, 0])), count + 1
            stretch = min(int(along / 0.25), int((length - 1e-9) / 0.25))
            stretches[wall, stretch] = min(0.25, length - 0.25 * stretch)
    if count == 0:
        assert np.isnan(found)
    else:  # the metric samples walls every 5 cm
        assert found == pytest.approx(count * grid.resolution_m**2 / sum(stretches.values()), rel=0.03)


@pytest.mark.parametrize("seed", range(20))
def test_wrong_merges_are_pairs_with_different_implied_map_frames(seed):
    random, count = np.random.default_rng(seed), 4
    true = random.uniform((-20, -20, -np.pi), (20, 20, np.pi), (count, 30, 3))
    frames = random.normal(0.0, (0.6, 0.6, 0.1), (count, 3)) + [5.0, -3.0, 2.5]
    estimated = true.copy()  # each path in a map frame whose pose in the building frame is `frames`
    for robot, (x, y, heading) in enumerate(frames):
        estimated[robot, :, :2] = (true[robot, :, :2] - [x, y]) @ turned(heading)
        estimated[robot, :, 2] -= heading
    robot_of = np.repeat(np.arange(count), 30)
    implied = metrics.implied_frames(estimated.reshape(-1, 3), true.reshape(-1, 3), robot_of)
    centre = estimated[..., :2].reshape(-1, 2).mean(axis=0)
    wrong = []
    for i in range(count):
        for j in range(i + 1, count):
            here, there = (turned(frames[r, 2]) @ centre + frames[r, :2] for r in (i, j))
            apart = np.abs(np.angle(np.exp(1j * (frames[i, 2] - frames[j, 2]))))
            if np.linalg.norm(here - there) > 1.0 or apart > np.deg2rad(10.0):
                wrong.append((i, j))
    assert metrics.wrong_pairs(implied, centre) == wrong


def test_the_time_to_ninety_percent_is_the_first_evaluation_that_reaches_it(monkeypatch):
    config = override(EnvConfig(), {"map": "gen:office:100:1", "robots": 2, "max_cycles": 400, "lidar.beam_count": 90})
    seen = []

    class Watched(twc_env.ExplorationEnv):
        def step(self, actions):
            given = super().step(actions)
            if self.episode.steps % self.config.reward.period_steps == 0:
                seen.append((self.episode.steps, self.result().figures["coverage_correct"]))
            return given

    monkeypatch.setattr(twc_env, "parallel_env", Watched)
    outcome = compare.explore(config, "nearest-frontier", 0)
    first = next(step for step, share in seen if share >= compare.GOAL)
    assert outcome.is_reached and 0 < first < 400
    assert outcome.goal_s == pytest.approx(0.1 * first, abs=0.1 * config.reward.period_steps)
