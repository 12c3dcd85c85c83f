"""What a log's odometry does wrong: its constant errors and its noise, by the motions between matched scans.

A scan is matched to those before it whatever the odometry says, as long as the match is found from there. What odometry
differs by from the matched motions is, first, errors that are the same all along (unequal wheels, slip of the tracks, a
scanner that is mounted askew), which are taken off the odometry; and then noise, which the engine is told instead of
the settings of laser logs. The noise includes that of the matches, so it is never taken for too little.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, override
from twc_env.records.geometry import between, compose, wrap_angle
from twc_env.records.messages import SensorFrame
from twc_env.replaying.inputs import ReplayInput
from twc_env.slam.robot import FrontEnds

STRETCH_M, STRETCH_RAD = 0.5, 0.5
"""Steps are summed to motions of this length or turn; in shorter ones the noise of matches prevails."""
MOTIONS_MIN, MOTIONS_MAX = 30, 400
"""Of fewer motions nothing is told; no more of them are looked at: the first part of a log tells enough."""
STEPS_MAX = 2
"""Of a log whose first motions have more steps each, nothing is told: of freiburg-079, with scans 0.1 m apart, a path
by what was found was worse."""
NOISE_MAX = 1.0
"""Greatest noise of a step that the settings take [m, rad]."""
HELD_SHARE = 1e-3
"""A match holds a pose in all directions if its information's least eigenvalue is this share of the greatest."""
UNTOLD = (
    f"odometry: noise is assumed; {MOTIONS_MIN} motions between matched scans about half a metre apart would tell it, "
    f"those of denser scans do not"
)
UNTOLD_GYRO = "odometry: noise is assumed, as turn rates come from a gyro (robot {})"
ROUNDS, HUBER, WINSOR = 10, 1.5, 5.0
"""Rounds of the robust fit; residuals that count less, and at most, in robust standard deviations."""
SAME_TURN_RAD = 1e-6
"""Greatest difference between turns of odometry and turn rates that are made of them."""
STEADY = 1e-6
"""Added to the fit's normal equations, so that a robot that never turned has a solution."""
MAD = 1.4826
"""Standard deviation of a normal distribution by its median absolute deviation."""


@dataclass(frozen=True, slots=True)
class OdometryErrors:
    """Errors of one robot's odometry."""

    motions: int
    """Number of motions that they come from."""
    scale: float
    """Share by which it reads too long."""
    skew_rad: float
    """Angle to the left of straight ahead at which it reads a motion straight ahead."""
    curl_rad_m: float
    """Angle that it reads too much per metre ahead."""
    turn: float
    """Share by which it reads turns too large."""
    position_std_m: float
    """Noise of one step along x and y."""
    turn_std_rad: float
    """Noise of one step's turn."""

    def taken_off(self, motions: Array) -> Array:
        """Motions (n, 3) of odometry without the constant errors."""
        ahead, _, turned = motions.T
        too_much = self.scale * ahead, self.skew_rad * ahead, self.curl_rad_m * ahead + self.turn * turned
        return motions - np.column_stack(too_much)


def with_errors_of_log(source: ReplayInput) -> ReplayInput:
    """The input as `taken_from_log` makes it, with a note of what was found."""
    robots = sorted({frame.robot for frames in source.steps for frame in frames})
    paths = [[frame for frames in source.steps for frame in frames if frame.robot == robot] for robot in robots]
    if source.is_episode:
        return source
    if with_gyro := [
        str(source.names[robot] or robot) for robot, path in zip(robots, paths, strict=True) if _has_gyro(path)
    ]:
        return dataclasses.replace(source, notes=[*source.notes, UNTOLD_GYRO.format(", ".join(with_gyro))])
    config, without, told = taken_from_log(source.config, paths)
    if not told:
        return dataclasses.replace(source, notes=[*source.notes, UNTOLD])
    own = {robot: iter(path) for robot, path in zip(robots, without, strict=True)}
    steps = [tuple(next(own[frame.robot]) for frame in frames) for frames in source.steps]
    names = [f"robot {source.names[robot] or robot}, " if len(robots) > 1 else "" for robot in robots]
    notes = [name + _described(errors) for name, errors in zip(names, told, strict=True)]
    return dataclasses.replace(source, config=config, steps=steps, notes=[*source.notes, *notes])


def taken_from_log(
    config: EnvConfig, paths: Sequence[Sequence[SensorFrame]]
) -> tuple[EnvConfig, Sequence[Sequence[SensorFrame]], list[OdometryErrors]]:
    """Settings with the noise that the frames of robots without gyros show, the frames of each without the constant
    errors of its odometry, and these errors.

    Of several robots the greatest noise counts. If a robot has too few matched scans, all stays as it is.
    """
    told = [errors for path in paths if (errors := errors_of(path, config)) is not None]
    if len(told) < len(paths):
        return config, paths, []
    noise = {
        "position_std_per_m": 0.0,
        "position_std_m": min(max(errors.position_std_m for errors in told), NOISE_MAX),
        "turn_std_rad": min(max(errors.turn_std_rad for errors in told), NOISE_MAX),
    }
    config = override(config, {f"slam.odometry_filter.{name}": value for name, value in noise.items()})
    return config, [corrected(path, errors) for path, errors in zip(paths, told, strict=True)], told


def errors_of(frames: Sequence[SensorFrame], config: EnvConfig) -> OdometryErrors | None:
    """Errors of the odometry of one robot's frames; None if too few scans are matched, or many in a motion."""
    front = FrontEnds(override(config, {"robots": 1}), 1)
    read: list[Array] = []
    matched: list[Array] = []
    steps: list[int] = []
    stretch, before, is_dense = _Stretch(), None, False
    for k, frame in enumerate(frames):
        front.update(front.intake.on_circle([dataclasses.replace(frame, robot=0)])[0])
        stretch.add(frame.odometry)
        if k > 0 and not stretch.is_long:
            continue
        is_known = k == 0 or _is_held(front.information[0])
        if before is not None and is_known:
            read.append(stretch.motion)
            matched.append(between(before, front.poses_odom[0]))
            steps.append(stretch.steps)
        stretch, before = _Stretch(), front.poses_odom[0] if is_known else None
        is_dense = len(read) == MOTIONS_MIN and bool(np.median(steps) > STEPS_MAX)
        if is_dense or len(read) == MOTIONS_MAX:
            break
    if len(read) < MOTIONS_MIN or is_dense:
        return None
    found = fitted(np.array(read), np.array(matched), np.array(steps))
    return found if np.isfinite(dataclasses.astuple(found)).all() else None


def fitted(read: Array, matched: Array, steps: Array) -> OdometryErrors:
    """Errors of motions (n, 3) that odometry read, of so many steps (n,) each, where the scans tell others (n, 3).

    They are shares of what is read: a turn that is large is large in part by noise, and to take that off too gives the
    likeliest motion.
    """
    away = read - matched
    away[:, 2] = wrap_angle(away[:, 2])
    ahead, turns = read[:, :1], read[:, [0, 2]]
    (scale,), (skew,), (curl, turn) = _fit(ahead, away[:, 0]), _fit(ahead, away[:, 1]), _fit(turns, away[:, 2])
    rest = away - np.column_stack([ahead * [scale, skew], turns @ [curl, turn]])
    std = [_std(column / np.sqrt(steps)) for column in rest.T]
    return OdometryErrors(len(read), scale, skew, curl, turn, max(std[0], std[1]), std[2])


def corrected(frames: Sequence[SensorFrame], errors: OdometryErrors) -> list[SensorFrame]:
    """The frames of one robot without the constant errors of its odometry, whose turn is also the gyro's."""
    motions = errors.taken_off(np.array([frame.odometry for frame in frames]))
    waits_s = np.diff([frame.time_s for frame in frames], prepend=frames[0].time_s)
    rates = np.divide(motions[:, 2], waits_s, out=np.zeros(len(frames)), where=waits_s > 0.0)
    return [
        dataclasses.replace(frame, odometry=motion, turn_rate_rad_s=float(rate))
        for frame, motion, rate in zip(frames, motions, rates, strict=True)
    ]


class _Stretch:
    """Some steps of odometry in a row."""

    def __init__(self):
        self.motion, self.steps = np.zeros(3), 0
        """Motion (3,) over all steps, its turn not wrapped."""
        self._travelled_m = self._turned_rad = 0.0

    def add(self, odometry: Array) -> None:
        turn = self.motion[2] + odometry[2]
        self.motion = compose(self.motion, odometry)
        self.motion[2] = turn
        self.steps += 1
        self._travelled_m += float(np.hypot(odometry[0], odometry[1]))
        self._turned_rad += abs(float(odometry[2]))

    @property
    def is_long(self) -> bool:
        return self._travelled_m >= STRETCH_M or self._turned_rad >= STRETCH_RAD


def _is_held(information: Array) -> bool:
    values = np.linalg.eigvalsh(information)
    return bool(values[0] > HELD_SHARE * values[-1])


def _has_gyro(frames: Sequence[SensorFrame]) -> bool:
    """Whether the turn rates are another sensor's than the odometry."""
    waits_s = np.diff([frame.time_s for frame in frames])
    turns = np.array([(frame.turn_rate_rad_s, frame.odometry[2]) for frame in frames[1:]]).reshape(-1, 2)
    return bool((np.abs(wrap_angle(turns[:, 0] * waits_s - turns[:, 1])) > SAME_TURN_RAD).any())


def _fit(causes: Array, effect: Array) -> list[float]:
    """Factors (k,) of causes (n, k) by least squares, in which residuals beyond HUBER standard deviations count
    less."""
    factors, weights = np.zeros(causes.shape[1]), np.ones(len(effect))
    for _ in range(ROUNDS):
        weighted = (causes * weights[:, None]).T
        factors = np.linalg.solve(weighted @ causes + STEADY * np.eye(len(factors)), weighted @ effect)
        residuals = np.abs(effect - causes @ factors)
        weights = 1.0 / np.maximum(1.0, residuals / (HUBER * MAD * np.median(residuals) + STEADY))
    return [float(factor) for factor in factors]


def _std(residuals: Array) -> float:
    """Standard deviation of which single outliers know little: real odometry has more large errors than a normal
    distribution, and the median absolute deviation would know nothing of them."""
    away = np.abs(residuals)
    return float(np.sqrt(np.mean(np.minimum(away, WINSOR * MAD * np.median(away)) ** 2)))


def _described(errors: OdometryErrors) -> str:
    return (
        f"odometry by {errors.motions} motions between matched scans: reads {errors.scale:+.1%} of ways and "
        f"{errors.turn:+.1%} of turns, {np.degrees(errors.curl_rad_m):+.2f} degrees per metre ahead and "
        f"{np.degrees(errors.skew_rad):+.1f} degrees askew too much, which is taken off; the rest is noise of "
        f"{100 * errors.position_std_m:.1f} cm and {np.degrees(errors.turn_std_rad):.1f} degrees per scan "
        "(--noise assumed: neither)"
    )
