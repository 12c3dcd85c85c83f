"""The simulated world: the robots' motion in a building and the measurements of their sensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache, partial
from itertools import islice, repeat
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, has_one_scanner, robot_configs, start_times_s
from twc_env.config.checks import whole_number
from twc_env.errors import UNFIT, ActionError, TwcError
from twc_env.kernels.compiled import Lent, borrowing_kernel, bound, parts_of, rebound
from twc_env.records.geometry import compose, transform_points
from twc_env.records.messages import WifiScan
from twc_env.records.team_messages import TeamFrames, WifiScans
from twc_env.world.building.crossing_table import MISSING, square_at
from twc_env.world.building.floor_cells import Cells
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.floorplan_check import validate
from twc_env.world.clutter.clutter import Clutter
from twc_env.world.clutter.doorways import doorways_of
from twc_env.world.motion.dynamics import Dynamics, advance
from twc_env.world.motion.jolts import Jolts
from twc_env.world.motion.kidnapping import Kidnapping
from twc_env.world.motion.starts import start_poses
from twc_env.world.people.crowd import Crowd
from twc_env.world.sensors.lidar import Lidar, glass_walls, sweep
from twc_env.world.sensors.noise import STEPS
from twc_env.world.sensors.odometry import Odometry, measure
from twc_env.world.sensors.radio import RadioModel
from twc_env.world.sensors.reception import WifiReceiver, WifiReceivers, hear
from twc_env.world.sensors.scanners import MixedScanners, Scanners, needs_scanners
from twc_env.world.sensors.sign_cameras import SignCameras
from twc_env.world.sensors.signs import look

_FLOAT, _INT = np.dtype(np.float64), np.dtype(np.int64)
_TYPES = _FLOAT, _FLOAT, _FLOAT, _FLOAT, _INT, _FLOAT, _INT
"""Types of the outputs of a step: poses, odometry, turn rates, ranges; addresses received, their RSSI, their counts."""
_scans_of = partial(tuple.__new__, WifiScans)
"""Faster constructor, from a tuple of the four fields."""
_STEPS_AT_ONCE = 16
"""Steps per allocation: a row of an array costs a third of a new array."""
_NO_COMMANDS = np.empty((0, 2))
"""Commands of a call that only senses."""
_CONTACT, _UNCACHED = -1, -2
"""Return values of `_move_and_sense` if a contact is possible, and if the wall crossings at robot 0 are not cached."""


class _WifiRates:
    """When which robot completes a WiFi scan."""

    def __init__(self, periods: list[int]):
        self.periods, self.period = periods, min(periods)
        """Steps per scan of each robot, and the least."""
        self.is_regular = len(set(periods)) == 1
        """Whether all robots scan at one rate."""
        self.numbers: dict[tuple[int, ...], int] = {}
        """Numbers in `World._scanning_robots` of turns of robots that scan at different rates, as they occur."""
        self.laser_shape = 0, 0


class World:
    """Ground truth of an episode. Call `sense` once after each `step`, as it samples the noise of the step.

    Raises MapError for an invalid plan.
    """

    def __init__(self, config: EnvConfig, plan: Floorplan):
        self.config, self.plan = config, validate(plan)
        self.sighted_signs: tuple[tuple[int, ...], ...] = ()
        """For each robot, the true signs (plan numbers) behind the readings of its last frame; for metrics only."""
        self._dynamics: Dynamics | None = None
        """None before the first `reset`."""
        self.crowd: Crowd | None = None
        """The people; None if there are none."""
        self.clutter: Clutter | None = None
        """Doors and furniture off the plan; None if there are none."""
        self._bodies = np.zeros((0, 5))
        """(k, 5) people, doors and boxes in the way of signals, as of `sensors.mean_rssi.lose_in_bodies`."""
        self._step = 0
        # All computations are in the home frame, so that moving the building does not even change the rounding.
        self._home = plan.home
        self._radio = _radio_model(config.radio, self._home)
        self._rates = _WifiRates([_period_steps(own.radio.scan_period_s, config) for own in robot_configs(config)])
        self._scanning_robots = _turns(self._rates.period, config.robots)
        """For each step of a WiFi period, the robots that complete a scan; see `_turn`."""
        self._run: Callable[..., int] | None = None
        """`_move_and_sense` with its constant arguments, valid while the crossing table's arrays are
        `_bound_crossings`."""
        self._bound_crossings: tuple[Array, ...] | None = None

    def reset(self, seed: int, starts: str | Array = "random") -> None:
        """Begin an episode; starts: "random" (by seed), "map" (those of the plan) or poses (n, 3) in the building.

        Raises MapError if the robots do not fit, ConfigError for invalid starts or seed.
        """
        seed = whole_number("seed", seed, 0)
        config, robots = self.config, self.config.robots
        own = robot_configs(config)
        radius = np.array([each.dynamics.robot_radius_m for each in own])
        starts_home = start_poses(self.plan, robots, radius, seed, starts)
        self._walls = self._home.wall_index.buckets()
        dynamics = self._dynamics = Dynamics([each.dynamics for each in own], self._home.wall_index, starts_home)
        self.contacts = dynamics.contacts
        """(n,) bool: whether each robot touches a wall or a robot."""
        self._odometry = Odometry([each.odometry for each in own], config.dynamics.time_step_s, robots, seed)
        if any(each.odometry.bumps_per_m or each.odometry.threshold_slip_m for each in own):
            self._odometry.jolts = Jolts([each.odometry for each in own], doorways_of(self._home), seed)
        lidar, kind = own[0].lidar, Scanners if has_one_scanner(config) else MixedScanners
        self._lidar = Lidar(lidar, self._home.wall_index, radius, robots, seed, glass_walls(self._home))
        self.crowd = self.clutter = legs = rims = seen = leaves = None
        if config.clutter.door_share or config.clutter.furniture:
            clutter = Clutter(config.clutter, self.plan, starts_home, radius, config.dynamics.time_step_s, seed)
            self.clutter, rims, seen, leaves = clutter, clutter.rims, clutter.seen, clutter.open_leaves
        if config.people.count:
            time_step_s = config.dynamics.time_step_s
            crowd = Crowd(config.people, self._home, starts_home, radius, time_step_s, seed, rims, leaves)
            self.crowd, legs = crowd, crowd.discs
        self._bodies = self._obstructions()
        is_usual = kind is Scanners and not needs_scanners(lidar)
        self._scanners = None if is_usual else kind(config, self._home, seed, legs, things=seen)
        """Simulates scanners with limits and errors, or of several kinds; None: `_lidar` does all."""
        offsets_db = [0.0] * (robots - 1) + [config.failure.device_offset_db]
        self._receivers = [
            WifiReceiver(own[robot].radio, self._radio, robot, seed, offset_db)
            for robot, offset_db in enumerate(offsets_db)
        ]
        self._wifi = WifiReceivers(self._radio, self._receivers)
        self._scans_compiled = self._receivers[0].is_plain
        self._rates.numbers.clear()
        if not self._rates.is_regular:
            self._scanning_robots = []
        self._listeners = [np.array(turn if self._scans_compiled else (), np.int64) for turn in self._scanning_robots]
        """For each step of a WiFi period, the robots whose scans are computed by `_move_and_sense`."""
        self._buffers: list[Iterator[tuple]] = [iter(()) for _ in self._scanning_robots]
        """For each step of a WiFi period, output arrays: poses, odometry, turn rates, ranges, scans."""
        laser = (robots, lidar.beam_count) if self._lidar.is_plain and is_usual else (0, 0)
        self._rates.laser_shape = laser
        self._shapes = [_step_shapes(robots, laser, len(turn), len(self._radio.macs)) for turn in self._listeners]
        self._cameras = SignCameras(config, self._home, seed)
        self._bound_crossings = None
        self._kidnapping = Kidnapping(
            config.failure, self._home, start_times_s(config), config.dynamics.time_step_s, seed
        )
        if self.clutter is not None:
            self._kidnapping.avoid(self.clutter.is_clear)
        self._sensed_poses = dynamics.poses.copy()
        """(n, 3) true poses of the last measurement."""
        self._step, self._noise_block = 0, -1
        self.sighted_signs = self._cameras.nothing[1]

    @property
    def poses(self) -> Array:
        """(n, 3) true poses in the building frame, read-only."""
        poses = (self._dynamics or _raise_not_reset()).poses
        return poses if self._home is self.plan else self._in_building(poses)

    @property
    def poses_home(self) -> Array:
        """(n, 3) true poses in the home frame."""
        return (self._dynamics or _raise_not_reset()).poses

    @property
    def cells(self) -> Cells:
        """The building for scoring, without floor that doors and furniture cover."""
        return self.plan.cells() if self.clutter is None else self.clutter.cells

    @property
    def people_m(self) -> Array:
        """(people, 2) true positions of the people in the building frame."""
        if self.crowd is None:
            return np.zeros((0, 2))
        return transform_points(self.plan.pose_building_home, self.crowd.bodies)

    @property
    def things_m(self) -> Array:
        """(k, 4) true ends of door leaves and of the sides and legs of furniture in the building frame."""
        rims = np.zeros((0, 4)) if self.clutter is None else self.clutter.rims
        return transform_points(self.plan.pose_building_home, rims.reshape(-1, 2)).reshape(-1, 4)

    @property
    def transmitters_home(self) -> tuple[Array, Array]:
        """Addresses (k,) of the building's access points, and their positions (k, 2) in the home frame."""
        points = self._home.access_points
        is_ours = self._radio.access_point_of < len(points)
        places = np.array([p.position_m for p in points], float).reshape(-1, 2)
        return self._radio.macs[is_ours], places[self._radio.access_point_of[is_ours]]

    def anchor(self, robots: Iterable[int]) -> None:
        """Make these robots immovable."""
        (self._dynamics or _raise_not_reset()).anchor(robots)

    def step(self, commands: Array) -> None:
        """Move all robots for one time step; commands (n, 2) [m/s, rad/s]. Raises ActionError if invalid."""
        try:
            commands = np.asarray(commands, _FLOAT)
            is_fit = commands.shape == (self.config.robots, 2) and math.isfinite(commands.sum())
        except UNFIT:
            is_fit = False
        if not is_fit:
            raise ActionError(f"commands must be finite and of shape ({self.config.robots}, 2); got {commands!r}")
        dynamics = self._dynamics or _raise_not_reset()
        self._step += 1
        if not self._kidnapping.is_nothing:
            self._carry()
        if self.crowd is not None or self.clutter is not None:
            commands = self._move_others(commands)
        dynamics.step(commands)
        self.contacts = dynamics.contacts

    def sense(self) -> TeamFrames:
        """The measurements of all robots, the world's only output; the arrays are read-only."""
        return self.tick(None)

    def tick(self, commands: Array | None) -> TeamFrames:
        """`step` (unless commands is None) and `sense`, by a single compiled call if no contact is possible."""
        if commands is not None:
            commands = np.asarray(commands, _FLOAT, "C")
            self._step += 1
            if not self._kidnapping.is_nothing:
                self._carry()
            if self.crowd is not None or self.clutter is not None:
                commands = self._move_others(commands)
        step, dynamics = self._step, self._dynamics or _raise_not_reset()
        if step // STEPS != self._noise_block:
            self._draw_noise()
        if self._odometry.varies:
            self._odometry.vary(step)
        rates = self._rates
        turn = step % rates.period if rates.is_regular else self._turn(step)
        poses, odometry, turn_rates, ranges, heard = next(self._buffers[turn], None) or self._allocate_steps(turn)
        if commands is None:
            commands, poses = _NO_COMMANDS, dynamics.poses
        else:
            dynamics.poses, dynamics.contacts = poses, dynamics.untouched
        arguments = poses, step, odometry, turn_rates, ranges, *heard
        run = self._run
        if run is None or self._bound_crossings is not self._radio.crossings.arrays:  # replaced when enlarged
            run = self._bind(arguments)
        sighted = run(commands, *arguments)
        while sighted < 0:
            if sighted == _CONTACT:
                dynamics.collide()
                poses = dynamics.poses
                arguments = poses, *arguments[1:]
            else:
                self._radio.crossings.prepare(*poses[_UNCACHED - sighted, :2].tolist())
                if self._bound_crossings is not self._radio.crossings.arrays:
                    run = self._bind(arguments)
            sighted = run(_NO_COMMANDS, *arguments)
        self.contacts = dynamics.contacts
        scanner = has_scan = beams = None
        if self._scanners is not None:
            scanner, beams = self._scanners.scanner, self._scanners.beams
            ranges, has_scan = self._scanners.scan(step, poses)
        elif not self._lidar.is_plain:
            ranges = self._lidar.scan(poses)
        if self._odometry.jolts is not None:
            self._odometry.jolts.apply(poses, odometry)
        if step == 0:
            odometry[:], turn_rates[:] = 0.0, 0.0
        time_s = step * self.config.dynamics.time_step_s
        wifi: WifiScans | list[WifiScan | None] = heard if self._scans_compiled else self._scan_each(turn, time_s)
        if self.crowd is not None or self.clutter is not None:
            self._show_others(step, poses, ranges, bool(sighted))
        signs, self.sighted_signs = self._cameras.read(step) if sighted else self._cameras.nothing
        return TeamFrames(step, time_s, odometry, turn_rates, ranges, wifi, signs, scanner, has_scan, beams)

    def _turn(self, step: int) -> int:
        """Number in `_scanning_robots` of the robots that complete a WiFi scan in a step, each at its own rate."""
        rates = self._rates
        robots = tuple([i for i, period in enumerate(rates.periods) if (step + i) % period == 0])
        if robots not in rates.numbers:
            rates.numbers[robots] = len(self._scanning_robots)
            self._scanning_robots.append(robots)
            self._listeners.append(np.array(robots if self._scans_compiled else (), np.int64))
            self._buffers.append(iter(()))
            listeners = len(self._listeners[-1])
            self._shapes.append(_step_shapes(self.config.robots, rates.laser_shape, listeners, len(self._radio.macs)))
        return rates.numbers[robots]

    def _carry(self) -> None:
        """Put down elsewhere the robots that are carried before this step; their odometry does not see it."""
        dynamics = self._dynamics or _raise_not_reset()
        people_m = np.zeros((0, 2)) if self.crowd is None else self.crowd.bodies
        for robot, pose in self._kidnapping.carried(self._step, dynamics.poses, people_m):
            dynamics.put(robot, pose)
            self._sensed_poses[robot] = dynamics.poses[robot]
            if self._odometry.jolts is not None:
                self._odometry.jolts.carried(robot)

    def _obstructions(self) -> Array:
        """(k, 5) those of people, doors and furniture; of one kind alone the array that it updates itself."""
        own = [others.obstructions for others in (self.crowd, self.clutter) if others is not None]
        return own[0] if len(own) == 1 else np.concatenate([np.zeros((0, 5)), *own])

    def _move_others(self, commands: Array) -> Array:
        """Advance people, doors and furniture by one step; returns the commands (n, 2) that bumpers leave."""
        poses, dynamics = self.poses_home, self._dynamics or _raise_not_reset()
        if self.crowd is not None:
            commands = self.crowd.step(poses, commands)
        if self.clutter is not None:
            walkers = None if self.crowd is None else self.crowd.walkers
            commands = self.clutter.step(poses, commands, walkers, *dynamics.arguments[:2])
            if self.crowd is not None:
                self._bodies[:] = self._obstructions()
        return commands

    def _show_others(self, step: int, poses: Array, ranges: Array, has_signs: bool) -> None:
        """Let scanners and cameras at poses (n, 3) see people, doors and furniture, and note who is touched."""
        lidar = self._lidar.config
        seen = self._lidar.directions, lidar.range_max_m, lidar.range_noise_std_m, ranges
        for others in (self.clutter, self.crowd):
            if others is None:
                continue
            others.meet(poses)
            self.contacts = self.contacts | others.is_touched
            if self._scanners is None:  # it has cast its beams at them itself
                others.show(poses, *seen)
            if has_signs:
                self._cameras.hide(step, poses, others.hiding)

    def _draw_noise(self) -> None:
        """Draw the random numbers of the next steps."""
        self._noise_block = self._step // STEPS
        self._odometry.noise.hold(self._step)
        if self._rates.laser_shape[0]:
            self._lidar.noise.hold(self._step)
        if self._scans_compiled:
            self._wifi.hold(self._step // self._rates.period)

    def _allocate_steps(self, turn: int) -> tuple:
        """Allocate the outputs of the next steps at this step of a WiFi period; returns those of the first one."""
        *team, macs, readings, counts = map(np.empty, self._shapes[turn], _TYPES)
        scans = map(_scans_of, zip(repeat(self._listeners[turn]), macs, readings, counts, strict=False))
        # islice: iterating an array beyond its last row costs as much as ten rows.
        self._buffers[turn] = islice(zip(*team, scans, strict=True), _STEPS_AT_ONCE)
        return next(self._buffers[turn])

    def _scan_each(self, turn: int, time_s: float) -> list[WifiScan | None]:
        wifi: list[WifiScan | None] = [None] * self.config.robots
        for robot in self._scanning_robots[turn]:
            wifi[robot] = self._receivers[robot].scan(self.poses_home[robot], time_s, self._bodies)
        return wifi

    def _bind(self, arguments: tuple) -> Callable[..., int]:
        """Bind the constant arguments of `_move_and_sense`."""
        self._bound_crossings = self._radio.crossings.arrays
        dynamics = self._dynamics or _raise_not_reset()
        apparatus = (
            *self._walls, *dynamics.arguments, *self._odometry.arguments, *self._lidar.arguments,
            *self._wifi.arguments, self._bodies, *self._cameras.arguments, self._sensed_poses, self._rates.period,
        )  # fmt: skip
        held = Lent(apparatus)
        run = rebound(self._run, held) or bound(_move_and_sense, held, _NO_COMMANDS, *arguments)
        self._run = run
        return run

    def __getstate__(self) -> dict:
        return self.__dict__ | {"_run": None, "_buffers": [iter(()) for _ in self._scanning_robots]}

    def _in_building(self, poses_home: Array) -> Array:
        return compose(self.plan.pose_building_home, poses_home)


def _raise_not_reset() -> NoReturn:
    raise TwcError("no episode has started: call reset() first")


def _period_steps(period_s: float, config: EnvConfig) -> int:
    return max(1, round(period_s / config.dynamics.time_step_s))


def _turns(period: int, robots: int) -> list[Sequence[int]]:
    """For each step of a period, the robots whose sensor measures in it; staggered."""
    return [range(-step % period, robots, period) for step in range(period)]


def _step_shapes(robots: int, laser: tuple[int, int], listeners: int, transmitters: int) -> list[tuple[int, ...]]:
    """Shapes of the outputs of steps with this count of listeners, in the order of `_TYPES`."""
    heard = listeners, transmitters
    shapes = (robots, 3), (robots, 3), (robots,), laser, heard, heard, (listeners,)
    return [(_STEPS_AT_ONCE, *shape) for shape in shapes]


_radio_model = lru_cache(maxsize=8)(RadioModel)


@borrowing_kernel
def _move_and_sense(
    apparatus, commands, now, step, odometry, turn_rates, ranges, listeners, macs, readings, heard_counts
):  # fmt: skip
    """Move all robots if there are commands, which fills `now` (n, 3), then compute their measurements.

    Returns the count of signs in view. Nothing is measured if a contact is possible (returns _CONTACT) or the wall
    crossings at listener i are not cached (returns _UNCACHED - i). Without rows for all robots in `ranges`, there is no
    laser measurement.
    """
    (
        walls, origin, bucket, rows, columns, first, members, state, motion_limits, move_s, substeps, radii,
        reaches, gaps,
        biases, white, slips_per_m, time_step, odometry_noise,
        directions, disc_radii, far, near, near_counts, anchors, projected, stamps, deviates, quantiles, range_std,
        words, loss, points, low, numbers, certain_counts, certain_losses, first_uncertain, uncertain_walls,
        pose_home_building, boxes, waves, radios, parts, radio_limits, scratch,
        floors, devices, fading, fading_places, fading_numbers, fading_used, fading_of, all_macs, crossed, rssi, heard,
        draws, bodies, signs, lengths, optics, does_hide, sights, hidden, sight_counts,
        camera_periods, before, wifi_period,
    ) = parts_of(apparatus)  # fmt: skip
    if commands.shape[0] > 0 and not advance(
        commands, walls, origin, bucket, rows, columns, first, members, state, motion_limits, move_s, substeps,
        radii, reaches, gaps, now,
    ):  # fmt: skip
        return _CONTACT
    robots = now.shape[0]
    for k in range(listeners.shape[0]):
        i = listeners[k]
        if square_at(now[i, 0], now[i, 1], low, numbers) == MISSING:
            return _UNCACHED - i
    noise = odometry_noise[step % odometry_noise.shape[0]]
    measure(before, now, biases, white, slips_per_m, time_step, noise, odometry, turn_rates)
    if ranges.shape[0] == robots:
        sweep(
            walls, origin, bucket, rows, columns, first, members, now, directions, disc_radii, far, near, near_counts,
            anchors, projected, stamps, deviates, quantiles, range_std, words[step % words.shape[0]], ranges,
        )  # fmt: skip
    scan = step // wifi_period % draws.shape[0]
    for k in range(listeners.shape[0]):
        i = listeners[k]
        heard_counts[k] = hear(
            i, now[i, 0], now[i, 1], walls, origin, bucket, rows, columns, first, members, loss, points, low, numbers,
            certain_counts, certain_losses, first_uncertain, uncertain_walls, pose_home_building, boxes, waves, radios,
            parts, radio_limits, scratch, floors, devices, fading, fading_places, fading_numbers, fading_used,
            fading_of, all_macs, crossed, rssi, heard, draws[scan], bodies, macs[k],
            readings[k],
        )  # fmt: skip
    sighted = 0
    for i in range(robots):
        if (step + i) % camera_periods[i] != 0:
            continue
        sight_counts[i] = look(
            walls, origin, bucket, rows, columns, first, members, signs, lengths, optics[i], now[i], before[i],
            now if does_hide else now[:0], radii, sights[i], hidden[i],
        )  # fmt: skip
        sighted += sight_counts[i]
    for i in range(robots):
        for k in range(3):
            before[i, k] = now[i, k]
    return sighted
