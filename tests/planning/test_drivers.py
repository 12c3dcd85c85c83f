"""Driving a team: as each of its robots alone, and the check of paths ahead as that of the points along them."""

import dataclasses

import numpy as np

from twc_env.config import DynamicsConfig
from twc_env.planning import Drivers, PathFinder, Terrain
from twc_env.planning.drivers import BACK_OUT_S, STUCK_S, WAIT_WEIGHT
from twc_env.planning.follow import is_path_blocked
from twc_env.records.geometry import points_along, travelled_m
from twc_env.records.messages import Belief, GridMap
from twc_env.records.team_messages import TeamBeliefs

CELL_M = 0.1


def walled_room(version: int = 0) -> GridMap:
    """6 x 4 m, with a wall that leaves a door."""
    log_odds = np.full((44, 64), -20, np.int16)
    log_odds[[1, -2], 1:-1] = log_odds[1:-1, 1] = log_odds[1:-1, -2] = 40
    log_odds[1:28, 30] = 40
    return GridMap(log_odds, np.array([-0.2, -0.2]), CELL_M)


def belief_of(robot: int, grid: GridMap, pose: np.ndarray, version: int = 0) -> Belief:
    return Belief(robot, 0, pose, grid, {}, ranges_m=np.full(36, 3.0), map_version=version)


def terrain_of(belief: Belief, factor: float) -> Terrain:
    return Terrain.of(belief, 0.2 * factor)


def test_a_team_drives_as_each_of_its_robots_alone():
    dynamics, grid, random = DynamicsConfig(), walled_room(), np.random.default_rng(0)
    team, alone = Drivers([dynamics] * 3, PathFinder()), [Drivers([dynamics], PathFinder()) for _ in range(3)]
    poses = np.array([[1.0, 1.0, 0.0], [2.0, 3.0, 1.0], [4.5, 1.0, 3.0]])
    goals = np.array([[4.5, 1.0], [1.0, 0.6], [0.8, 1.0]])
    for robot, goal in enumerate(goals):
        team.start(robot, goal, belief_of(robot, grid, poses[robot]))
        alone[robot].start(0, goal, belief_of(robot, grid, poses[robot]))
    statuses = set()
    for tick in range(200):
        beliefs = [belief_of(robot, grid, pose.copy(), tick // 90) for robot, pose in enumerate(poses)]
        commands = team.commands(beliefs, terrain_of)
        singly = [each.commands([belief], terrain_of)[0] for each, belief in zip(alone, beliefs, strict=True)]
        assert np.array_equal(commands, singly)
        statuses |= {team.status(robot) for robot in range(3)}
        assert [team.status(robot) for robot in range(3)] == [each.status(0) for each in alone]
        if tick < 120:  # later they are held: stuck, out of the corner, failed
            step = commands * dynamics.time_step_s
            poses[:, 0] += step[:, 0] * np.cos(poses[:, 2])
            poses[:, 1] += step[:, 0] * np.sin(poses[:, 2])
            poses[:, 2] += step[:, 1] + 0.01 * random.standard_normal(3)
    assert {"driving", "arrived"} <= statuses


def test_a_list_of_beliefs_drives_a_team_as_their_arrays_do():
    """Robots 1 and 2 share a map at first; then one leaves it, which is no jump of the map of robot 0."""
    dynamics, grid = DynamicsConfig(), walled_room()
    poses, goals = np.array([[1.0, 1.0, 0.0], [2.0, 3.0, 1.0], [4.5, 1.0, 3.0]]), ([4.5, 3.0], [1.0, 0.6], [0.8, 1.0])
    listed, stacked = Drivers([dynamics] * 3, PathFinder()), Drivers([dynamics] * 3, PathFinder())
    for tick in range(30):
        together = [(), (2,), (1,)] if tick < 15 else [(), (), ()]
        beliefs = [
            dataclasses.replace(belief_of(k, grid, pose.copy()), teammates={other: poses[other] + 0.0 for other in own})
            for k, (pose, own) in enumerate(zip(poses, together, strict=True))
        ]
        for robot, goal in enumerate(goals if tick == 0 else ()):
            listed.start(robot, np.array(goal), beliefs[robot], "view")
            stacked.start(robot, np.array(goal), beliefs[robot], "view")
        commands = listed.commands(beliefs, terrain_of)
        assert np.array_equal(commands, stacked.commands(TeamBeliefs.of(beliefs), terrain_of))
        assert listed.goals_m[0].tolist() == goals[0]
        assert all(listed.is_of(robot, belief) for robot, belief in enumerate(beliefs))
        step = commands * dynamics.time_step_s
        poses[:, 0] += step[:, 0] * np.cos(poses[:, 2])
        poses[:, 1] += step[:, 0] * np.sin(poses[:, 2])
        poses[:, 2] += step[:, 1]


def test_a_robot_that_is_held_backs_out_and_fails_though_views_are_chosen_anew():
    dynamics, grid, pose = DynamicsConfig(), walled_room(), np.array([1.0, 1.0, 0.0])
    drivers, belief = Drivers([dynamics], PathFinder()), belief_of(0, grid, pose)
    commands, ticks, chosen_anew = [], round((STUCK_S + BACK_OUT_S) / dynamics.time_step_s) + 2, 0
    for tick in range(ticks):
        if tick % 5 == 0 and drivers.status(0) != "failed":
            chosen_anew += 1
            drivers.start(0, np.array([4.5, 1.0 + 0.1 * (tick % 10)]), belief, "view")
        commands.append(drivers.commands([belief], terrain_of)[0])
    assert chosen_anew > 5 and drivers.status(0) == "failed"
    assert {tuple(command) for command in commands[-8:-2]}.isdisjoint({tuple(command) for command in commands[:20]})
    drivers.start(0, np.array([4.5, 1.0]), belief, "view")
    drivers.commands([belief], terrain_of)
    assert drivers.status(0) == "driving", "it tries again"


def test_a_robot_waits_for_people_but_not_for_good():
    """A leg in front of it comes 0.2 m nearer and goes back again, all the time."""
    dynamics, grid, pose = DynamicsConfig(), walled_room(), np.array([1.0, 1.0, 0.0])
    drivers, failed_s = Drivers([dynamics], PathFinder(), waits_for_people=True), None
    for tick in range(600):
        ranges_m = np.full(180, 3.0)
        ranges_m[[178, 179, 0, 1, 2]] = 0.45 + 0.2 * (tick // 4 % 2)
        belief = Belief(0, tick, pose, grid, ranges_m=ranges_m, pose_odom=pose)
        if tick == 0:
            drivers.start(0, np.array([2.5, 1.0]), belief)
        drivers.commands([belief], terrain_of)
        if drivers.status(0) == "failed":
            failed_s = tick * dynamics.time_step_s
            break
    assert failed_s is not None and 2 * STUCK_S < failed_s < STUCK_S / WAIT_WEIGHT + 2 * BACK_OUT_S


def test_a_robot_that_sees_behind_backs_out_backwards():
    """Walls ahead and aside, open floor behind: it has 1.2 s, in which it could not turn around."""
    dynamics, grid, pose = DynamicsConfig(), walled_room(), np.array([3.0, 3.0, 0.0])
    ranges_m, speeds = np.full(180, 0.6), {}
    ranges_m[70:110] = 3.0
    for reverses in (False, True):
        drivers = Drivers([dynamics], PathFinder(), reverses=[reverses])
        belief = Belief(0, 0, pose, grid, ranges_m=ranges_m)
        drivers.start(0, np.array([4.5, 3.0]), belief)
        told = [
            drivers.commands([belief], terrain_of)[0, 0] for _ in range(round((STUCK_S + 0.5) / dynamics.time_step_s))
        ]
        speeds[reverses] = told[-1]
    assert speeds[True] < -0.3 < speeds[False]


def test_a_path_is_blocked_where_a_wall_is_near_a_point_of_its_next_three_metres():
    grid, random = walled_room(), np.random.default_rng(1)
    walls_m = (np.argwhere(grid.log_odds > Terrain.WALL_ABOVE)[:, ::-1] + 0.5) * CELL_M + grid.origin_m
    found = []
    for _ in range(300):
        path = np.cumsum(random.uniform(-1.0, 1.0, (6, 2)), axis=0) + (3.0, 2.0)
        pose, segment = np.array([*random.uniform(1.0, 3.0, 2), 0.0]), int(random.integers(6))
        corners = np.vstack([pose[:2], path[segment + 1 :]])
        points = points_along(corners, np.arange(0.0, min(3.0, travelled_m(corners)[-1]) + 1e-9, 0.1))
        is_blocked = is_path_blocked(path, segment, pose, 0.18, grid.log_odds, grid.origin_m, CELL_M)
        assert is_blocked == (np.linalg.norm(points[:, None] - walls_m, axis=2) < 0.18).any()
        found.append(is_blocked)
    assert 30 < sum(found) < 270


def test_a_robot_drives_around_a_box_that_it_only_feels():
    dynamics, grid = DynamicsConfig(), walled_room()
    box_m, arrived = np.array([2.0, 3.2]), {}
    for feels in (False, True):
        driver, pose, speed = Drivers([dynamics], PathFinder(), feels=feels), np.array([1.0, 3.2, 0.0]), 0.0

        def now(tick: int, pose: np.ndarray) -> Belief:
            return Belief(0, tick, pose.copy(), grid, ranges_m=np.full(36, -3.0), pose_odom=pose.copy())

        driver.start(0, np.array([4.0, 3.2]), now(0, pose))
        for tick in range(150):
            told, turn_rate = driver.commands([now(tick, pose)], terrain_of)[0].tolist()
            change = dynamics.acceleration_max_m_s2 * dynamics.time_step_s
            speed = min(max(told, speed - change), speed + change)
            ahead = pose[:2] + speed * dynamics.time_step_s * np.array([np.cos(pose[2]), np.sin(pose[2])])
            was_m, is_m = np.abs(pose[:2] - box_m).max(), np.abs(ahead - box_m).max()
            if is_m < 0.2 + dynamics.robot_radius_m and is_m < was_m:
                speed = 0.0
            else:
                pose[:2] = ahead
            pose[2] += turn_rate * dynamics.time_step_s
            if driver.status(0) != "driving":
                break
        arrived[feels] = driver.status(0)
    assert arrived == {False: "failed", True: "arrived"}
