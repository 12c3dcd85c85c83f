"""The world as one thing: put robots into a building, move them, and give each what its sensors measure."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from twc_env.config import EnvConfig, RadioConfig
from twc_env.errors import ConfigError, MapError
from twc_env.geometry import compose, inverse
from twc_env.messages import SignReading, WifiScan
from twc_env.random_streams import random_stream
from twc_env.team_messages import TeamFrames
from twc_env.world.dynamics import Dynamics
from twc_env.world.floorplan import Floorplan
from twc_env.world.lidar import Lidar, glass_walls
from twc_env.world.odometry import Odometry
from twc_env.world.radio import RadioModel
from twc_env.world.reception import WifiReceiver
from twc_env.world.signs import SignCamera

Array = NDArray

START_CLEARANCE_M = 0.4
"""Distance of a drawn start from any wall."""
START_SPACING_M = 1.5
"""Distance between drawn starts."""
START_SPACING_MIN_M = 0.6
_PLACES_MAX = 2000
_START_TRIES = 20
"""Sets of places tried, each with less distance between the robots, before a map counts as too small."""


class World:
    """Ground truth of one episode. Call `step`, then `sense` once: sensing draws the noise of that step."""

    def __init__(self, config: EnvConfig, plan: Floorplan):
        self.config, self.plan = config, plan
        self.sighted_signs: tuple[tuple[int, ...], ...] = ()
        """For each robot the true signs (plan numbers) behind the readings of its last frame; for metrics only."""
        # All is computed where the building was drawn: moving it changes not even the rounding.
        self._home = plan.home
        self._is_moved = bool(plan.pose_building_home.any())
        self._radio = _radio_model(config.radio, self._home)
        self._wifi_period = _period_steps(config.radio.scan_period_s, config)
        self._camera_period = _period_steps(config.signs.period_s, config)

    def reset(self, seed: int, starts: str | Array = "random") -> None:
        """Begin an episode. Starts: "random" (drawn by seed), "map" (the plan's own), or poses (n, 3).

        Raises MapError when the robots do not fit, ConfigError for starts that are no such thing.
        """
        config, robots = self.config, self.config.robots
        start_poses_home = self._start_poses(seed, starts)
        self.start_poses = self._in_building(start_poses_home)
        self._dynamics = Dynamics(config.dynamics, self._home.wall_index, start_poses_home)
        self._odometry = Odometry(config.odometry, config.dynamics.time_step_s, robots, seed)
        radius = config.dynamics.robot_radius_m
        self._lidar = Lidar(config.lidar, self._home.wall_index, radius, robots, seed, glass_walls(self._home))
        offsets_db = [0.0] * (robots - 1) + [config.failure.device_offset_db]
        self._receivers = [
            WifiReceiver(config.radio, self._radio, robot, seed, offset_db)
            for robot, offset_db in enumerate(offsets_db)
        ]
        self._cameras = [SignCamera(config.signs, self._home, robot, seed, config.dynamics) for robot in range(robots)]
        self._sensed_poses = self._dynamics.poses
        self._step = 0
        self._note_poses()
        self.sighted_signs = ((),) * robots

    @property
    def poses(self) -> Array:
        """(n, 3) true poses in the building frame; read-only."""
        return self._poses

    @property
    def poses_home(self) -> Array:
        """(n, 3) true poses in the frame in which the building was drawn."""
        return self._dynamics.poses

    @property
    def transmitters_home(self) -> tuple[Array, Array]:
        """Addresses (k,) of the building's access points, and where they stand (k, 2) as the building was drawn."""
        points = self._home.access_points
        is_ours = self._radio.access_point_of < len(points)
        places = np.array([p.position_m for p in points], float).reshape(-1, 2)
        return self._radio.macs[is_ours], places[self._radio.access_point_of[is_ours]]

    @property
    def contacts(self) -> Array:
        """(n,) whether each robot touches something."""
        return self._dynamics.contacts

    def anchor(self, robots: Iterable[int]) -> None:
        """From now on these robots cannot be pushed."""
        self._dynamics.anchor(robots)

    def step(self, commands: Array) -> None:
        """Move all robots for one time step; commands (n, 2) [m/s, rad/s]."""
        self._dynamics.step(commands)
        self._step += 1
        self._note_poses()

    def sense(self) -> TeamFrames:
        """One frame per robot: all that leaves the world. Its arrays are read-only."""
        poses, step, robots = self._dynamics.poses, self._step, self.config.robots
        odometry, turn_rates = self._odometry.measure(self._sensed_poses, poses)
        ranges = self._lidar.scan(poses)
        if step == 0:
            odometry, turn_rates = np.zeros_like(odometry), np.zeros_like(turn_rates)
        time_s = step * self.config.dynamics.time_step_s
        wifi: list[WifiScan | None] = [None] * robots
        places = poses.tolist()
        for robot in self._due(self._wifi_period):
            wifi[robot] = self._receivers[robot].scan(places[robot], time_s)
        signs: list[tuple[SignReading, ...]] = [()] * robots
        sighted: list[tuple[int, ...]] = [()] * robots
        for robot in self._due(self._camera_period):
            signs[robot], sighted[robot] = self._cameras[robot].read(poses[robot], self._sensed_poses[robot], poses)
        self._sensed_poses, self.sighted_signs = poses, tuple(sighted)
        return TeamFrames(step, time_s, odometry, turn_rates, ranges, wifi, signs)

    def _due(self, period: int) -> range:
        """The robots whose sensor of that period reads in this step; they take turns."""
        return range(-self._step % period, self.config.robots, period)

    def _note_poses(self) -> None:
        self._poses = self._in_building(self._dynamics.poses)
        self._poses.flags.writeable = False

    def _in_building(self, poses_home: Array) -> Array:
        return compose(self.plan.pose_building_home, poses_home) if self._is_moved else poses_home.view()

    def _start_poses(self, seed: int, starts: str | Array) -> Array:
        """(n, 3) in the home frame."""
        robots, home = self.config.robots, self._home
        if not isinstance(starts, str):
            poses = np.array(starts, float)
            if poses.shape != (robots, 3) or not np.isfinite(poses).all():
                raise ConfigError(f"starts must be {robots} finite poses (x, y, heading); got shape {poses.shape}")
            for i in np.flatnonzero(~self.plan.cells().is_free(poses[:, :2])):
                at = f"({poses[i, 0]:.2f}, {poses[i, 1]:.2f})"
                raise ConfigError(f"starts[{i}] at {at} is no open floor of map {home.name!r}; move it inside")
            return compose(inverse(self.plan.pose_building_home), poses)
        if starts == "random":
            return draw_starts(home, robots, random_stream(seed, "starts"))
        if starts == "map":
            if len(home.starts) < robots:
                raise MapError(
                    f"map {home.name!r} has {len(home.starts)} starts for {robots} robots; "
                    "add some, or draw them at random"
                )
            return np.array(home.starts[:robots])
        raise ConfigError(f"starts must be 'random', 'map' or poses; got {starts!r}")


def draw_starts(home: Floorplan, robots: int, random: np.random.Generator) -> Array:
    """(robots, 3) free poses clear of walls and apart from each other.

    Where the building is too small, the distance between robots shrinks step by step, down to 0.6 m.
    """
    places = start_places(home)
    if len(places) == 0:
        raise MapError(f"map {home.name!r} has no place {START_CLEARANCE_M} m clear of walls to start from")
    for spacing_m in np.linspace(START_SPACING_M, START_SPACING_MIN_M, _START_TRIES):
        chosen = _spaced(places[random.permutation(len(places))[:_PLACES_MAX]], robots, spacing_m)
        if len(chosen) == robots:
            return np.column_stack([chosen, random.uniform(-math.pi, math.pi, robots)])
    raise MapError(f"map {home.name!r} has no room for {robots} robots; use fewer")


@lru_cache(maxsize=8)
def start_places(home: Floorplan) -> Array:
    """(k, 2) centres of the free cells that keep the start clearance; computed once per plan."""
    cells = home.cells()
    rows, columns = np.nonzero(cells.free)
    centres = cells.origin_m + (np.column_stack([columns, rows]) + 0.5) * cells.resolution_m
    return centres[home.wall_index.distance_m(centres, START_CLEARANCE_M) >= START_CLEARANCE_M]


def _spaced(places: Array, count: int, spacing_m: float) -> Array:
    chosen: list[Array] = []
    for place in places:
        if all(np.hypot(*(place - other)) >= spacing_m for other in chosen):
            chosen.append(place)
            if len(chosen) == count:
                break
    return np.array(chosen).reshape(-1, 2)


def _period_steps(period_s: float, config: EnvConfig) -> int:
    return max(1, round(period_s / config.dynamics.time_step_s))


@lru_cache(maxsize=8)
def _radio_model(config: RadioConfig, plan: Floorplan) -> RadioModel:
    return RadioModel(config, plan)
