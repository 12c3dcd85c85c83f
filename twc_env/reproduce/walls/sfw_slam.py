"""The path of a structure-from-WiFi walk as estimated by the SLAM engine."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import DynamicsConfig, EnvConfig
from twc_env.records.geometry import compose, inverse, transform_points, travelled_m
from twc_env.reproduce.routes import steer
from twc_env.slam.modes import make_engine
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.world import World

AHEAD_M = 0.15
_CONFIG = EnvConfig(robots=1, dynamics=DynamicsConfig(robot_radius_m=0.1, speed_max_m_s=0.5))
"""A small, slow robot, which can keep the standoff of the route at corners."""


def slam_walk(plan: Floorplan, way_m: Array, count: int, seed: int) -> tuple[Array, Array]:
    """Drive along a path (points, 2) with odometry, scans and the engine: (count, 2) true positions, evenly spaced
    along the path, and the estimated ones. Only the start pose is given.
    """
    config = dataclasses.replace(_CONFIG, map=plan.name)
    world, engine = World(config, plan), make_engine(config, 1)
    heading = math.atan2(*(way_m[3] - way_m[0])[::-1])
    world.reset(seed, starts=np.array([[*way_m[0], heading]]))
    true, believed, at = [], [], 0
    for _ in range(20 * len(way_m) + 200):
        engine.update(world.sense())
        true.append(world.poses[0].copy())
        believed.append(engine.pose_map_robot(0).copy())
        command, at = steer(true[-1], way_m, at, config, AHEAD_M)
        if command is None:
            break
        world.step(np.array([command]))
    places, poses = np.array(true)[:, :2], np.array(believed)
    frame = compose(true[0], inverse(poses[0]))
    believed_m = transform_points(frame, poses[:, :2])
    travel = travelled_m(places)
    even = np.linspace(0.0, travel[-1], count)
    return tuple(  # type: ignore[return-value]
        np.column_stack([np.interp(even, travel, path[:, axis]) for axis in (0, 1)]) for path in (places, believed_m)
    )
