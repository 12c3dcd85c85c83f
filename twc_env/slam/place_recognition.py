"""Propose loop candidates: pairs of keyframes that look like one place."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twc_env.config import PlaceRecognitionConfig
from twc_env.geometry import compose, inverse
from twc_env.messages import Keyframe, LoopCandidate, SignObservation
from twc_env.slam.radio_fingerprint import mac_similarity, rssi_distance_db, rssi_similarity
from twc_env.slam.text_similarity import normalise, text_similarities

Array = NDArray

SAME_PLACE_M = 0.5
"""The same text read again within this path length ..."""
SAME_SIGN_M = 1.0
"""... at a place nearer than this is not remembered twice."""


class TextWifiRecogniser:
    """Algorithm 1 of TWC-SLAM: like text, then shared transmitters, then like strengths (SPEC T9).

    Every text that was ever read is kept with its keyframe; a new keyframe is compared with all of them, of its own
    robot (when enough path lies between) and of the others.
    """

    def __init__(self, config: PlaceRecognitionConfig):
        self._config = config
        self._texts: list[str] = []
        self._recent: dict[tuple[int, str], deque[tuple[float, Array]]] = {}
        self._places: list[tuple[Keyframe, SignObservation]] = []

    def propose(self, keyframe: Keyframe, skipped_robots: Sequence[int] = ()) -> list[LoopCandidate]:
        """Candidates between this keyframe (source) and all earlier ones (targets) of robots that are not skipped.

        The keyframe is remembered for those that follow.
        """
        rule = self._config
        best: dict[tuple[int, int], LoopCandidate] = {}
        readings = [(self._key(sign.text), sign) for sign in keyframe.signs]
        for text, sign in readings:
            similarity = text_similarities(text, self._texts)
            for k in np.flatnonzero(similarity >= rule.text_similarity_min - 1e-9):
                target, target_sign = self._places[k]
                if target.robot in skipped_robots:
                    continue
                if target.robot == keyframe.robot and keyframe.travel_m - target.travel_m < rule.revisit_travel_m:
                    continue
                candidate = self._compare(target, target_sign, keyframe, sign, float(similarity[k]))
                if candidate is None:
                    continue
                held = best.get(candidate.target)
                if held is None or candidate.text_similarity > held.text_similarity:
                    best[candidate.target] = candidate
        for text, sign in readings:
            self._remember(text, keyframe, sign)
        return list(best.values())

    def _remember(self, text: str, keyframe: Keyframe, sign: SignObservation) -> None:
        """Keep a reading, unless no wall is known behind it or the same robot read the same just before."""
        if math.isnan(sign.facing_rad):
            return
        position = compose(keyframe.pose_odom, [*sign.position_m, 0.0])[:2]
        for travel_m, other in self._recent.get((keyframe.robot, text), ()):
            if keyframe.travel_m - travel_m < SAME_PLACE_M and math.dist(position, other) < SAME_SIGN_M:
                return
        recent = self._recent.setdefault((keyframe.robot, text), deque(maxlen=4))
        recent.append((keyframe.travel_m, position))
        self._texts.append(text)
        self._places.append((keyframe, sign))

    def _key(self, text: str) -> str:
        return normalise(text) if self._config.normalise_text else text

    def _compare(
        self,
        target: Keyframe,
        target_sign: SignObservation,
        source: Keyframe,
        source_sign: SignObservation,
        text: float,
    ) -> LoopCandidate | None:
        rule = self._config
        if math.isnan(target_sign.facing_rad) or math.isnan(source_sign.facing_rad):
            return None
        macs = mac_similarity(target.fingerprint, source.fingerprint)
        if macs < rule.mac_similarity_min - 1e-9:
            return None
        distance_db, shared = rssi_distance_db(target.fingerprint, source.fingerprint)
        if rule.rssi_mode == "paper":
            rssi, is_alike = distance_db, shared > 0 and distance_db >= rule.rssi_similarity_min
        else:
            rssi = rssi_similarity(distance_db, shared, rule.rssi_tolerance_db)
            is_alike = rssi >= rule.rssi_similarity_min - 1e-9
        if not is_alike:
            return None
        return LoopCandidate(
            target=(target.robot, target.index),
            source=(source.robot, source.index),
            guess=_meet_at_sign(target_sign, source_sign),
            recogniser="twc",
            sign_m=target_sign.position_m,
            text_similarity=text,
            mac_similarity=macs,
            rssi_similarity=rssi,
        )


def _meet_at_sign(target: SignObservation, source: SignObservation) -> Array:
    """Pose of the source in the target's frame if both see one sign: lay the two sign frames on each other."""
    target_sign = np.array([*target.position_m, target.facing_rad])
    source_sign = np.array([*source.position_m, source.facing_rad])
    return compose(target_sign, inverse(source_sign))


class ProposalFilter:
    """Drops proposals that repeat what was tried: both ends near, along the paths, to those of an earlier one."""

    def __init__(self):
        self._tried: dict[tuple[int, int], list[tuple[float, float]]] = {}

    def is_new(self, target: Keyframe, source: Keyframe, reach_m: float) -> bool:
        """Whether no earlier proposal between the two robots lies within reach_m at both ends; remembers this one."""
        if target.robot > source.robot:
            target, source = source, target
        tried = self._tried.setdefault((target.robot, source.robot), [])
        a, b = target.travel_m, source.travel_m
        if any(abs(a - x) < reach_m and abs(b - y) < reach_m for x, y in tried):
            return False
        tried.append((a, b))
        return True
