"""Human-readable diagnostics of one mapper: missing cues, silent robots, repeated names and deviating receivers."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.slam.mapping.segments import NO_ROBOT
from twc_env.slam.places.device_offsets import LETTERS_MIN, DeviceOffsets, offset_of
from twc_env.slam.places.text_similarity import normalise
from twc_env.slam.team import TeamMapper

SILENT_S = 5.0
"""Robots not heard for longer are reported."""
REPEATED_APART_M, REPEATED_SHARE, NAMES_MIN = 4.0, 0.4, 4
"""A name at places this far apart in one map is repeated; from this share of repeated names on they are reported."""


CONTRADICTING_MIN = 5
"""Fewer closures that contradict a map, or agree on another one, are no reason to doubt it."""
RIVAL_SHARE = 0.5
"""Closures between two robots that agree on another map are a reason from this share of those in use on."""
SHOWN_MAX = 20
"""Segments of a robot's path, and maps, that are told one by one."""
NEVER = -1
"""In place of a step: not heard yet."""


class Listening:
    """When each mapper last heard each robot, and its longest silence."""

    def __init__(self, listeners: int, robots: int, time_step_s: float):
        self._time_step_s = time_step_s
        self.last_steps = np.full((listeners, robots), NEVER)
        """Step at which each listener last heard each robot that it does not hear now."""
        self.is_heard = np.zeros((listeners, robots), np.bool_)
        """(listeners, robots) whom each listener hears in the latest step. Both arrays are modified in place."""
        self._silence = np.zeros((listeners, robots, 2), np.int64)
        """First and last step of the longest silence that ended."""
        self._latest: Array | None = None
        self._latest_bytes = b""
        """Contacts of the latest step: array and content."""
        self.last_step = 0

    @property
    def has_begun(self) -> bool:
        """Whether any step has been noted."""
        return self._latest is not None

    def note(self, step: int, heard: Array) -> None:
        """Record the contacts of a step; heard (listeners, robots) bool, not modified afterwards."""
        is_same = heard is self._latest
        if step == self.last_step + 1 and (is_same or heard.tobytes() == self._latest_bytes):
            self._latest, self.last_step = heard, step
            return
        self.last_steps[self.is_heard] = self.last_step
        self._latest, self._latest_bytes, self.last_step = heard, heard.tobytes(), step
        begin = np.maximum(self.last_steps, 0)
        ended = heard & (step - begin > self._silence[..., 1] - self._silence[..., 0])
        if ended.any():
            self._silence[ended, 0] = begin[ended]
            self._silence[ended, 1] = step
        self.is_heard[:] = heard

    def lines(self, listener: int, robots: Collection[int]) -> list[str]:
        """Reports of robots that this listener has not heard for long, now or earlier."""
        found, step, time_step_s = [], self.last_step, self._time_step_s
        for robot in robots:
            last = step if self.is_heard[listener, robot] else max(self.last_steps[listener, robot], 0)
            begin, end = self._silence[listener, robot]
            if (step - last) * time_step_s > SILENT_S:
                found.append(f"robot {robot} not heard since {last * time_step_s:.1f} s")
            if (end - begin) * time_step_s > SILENT_S:
                found.append(f"robot {robot} not heard from {begin * time_step_s:.1f} s to {end * time_step_s:.1f} s")
        return found


def diagnostics_of(mapper: TeamMapper) -> list[str]:
    """One line per problem of a mapper so far, in a fixed order; empty without problems."""
    return [
        *_carried(mapper),
        *_missing(mapper, "signs", "no signs read", lambda k: len(k.signs) > 0),
        *_missing(mapper, "WiFi", "no WiFi heard", lambda k: len(k.fingerprint.macs) > 0),
        *_repeated_names(mapper),
        *_odd_devices(mapper),
        *_apart(mapper),
        *_contradicted(mapper),
        *_refused(mapper),
    ]


def _carried(mapper: TeamMapper) -> list[str]:
    """When robots were put down elsewhere, and which of the segments of their paths are in no common map; one line of a
    robot for which it is said too often to be true."""
    found, segments = [], mapper.segments
    counts = Counter(segments.owners)
    for segment, robot in enumerate(segments.owners):
        if robot in (segment, NO_ROBOT):
            continue
        before = segments.of(robot)[segments.of(robot).index(segment) - 1]
        time_s = mapper.keyframes[segment][0].time_s
        if counts[robot] > SHOWN_MAX:
            if before == robot:
                found.append(
                    f"robot {robot} was put down elsewhere {counts[robot] - 1} times, first at {time_s:.1f} s: nobody "
                    "carries a robot so often, so its scans and its odometry do not go together; look at the direction "
                    "of its beams, where its scanner is mounted, and at units and times"
                )
            continue
        is_joined = mapper.group_of_segment(segment) == mapper.group_of_segment(before)
        where = "in the same map as its path before" if is_joined else "in another map than its path before"
        found.append(f"robot {robot} was put down elsewhere at {time_s:.1f} s: its path since is {where}")
    return found


def _name(mapper: TeamMapper, segment: int) -> str:
    """Name of a robot, or of a part of its path after it was carried."""
    robot = mapper.segments.owners[segment]
    if robot == NO_ROBOT:
        return "the prior map"
    return f"robot {robot}" if segment == robot else f"robot {robot} after being carried (segment {segment})"


def _missing(mapper: TeamMapper, what: str, nowhere: str, has) -> list[str]:
    paths = mapper.keyframes
    without = [robot for robot, path in enumerate(paths) if path and not any(has(k) for k in path)]
    if without and len(without) == sum(bool(path) for path in paths):
        return [nowhere]
    return [f"no {what} from {_name(mapper, robot)}" for robot in without]


def _repeated_names(mapper: TeamMapper) -> list[str]:
    """Names that occur at several places of one map, if they are many."""
    readings = Counter(sign.text for path in mapper.keyframes for keyframe in path for sign in keyframe.signs)
    names = {text for text, count in readings.items() if count > 1 and len(text) >= LETTERS_MIN}
    repeated = set()
    for group in range(len(mapper.groups)):
        places: dict[str, list[Array]] = {}
        for sign in mapper.signs_of(group):
            places.setdefault(sign.text, []).append(sign.position_m)
        repeated |= {text for text, at in places.items() if np.ptp(np.array(at), axis=0).max() > REPEATED_APART_M}
    count = len(repeated & names)
    if len(names) < NAMES_MIN or count < REPEATED_SHARE * len(names):
        return []
    return [f"{count} of {len(names)} sign texts occur at several places"]


def _odd_devices(mapper: TeamMapper) -> list[str]:
    """Robots whose receivers have an offset where both read the same name (median, since names may be duplicated)."""
    devices, paths = DeviceOffsets(), mapper.keyframes
    devices.make_room(len(paths))
    for robot, path in enumerate(paths):
        for keyframe in path:
            for sign in keyframe.signs:
                devices.note(robot, normalise(sign.text), keyframe.fingerprint)
    pairs = itertools.combinations(range(len(paths)), 2)
    differences = {(a, b): offset_of(devices.between(a, b)) for a, b in pairs}
    return [
        f"{_name(mapper, b)} reads WiFi {offset_db:+.0f} dB against {_name(mapper, a)} where both read a name"
        for (a, b), offset_db in differences.items()
        if offset_db != 0.0
    ]


def _apart(mapper: TeamMapper) -> list[str]:
    groups, lines = [group.robots for group in mapper.groups], []
    if mapper.prior is not None:
        lines = [f"{_names(mapper, g)} did not find the prior map" for g in groups if mapper.prior not in g]
        groups = [own for g in groups if (own := tuple(robot for robot in g if robot != mapper.prior))]
    if len(groups) < 2:
        return lines
    pending = sum(closure.status == "pending" for closure in mapper.closures)
    why = f"{pending} closures between them wait for others that agree" if pending else "neither recognised the other's"
    shown = [_names(mapper, g) for g in groups[: None if len(groups) <= SHOWN_MAX else 1]]
    others = [f"{len(groups) - len(shown)} others"] if len(shown) < len(groups) else []
    return [*lines, f"no common map of {' and '.join([*shown, *others])}: {why}"]


def _names(mapper: TeamMapper, segments: tuple[int, ...]) -> str:
    """Names of robots, and of parts of their paths after they were carried."""
    robots = [segment for segment in segments if mapper.segments.owners[segment] == segment]
    names = [f"robot{'s' * (len(robots) > 1)} {', '.join(map(str, robots))}"] if robots else []
    return ", ".join([*names, *(_name(mapper, segment) for segment in segments if segment not in robots)])


def _contradicted(mapper: TeamMapper) -> list[str]:
    """Maps that most closures contradict, if those that agree on one other map are not far fewer than its own."""
    found = []
    for group in mapper.groups:
        accepted, refused = mapper.votes_in(group.robots)
        if refused < CONTRADICTING_MIN or refused <= accepted:
            continue
        who = " and ".join(_name(mapper, segment) for segment in group.robots)
        for (a, b), (held, rivals) in mapper.rival_votes_in(group.robots).items():
            if rivals >= CONTRADICTING_MIN and rivals > RIVAL_SHARE * held:
                between = f"of {_name(mapper, a)}" if a == b else f"between {_name(mapper, a)} and {_name(mapper, b)}"
                found.append(
                    f"the map of {who} cannot be trusted: {rivals} closures {between} agree on another one, "
                    f"{held} on this one"
                )
    return found


def _refused(mapper: TeamMapper) -> list[str]:
    """Reasons for which candidates were rejected, most frequent first."""
    kinds = Counter(
        re.split(r"[\d(]", closure.reason, maxsplit=1)[0].strip() or "distance from the estimate"
        for closure in mapper.closures
        if closure.status == "rejected"
    )
    if not kinds:
        return []
    return [
        "candidates refused: "
        + ", ".join(f"{count} by {kind}" for kind, count in sorted(kinds.items(), key=lambda k: (-k[1], k[0])))
    ]
