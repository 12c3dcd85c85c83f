"""The path of a structure-from-WiFi walk as estimated: by the SLAM engine with its laser, or by radio SLAM alone."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import DynamicsConfig, EnvConfig, RadioConfig, RadioSlamConfig
from twc_env.errors import DataError
from twc_env.records.geometry import compose, inverse, poses_along, transform_points, travelled_m
from twc_env.records.messages import SensorFrame, WifiScan
from twc_env.reproduce.routes import steer
from twc_env.slam.modes import make_engine
from twc_env.slam.places.radio_fingerprint import fingerprint
from twc_env.slam.radio import radio_slam
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.world import World

AHEAD_M = 0.15
SCAN_APART_M = 0.5
"""Radio SLAM merges the WiFi scans of so much path into one fingerprint."""
_CONFIG = EnvConfig(robots=1, dynamics=DynamicsConfig(robot_radius_m=0.1, speed_max_m_s=0.5))
"""A small, slow robot, which can keep the standoff of the route at corners."""


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """Positions on a drive, evenly spaced along it. Estimates are given the start pose alone."""

    true_m: Array
    """(count, 2)."""
    slam_m: Array
    """(count, 2) by the engine, from odometry and laser."""
    odometry_m: Array
    """(count, 2) by odometry alone."""
    radio_m: Array
    """(count, 2) by radio SLAM, from odometry and the strengths of the plan's access points (papers.md K24b)."""

    def error_m(self, found_m: Array) -> float:
        """Root mean square of the position errors."""
        return float(np.sqrt(((found_m - self.true_m) ** 2).sum(axis=1).mean()))


def slam_walk(plan: Floorplan, way_m: Array, count: int, radio: RadioConfig, seed: int) -> Drive:
    """Drive along a path (points, 2), steered by the true pose: all estimates are of the same drive.

    Raises DataError if the robot does not reach its end.
    """
    config = dataclasses.replace(_CONFIG, map=plan.name, radio=radio)
    world, engine = World(config, plan), make_engine(config, 1)
    heading = math.atan2(*(way_m[3] - way_m[0])[::-1])
    world.reset(seed, starts=np.array([[*way_m[0], heading]]))
    true, believed, frames, at = [], [], [], 0
    for _ in range(20 * len(way_m) + 200):
        (frame,) = world.sense()
        engine.update([frame])
        frames.append(frame)
        true.append(world.poses[0].copy())
        believed.append(engine.pose_map_robot(0).copy())
        command, at = steer(true[-1], way_m, at, config, AHEAD_M)
        if command is None:
            break
        world.step(np.array([command]))
    else:
        raise DataError(f"the robot does not reach the end of the path through {plan.name!r}: make it free of walls")
    places = np.array(true)[:, :2]
    odometry = poses_along(np.array([frame.odometry for frame in frames[1:]]).reshape(-1, 3))
    travel = travelled_m(places)
    even = np.linspace(0.0, travel[-1], count)

    def spaced(poses: Array) -> Array:
        path = transform_points(compose(true[0], inverse(poses[0])), poses[:, :2])
        return np.column_stack([np.interp(even, travel, path[:, axis]) for axis in (0, 1)])

    by_radio = _by_radio(frames, odometry, config.slam.radio_slam)
    true_m = np.column_stack([np.interp(even, travel, places[:, axis]) for axis in (0, 1)])
    return Drive(true_m, spaced(np.array(believed)), spaced(odometry), spaced(by_radio))


def _by_radio(frames: Sequence[SensorFrame], odometry: Array, config: RadioSlamConfig) -> Array:
    """(frames, 3) the path by radio SLAM, which moves the scans; frames between two follow the odometry from the
    first."""
    travel = travelled_m(odometry[:, :2])
    scans, prints = [0], []
    heard: list[WifiScan] = []
    for k, frame in enumerate(frames):
        if k and travel[k] - travel[scans[-1]] >= SCAN_APART_M:
            prints.append(fingerprint(heard, 0.0))
            scans.append(k)
            heard = []
        if frame.wifi is not None:
            heard.append(frame.wifi)
    prints.append(fingerprint(heard, 0.0))
    motions = compose(inverse(odometry[scans[:-1]]), odometry[scans[1:]])
    log = radio_slam.RadioLog(motions, motions[:, 2], prints)
    solved = radio_slam.solve(log, config, ("wifi",)).poses
    last = np.searchsorted(scans, np.arange(len(frames)), side="right") - 1
    since = compose(inverse(odometry[np.array(scans)[last]]), odometry)
    return compose(solved[last], since)
