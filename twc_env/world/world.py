"""The simulated world: place robots in a building, move them, and compute each robot's measurements."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache, partial
from itertools import islice, repeat
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.config.checks import whole_number
from twc_env.errors import ActionError, TwcError
from twc_env.geometry import compose
from twc_env.kernels import Lent, borrowing_kernel, bound, parts_of, rebound
from twc_env.messages import WifiScan
from twc_env.team_messages import TeamFrames, WifiScans
from twc_env.world.crossing_table import MISSING, square_at
from twc_env.world.dynamics import Dynamics, advance
from twc_env.world.floorplan import Floorplan
from twc_env.world.floorplan_check import validate
from twc_env.world.lidar import Lidar, glass_walls, sweep
from twc_env.world.noise import STEPS
from twc_env.world.odometry import Odometry, measure
from twc_env.world.radio import RadioModel
from twc_env.world.reception import WifiReceiver, WifiReceivers, hear
from twc_env.world.sign_cameras import SignCameras
from twc_env.world.signs import look
from twc_env.world.starts import start_poses

_FLOAT, _INT = np.dtype(np.float64), np.dtype(np.int64)
_TYPES = _FLOAT, _FLOAT, _FLOAT, _FLOAT, _INT, _FLOAT, _INT
"""Of what a step fills: poses, odometry, turn rates, ranges; addresses heard, how strongly, and how many."""
_scans_of = partial(tuple.__new__, WifiScans)
"""Of its four fields; half as long as calling the class, which goes through Python."""
_STEPS_AT_ONCE = 16
"""Steps for which arrays are made together: a row of one costs a third of an array of its own."""
_NO_COMMANDS = np.empty((0, 2))
"""Nobody is to move."""
_TOUCHING, _UNSEEN = -1, -2
"""In place of how many signs are in view: somebody may touch something; the walls around robot 0 are unknown."""


class World:
    """Ground truth of one episode. Call `step`, then `sense` once, since sensing draws the noise of that step.

    Raises MapError for an invalid plan.
    """

    def __init__(self, config: EnvConfig, plan: Floorplan):
        self.config, self.plan = config, validate(plan)
        self.sighted_signs: tuple[tuple[int, ...], ...] = ()
        """For each robot the true signs (plan numbers) behind the readings of its last frame; for metrics only."""
        self._dynamics: Dynamics | None = None
        """All robots, once an episode has begun."""
        self._step = 0
        # All is computed where the building was drawn: moving it changes not even the rounding.
        self._home = plan.home
        self._is_moved = bool(plan.pose_building_home.any())
        self._radio = _radio_model(config.radio, self._home)
        self._time_step_s = config.dynamics.time_step_s
        self._wifi_period = _period_steps(config.radio.scan_period_s, config)
        self._camera_period = _period_steps(config.signs.period_s, config)
        self._hearing = _turns(self._wifi_period, config.robots)
        self._run: Callable[..., int] | None = None
        """`_move_and_sense` with what it needs in every step, as long as the crossing table is `_held_crossings`."""
        self._held_crossings: tuple[Array, ...] | None = None

    def reset(self, seed: int, starts: str | Array = "random") -> None:
        """Begin an episode. Starts: "random" (drawn by seed), "map" (the plan's own), or poses (n, 3).

        Raises MapError if the robots do not fit, ConfigError for invalid starts or seed.
        """
        seed = whole_number("seed", seed, 0)
        config, robots = self.config, self.config.robots
        radius = config.dynamics.robot_radius_m
        starts_home = start_poses(self.plan, robots, radius, seed, starts)
        self._walls = self._home.wall_index.buckets()
        dynamics = self._dynamics = Dynamics(config.dynamics, self._home.wall_index, starts_home)
        self.contacts = dynamics.contacts
        """(n,) whether each robot touches something."""
        self._odometry = Odometry(config.odometry, config.dynamics.time_step_s, robots, seed)
        self._lidar = Lidar(config.lidar, self._home.wall_index, radius, robots, seed, glass_walls(self._home))
        offsets_db = [0.0] * (robots - 1) + [config.failure.device_offset_db]
        self._receivers = [
            WifiReceiver(config.radio, self._radio, robot, seed, offset_db)
            for robot, offset_db in enumerate(offsets_db)
        ]
        self._wifi = WifiReceivers(self._radio, self._receivers)
        self._hears_at_once = self._receivers[0].is_plain
        self._listeners = [np.array(turn if self._hears_at_once else (), np.int64) for turn in self._hearing]
        """For each step of a WiFi period, the robots that hear in the one call of the step."""
        self._rooms: list[Iterator[tuple]] = [iter(()) for _ in self._hearing]
        """For each step of a WiFi period, what the next such steps fill: poses, odometry, turn rates, ranges, scans."""
        laser = (robots, config.lidar.beam_count) if self._lidar.is_plain else (0, 0)
        self._shapes = [_shapes_of_room(robots, laser, len(own), len(self._radio.macs)) for own in self._listeners]
        self._cameras = SignCameras(config, self._home, seed, self._camera_period)
        self._held_crossings = None
        self._sensed_poses = dynamics.poses.copy()
        """(n, 3) at the last reading of the sensors."""
        self._step, self._noise_block = 0, -1
        self.sighted_signs = self._cameras.nothing[1]

    @property
    def poses(self) -> Array:
        """(n, 3) true poses in the building frame, read-only."""
        poses = (self._dynamics or _not_begun()).poses
        return self._in_building(poses) if self._is_moved else poses

    @property
    def poses_home(self) -> Array:
        """(n, 3) true poses in the frame in which the building was drawn."""
        return (self._dynamics or _not_begun()).poses

    @property
    def transmitters_home(self) -> tuple[Array, Array]:
        """Addresses (k,) of the building's access points and their positions (k, 2) in the frame as drawn."""
        points = self._home.access_points
        is_ours = self._radio.access_point_of < len(points)
        places = np.array([p.position_m for p in points], float).reshape(-1, 2)
        return self._radio.macs[is_ours], places[self._radio.access_point_of[is_ours]]

    def anchor(self, robots: Iterable[int]) -> None:
        """Make these robots immovable."""
        (self._dynamics or _not_begun()).anchor(robots)

    def step(self, commands: Array) -> None:
        """Move all robots for one time step; commands (n, 2) [m/s, rad/s]. Raises ActionError for others."""
        try:
            commands = np.asarray(commands, _FLOAT)
            is_fit = commands.shape == (self.config.robots, 2) and math.isfinite(commands.sum())
        except (TypeError, ValueError):
            is_fit = False
        if not is_fit:
            raise ActionError(f"commands must be finite and of shape ({self.config.robots}, 2); got {commands!r}")
        dynamics = self._dynamics or _not_begun()
        dynamics.step(commands)
        self.contacts = dynamics.contacts
        self._step += 1

    def sense(self) -> TeamFrames:
        """One frame per robot: the world's only output. Its arrays are read-only."""
        return self.tick(None)

    def tick(self, commands: Array | None) -> TeamFrames:
        """`step`, then `sense`; a single compiled call if there is no contact. Without commands only `sense`."""
        if commands is not None:
            commands = np.asarray(commands, _FLOAT, "C")
            self._step += 1
        step, dynamics = self._step, self._dynamics or _not_begun()
        if step // STEPS != self._noise_block:
            self._draw_noise()
        turn = step % self._wifi_period
        poses, odometry, turn_rates, ranges, heard = next(self._rooms[turn], None) or self._make_room(turn)
        if commands is None:
            commands, poses = _NO_COMMANDS, dynamics.poses
        else:
            dynamics.poses, dynamics.contacts = poses, dynamics.untouched
        arguments = poses, step, odometry, turn_rates, ranges, *heard
        run = self._run
        if run is None or self._held_crossings is not self._radio.crossings.arrays:  # another table when it has grown
            run = self._bind(arguments)
        sighted = run(commands, *arguments)
        while sighted < 0:
            if sighted == _TOUCHING:
                dynamics.collide()
                poses = dynamics.poses
                arguments = poses, *arguments[1:]
            else:
                self._radio.crossings.prepare(*poses[_UNSEEN - sighted, :2].tolist())
                if self._held_crossings is not self._radio.crossings.arrays:
                    run = self._bind(arguments)
            sighted = run(_NO_COMMANDS, *arguments)
        self.contacts = dynamics.contacts
        if not self._lidar.is_plain:
            ranges = self._lidar.scan(poses)
        if step == 0:
            odometry[:], turn_rates[:] = 0.0, 0.0
        time_s = step * self._time_step_s
        wifi: WifiScans | list[WifiScan | None] = heard if self._hears_at_once else self._hear_one_by_one(time_s)
        signs, self.sighted_signs = self._cameras.read(step) if sighted else self._cameras.nothing
        return TeamFrames(step, time_s, odometry, turn_rates, ranges, wifi, signs)

    def _draw_noise(self) -> None:
        """Random numbers for the coming steps."""
        self._noise_block = self._step // STEPS
        self._odometry.noise.hold(self._step)
        if self._lidar.is_plain:
            self._lidar.noise.hold(self._step)
        if self._hears_at_once:
            self._wifi.hold(self._step // self._wifi_period)

    def _make_room(self, turn: int) -> tuple:
        """New arrays for some steps of which all are of that turn; the first step's."""
        *team, macs, readings, counts = map(np.empty, self._shapes[turn], _TYPES)
        scans = map(_scans_of, zip(repeat(self._listeners[turn]), macs, readings, counts, strict=False))
        # Asked for a row beyond its last one, an array takes as long as for ten rows.
        self._rooms[turn] = islice(zip(*team, scans, strict=True), _STEPS_AT_ONCE)
        return next(self._rooms[turn])

    def _hear_one_by_one(self, time_s: float) -> list[WifiScan | None]:
        wifi: list[WifiScan | None] = [None] * self.config.robots
        for robot in self._hearing[self._step % self._wifi_period]:
            wifi[robot] = self._receivers[robot].scan(self.poses_home[robot], time_s)
        return wifi

    def _bind(self, arguments: tuple) -> Callable[..., int]:
        """`_move_and_sense` with all that stays the same from step to step while the crossing table does."""
        self._held_crossings = self._radio.crossings.arrays
        dynamics = self._dynamics or _not_begun()
        apparatus = (
            *self._walls, *dynamics.arguments, *self._odometry.arguments, *self._lidar.arguments,
            *self._wifi.arguments, *self._cameras.arguments, self._sensed_poses, self._wifi_period,
        )  # fmt: skip
        held = Lent(apparatus)
        run = rebound(self._run, held) or bound(_move_and_sense, held, _NO_COMMANDS, *arguments)
        self._run = run
        return run

    def __getstate__(self) -> dict:
        return self.__dict__ | {"_run": None, "_rooms": [iter(()) for _ in self._hearing]}

    def _in_building(self, poses_home: Array) -> Array:
        return compose(self.plan.pose_building_home, poses_home)


def _not_begun() -> NoReturn:
    raise TwcError("no episode has started: call reset() first")


def _period_steps(period_s: float, config: EnvConfig) -> int:
    return max(1, round(period_s / config.dynamics.time_step_s))


def _turns(period: int, robots: int) -> list[range]:
    """The robots whose sensor of that period reads in a step, for each step of a period; they take turns."""
    return [range(-step % period, robots, period) for step in range(period)]


def _shapes_of_room(robots: int, laser: tuple[int, int], listeners: int, transmitters: int) -> list[tuple[int, ...]]:
    """Of the arrays that steps with so many listeners fill, in the order of `_TYPES`."""
    heard = listeners, transmitters
    shapes = (robots, 3), (robots, 3), (robots,), laser, heard, heard, (listeners,)
    return [(_STEPS_AT_ONCE, *shape) for shape in shapes]


_radio_model = lru_cache(maxsize=8)(RadioModel)


@borrowing_kernel
def _move_and_sense(
    apparatus, commands, now, step, odometry, turn_rates, ranges, listeners, macs, readings, heard_counts
):  # fmt: skip
    """Move all robots, where there are commands, then one reading of each: `advance`, which fills `now`; `measure`,
    `sweep`, `hear` of the listeners and `look` where it is due.

    Gives how many signs are in view. Nothing is read where `advance` refuses, which gives _TOUCHING, and where the
    walls around robot i are still to be worked out, which gives _UNSEEN - i. Lasers need a row each for what they read,
    or none at all is used.
    """
    (
        walls, origin, bucket, rows, columns, first, members, state, limits, move_s, substeps, girth, reach, gaps,
        biases, white, slips_per_m, time_step, odometry_noise,
        directions, radius, far, near, near_counts, anchors, laid, stamps, deviates, quantiles, range_std, words,
        loss, points, low, numbers, sure_counts, sure_losses, first_open, open_walls,
        pose_home_building, boxes, waves, radios, parts, ways, scratch,
        floors, devices, fading, fading_places, fading_numbers, fading_used, fading_of, all_macs, crossed, rssi, heard,
        draws, signs, lengths, optics, does_hide, sights, hidden, sight_counts, camera_period, before, wifi_period,
    ) = parts_of(apparatus)  # fmt: skip
    if commands.shape[0] > 0 and not advance(
        commands, walls, origin, bucket, rows, columns, first, members, state, limits, move_s, substeps, girth, reach,
        gaps, now,
    ):  # fmt: skip
        return _TOUCHING
    robots = now.shape[0]
    for k in range(listeners.shape[0]):
        i = listeners[k]
        if square_at(now[i, 0], now[i, 1], low, numbers) == MISSING:
            return _UNSEEN - i
    noise = odometry_noise[step % odometry_noise.shape[0]]
    measure(before, now, biases, white, slips_per_m, time_step, noise, odometry, turn_rates)
    if ranges.shape[0] == robots:
        sweep(
            walls, origin, bucket, rows, columns, first, members, now, directions, radius, far, near, near_counts,
            anchors, laid, stamps, deviates, quantiles, range_std, words[step % words.shape[0]], ranges,
        )  # fmt: skip
    scan = step // wifi_period % draws.shape[0]
    for k in range(listeners.shape[0]):
        i = listeners[k]
        heard_counts[k] = hear(
            i, now[i, 0], now[i, 1], walls, origin, bucket, rows, columns, first, members, loss, points, low, numbers,
            sure_counts, sure_losses, first_open, open_walls, pose_home_building, boxes, waves, radios, parts,
            ways, scratch, floors, devices, fading, fading_places, fading_numbers, fading_used, fading_of,
            all_macs, crossed, rssi, heard, draws[scan], macs[k], readings[k],
        )  # fmt: skip
    sighted = 0
    for i in range(-step % camera_period, robots, camera_period):
        sight_counts[i] = look(
            walls, origin, bucket, rows, columns, first, members, signs, lengths, optics, now[i], before[i],
            now if does_hide else now[:0], sights[i], hidden[i],
        )  # fmt: skip
        sighted += sight_counts[i]
    for i in range(robots):
        for k in range(3):
            before[i, k] = now[i, k]
    return sighted
