"""The cameras of a team: the sign readings of all robots in a step."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, robot_configs
from twc_env.kernels.compiled import BindsAnew, Lent, borrowing_kernel, bound, parts_of
from twc_env.records.messages import SignReading
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.sensors.misreading import CODES, LINE_DRAWS, misread_signs
from twc_env.world.sensors.noise import NormalPools
from twc_env.world.sensors.sign_readers import ocr_stream, shipped_reader, texts_of
from twc_env.world.sensors.signs import SignCamera, bearing_stream, mark_hidden, optics_of

_TURN_RAD = 2.0 * math.pi
Readings = tuple[Sequence[tuple[SignReading, ...]], tuple[tuple[int, ...], ...]]
"""Readings of each robot, and the true signs (plan numbers) behind them."""


class SignCameras(BindsAnew):
    """The cameras of all robots; each takes an image every `signs.period_s`, staggered. Equal to one `SignCamera` each.

    With the reader "fast", all readings of a step are computed by one compiled call.
    """

    def __init__(self, config: EnvConfig, plan: Floorplan, seed: int):
        own, robots, step_s = robot_configs(config), config.robots, config.dynamics.time_step_s
        is_fast = config.signs.reader == "fast"
        self._cameras = [
            SignCamera(own[robot].signs, plan, robot, seed, own[robot].dynamics)
            for robot in range(1 if is_fast else robots)
        ]
        self._periods = np.array([max(1, round(each.signs.period_s / step_s)) for each in own])
        optics = np.stack([optics_of(each.signs, step_s) for each in own])
        self._sights, self._hidden = self._cameras[0].allocate(robots)
        self._counts = np.zeros(robots, np.int64)
        self.arguments = (
            *self._cameras[0].seen, optics, config.signs.robots_hide, self._sights, self._hidden, self._counts,
            self._periods,
        )  # fmt: skip
        """Arguments of `look` without the poses: optics (robots, 6), whether robots occlude, its outputs, the counts
        (robots,) of signs in view, and the steps (robots,) from one image to the next."""
        self.nothing: Readings = ((),) * robots, ((),) * robots
        """The readings if no sign is in view."""
        self._hide: Callable[..., None] | None = None
        """`_hide_behind` bound to the arguments."""
        self._table: _TableReadings | None = None
        if is_fast:
            self._table = _TableReadings(config, tuple(sign.text for sign in plan.signs), seed, self.arguments[-4:])

    def hide(self, step: int, poses: Array, bodies: Array) -> None:
        """Hide the characters of signs in view at poses (n, 3) that are behind bodies (k, 3): x, y and radius."""
        bodies = np.ascontiguousarray(bodies)
        if self._hide is None:
            self._hide = bound(_hide_behind, Lent(self.arguments), step, poses, bodies)
        self._hide(step, poses, bodies)

    def read(self, step: int) -> Readings:
        """The readings of the signs that `look` has found in view in a step."""
        readings, sources = list(self.nothing[0]), list(self.nothing[1])
        if self._table is not None:
            for robot, sign, reading in self._table.read(step):
                readings[robot] += (reading,)
                sources[robot] += (sign,)
        else:
            for robot in np.flatnonzero((step + np.arange(len(self._periods))) % self._periods == 0).tolist():
                sights = self._sights[robot, : self._counts[robot]]
                readings[robot], sources[robot] = self._cameras[robot].read_sights(sights, self._hidden[robot])
        return readings, tuple(sources)


@borrowing_kernel
def _hide_behind(cameras, step, poses, bodies):
    """Set hidden (robots, signs, characters) for the characters behind bodies (k, 3: x, y, radius), for robots with a
    new image."""
    signs, lengths, optics, _does_hide, sights, hidden, counts, periods = parts_of(cameras)
    for i in range(poses.shape[0]):
        if (step + i) % periods[i] != 0:
            continue
        for k in range(counts[i]):
            sign = int(sights[i, k, 0])
            mark_hidden(
                signs[sign], poses[i, 0], poses[i, 1], bodies, bodies[:, 2], optics[i, 5], hidden[i, k, : lengths[sign]]
            )


class _TableReadings(BindsAnew):
    """Samples the readings of all robots from the measured table."""

    def __init__(self, config: EnvConfig, texts: tuple[str, ...], seed: int, views: tuple):
        """views: sights and hidden characters of all robots, counts of sights (robots,), and periods (robots,)."""
        self._texts, robots = texts_of(texts, seed), range(config.robots)
        errors = [(own.signs.bearing_noise_std_rad, own.signs.range_noise_std_m) for own in robot_configs(config)]
        most = len(robots) * len(texts)
        draws = LINE_DRAWS * len(texts) + 2 * sum(map(len, texts))
        self._text_noise = NormalPools([ocr_stream(seed, robot) for robot in robots], draws)
        self._position_noise = NormalPools([bearing_stream(seed, robot) for robot in robots], draws)
        self._letters = np.empty(len(robots) * self._texts.out.size, np.uint32)
        self._found, self._measured = np.empty((most, 3), np.int64), np.empty((most, 2))
        self._arrays = (
            *views, *self._text_noise.arguments, *self._position_noise.arguments, np.array(errors),
            *self._texts.arguments, self._letters, self._found, self._measured,
        )  # fmt: skip
        self._run: Callable[[int], int] | None = None
        """`_read_in_view` with the arrays."""

    def read(self, step: int) -> list[tuple[int, int, SignReading]]:
        """(robot, sign, reading) of all signs read in a step."""
        if self._run is None:
            team = Lent(self._arrays)
            self._run = partial(bound(_read_in_view, shipped_reader().table, team, step), team)
        count = self._run(step)
        while count < 0:
            self._text_noise.refill(-count)
            self._position_noise.refill(-count)
            count = self._run(step)
        found, begin, readings = self._found[:count].tolist(), 0, []
        text = self._letters[: found[-1][2]].tobytes().decode(CODES) if found else ""
        for (robot, sign, end), (bearing, distance) in zip(found, self._measured[:count].tolist(), strict=True):
            line, begin = text[begin:end].strip(), end
            if line:
                readings.append((robot, sign, SignReading(line, math.remainder(bearing, _TURN_RAD), distance)))
        return readings


@borrowing_kernel
def _read_in_view(table, team, step):
    """Read the signs in view of robots with a new image in a step; returns the count of texts read.

    Fills found (k, 3): robot, sign and end of its text in `letters`; measured (k, 2): bearing and distance. If some
    robot needs more random numbers than available, nothing is read, and minus the number needed is returned.
    """
    (
        sights, hidden, sight_counts, periods, text_noise, text_used, text_end, position_noise, position_used,
        position_end, errors, codes, lengths, kept, weights, draws, levels, out, counts, letters,
        found, measured,
    ) = parts_of(team)  # fmt: skip
    for robot in range(sight_counts.shape[0]):
        if (step + robot) % periods[robot] != 0:
            continue
        needed = 0
        for k in range(sight_counts[robot]):
            needed += LINE_DRAWS + 2 * lengths[int(sights[robot, k, 0])]
        if max(text_used[robot] + needed - text_end[robot], position_used[robot] + needed - position_end[robot]) > 0:
            return -needed
    end = read = 0
    for robot in range(sight_counts.shape[0]):
        if (step + robot) % periods[robot] != 0:
            continue
        count = sight_counts[robot]
        text_used[robot] = misread_signs(
            table, count, sights[robot], hidden[robot], text_noise[robot], text_used[robot], codes, lengths, kept,
            weights, draws, levels, out, counts,
        )  # fmt: skip
        for k in range(count):
            if counts[k] > 0:
                for m in range(counts[k]):
                    letters[end + m] = out[k, m]
                end += counts[k]
                found[read, 0], found[read, 1], found[read, 2] = robot, int(sights[robot, k, 0]), end
                measured[read, 0] = (
                    sights[robot, k, 2] + errors[robot, 0] * position_noise[robot, position_used[robot] + 2 * k]
                )
                off = errors[robot, 1] * position_noise[robot, position_used[robot] + 2 * k + 1]
                measured[read, 1] = max(sights[robot, k, 1] + off, 0.0)
                read += 1
        position_used[robot] += 2 * count
    return read
