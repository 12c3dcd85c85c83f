"""What one mapper lacked, in words: cues that never came, robots that fell silent, names and devices that mislead."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence

import numpy as np

from twc_env.messages import Keyframe
from twc_env.slam.map_merging import fingerprint_matrix
from twc_env.slam.team import TeamMapper

SILENT_S = 20.0
"""A robot that sent nothing for longer is named; one that stands still has nothing to send either."""
DEVICE_OFFSET_DB, TRANSMITTERS_MIN, PLACES_MIN = 5.0, 3, 3
"""Devices that differ by more, over so many transmitters at so many common places, are named."""
REPEATED_APART_M, REPEATED_SHARE, NAMES_MIN = 4.0, 0.5, 4
"""A name at places this far apart on one robot's own map is repeated; with this share of the names there is a lack."""


def shortcomings(mapper: TeamMapper, time_s: float) -> list[str]:
    """One line per lack of a mapper at a time [s], in a fixed order; empty when nothing was amiss."""
    return [
        *_missing(mapper.keyframes, "signs", "no signs read", lambda k: len(k.signs) > 0),
        *_missing(mapper.keyframes, "WiFi", "no WiFi heard", lambda k: len(k.fingerprint.macs) > 0),
        *_silent(mapper.keyframes, time_s),
        *_repeated_names(mapper),
        *_odd_devices(mapper),
        *_apart(mapper),
        *_refused(mapper),
    ]


def _missing(paths: Sequence[Sequence[Keyframe]], what: str, nowhere: str, has) -> list[str]:
    without = [robot for robot, path in enumerate(paths) if path and not any(has(k) for k in path)]
    if without and len(without) == sum(bool(path) for path in paths):
        return [nowhere]
    return [f"no {what} from robot {robot}" for robot in without]


def _silent(paths: Sequence[Sequence[Keyframe]], time_s: float) -> list[str]:
    lines = []
    for robot, path in enumerate(paths):
        if not path:
            lines.append(f"no message from robot {robot}")
        elif time_s - path[-1].time_s > SILENT_S:
            lines.append(f"no message from robot {robot} since {path[-1].time_s:.1f} s")
    return lines


def _repeated_names(mapper: TeamMapper) -> list[str]:
    """Names that one robot, by its own odometry, found at several places."""
    places: dict[str, list[tuple[int, np.ndarray]]] = {}
    for robot, path in enumerate(mapper.keyframes):
        for keyframe in path:
            for sign in keyframe.signs:
                places.setdefault(sign.text, []).append((robot, keyframe.pose_odom[:2]))
    readings = {text: found for text, found in places.items() if len(found) > 1}
    repeated = [
        text
        for text, found in readings.items()
        if any(
            np.ptp(np.array([at for r, at in found if r == robot]), axis=0).max() > 2 * REPEATED_APART_M
            for robot in {r for r, _ in found}
        )
    ]
    if len(readings) < NAMES_MIN or len(repeated) < REPEATED_SHARE * len(readings):
        return []
    return [f"{len(repeated)} of {len(readings)} names that were read more than once stand at several places"]


def _odd_devices(mapper: TeamMapper) -> list[str]:
    """Robots whose receivers disagree where closures say that they stood at one place."""
    differences: dict[tuple[int, int], list[float]] = {}
    for closure in mapper.closures:
        (a, i), (b, j) = sorted((closure.candidate.target, closure.candidate.source))
        if a == b or closure.status == "rejected" or math.hypot(*closure.pose_target_source[:2]) > REPEATED_APART_M:
            continue
        prints = mapper.keyframes[a][i].fingerprint, mapper.keyframes[b][j].fingerprint
        levels = fingerprint_matrix(prints)
        both = np.isfinite(levels).all(axis=0)
        if both.sum() >= TRANSMITTERS_MIN:
            differences.setdefault((a, b), []).append(float(np.median(levels[1, both] - levels[0, both])))
    lines = []
    for (a, b), values in sorted(differences.items()):
        offset_db = float(np.median(values))
        if len(values) >= PLACES_MIN and abs(offset_db) > DEVICE_OFFSET_DB:
            lines.append(f"robot {b} reads WiFi {offset_db:+.0f} dB against robot {a}")
    return lines


def _apart(mapper: TeamMapper) -> list[str]:
    groups = [group.robots for group in mapper.groups]
    if len(groups) < 2:
        return []
    pending = sum(closure.status == "pending" for closure in mapper.closures)
    return [
        f"no common map of {' and '.join(str(list(g)) for g in groups)}; {pending} closures wait for others that agree"
    ]


def _refused(mapper: TeamMapper) -> list[str]:
    """Kinds of reasons for which candidates were refused, the most frequent first."""
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
