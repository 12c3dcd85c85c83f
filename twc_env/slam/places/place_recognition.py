"""Propose loop closure candidates: pairs of keyframes that may show the same place.

Recognisers are selected by name: `text`, `wifi`, `twc` (TWC-SLAM's Algorithm 1), `lidar` (Scan Context, the baseline of
DCL-SLAM's kind), `fused` (log-odds of all cues), or FILE.py:CLASS. `make_recogniser` constructs one.
"""

from __future__ import annotations

import math
from bisect import bisect, insort
from collections.abc import Callable, Sequence
from typing import Protocol

from twc_env.config import PlaceRecognitionConfig
from twc_env.records.class_file import is_in_file
from twc_env.records.messages import Keyframe, LoopCandidate
from twc_env.slam.places.fused_recogniser import FusedRecogniser
from twc_env.slam.places.signless_recognisers import ScanRecogniser, WifiRecogniser
from twc_env.slam.places.text_wifi_recogniser import TextRecogniser, TextWifiRecogniser
from twc_env.slam.places.user_recogniser import OwnRecogniser


class Recogniser(Protocol):
    """Interface of all recognisers."""

    name: str
    """Written into the candidates. Candidates named `lidar` or `wifi` are verified at all headings, others near their
    guess."""

    def propose(self, keyframe: Keyframe, skipped_robots: Sequence[int] = ()) -> list[LoopCandidate]:
        """Candidates between this keyframe (source) and all earlier ones (targets) of robots that are not skipped.

        The keyframe is stored as a target for later calls.
        """

    def score(self, target: Keyframe, source: Keyframe) -> float:
        """Similarity of two keyframes; larger is more similar. Its scale depends on the recogniser."""

    def sparsify(self, is_held: Callable[[Keyframe], bool]) -> None:
        """Remove all data of keyframes that are no longer held."""


def make_recogniser(config: PlaceRecognitionConfig, range_max_m: float) -> Recogniser:
    """The recogniser that the config names; `range_max_m` is the scanner's. A custom class gets both arguments."""
    if is_in_file(config.recogniser):
        return OwnRecogniser(config, range_max_m)
    by_signs: dict[str, type[TextWifiRecogniser]] = {"twc": TextWifiRecogniser, "text": TextRecogniser}
    if config.recogniser in by_signs:
        return by_signs[config.recogniser](config)
    if config.recogniser == "wifi":
        return WifiRecogniser(config, range_max_m)
    if config.recogniser == "lidar":
        return ScanRecogniser(config, range_max_m)
    return FusedRecogniser(config, range_max_m)


class ProposalFilter:
    """Rejects candidates that repeat an earlier one: both ends near those of an earlier candidate along the paths."""

    def __init__(self):
        self._tried: dict[tuple[int, int], list[tuple[float, float]]] = {}
        """Pair of robots -> path lengths at both ends of earlier candidates, ascending."""

    def is_new(self, target: Keyframe, source: Keyframe, reach_m: float) -> bool:
        """Whether no earlier candidate of the two robots lies within reach_m at both ends; stores this one."""
        first, second = (target, source) if target.robot <= source.robot else (source, target)
        tried = self._tried.setdefault((first.robot, second.robot), [])
        a, b = first.travel_m, second.travel_m
        for k in range(bisect(tried, (a - reach_m, math.inf)), len(tried)):
            x, y = tried[k]
            if x >= a + reach_m:
                break
            if abs(b - y) < reach_m:
                return False
        insort(tried, (a, b))
        return True

    def drop_before(self, until_m: Sequence[float]) -> None:
        """Remove candidates before these path lengths [m] of both robots, which no new one can come near."""
        for (a, b), tried in self._tried.items():
            tried[:] = [(x, y) for x, y in tried if x >= until_m[a] or y >= until_m[b]]
