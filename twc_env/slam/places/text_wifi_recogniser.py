"""Place recognition by similar sign texts, with WiFi (TWC-SLAM's Algorithm 1) or without."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PlaceRecognitionConfig
from twc_env.records.geometry import wrap_one
from twc_env.records.messages import Fingerprint, Keyframe, LoopCandidate, SignObservation
from twc_env.slam.places.place_cues import rssi_cue, similarities
from twc_env.slam.places.sign_table import RadioRule, SignTable
from twc_env.slam.places.text_similarity import SimilarTexts, normalise

SAME_PLACE_M = 0.5
"""The same text read again within this path length ..."""
SAME_SIGN_M = 1.0
"""... and this distance is not stored twice."""


class TextWifiRecogniser:
    """Algorithm 1 of TWC-SLAM: similar text, then shared transmitters, then similar strengths (papers.md T9).

    All readings are stored with their keyframes. A new keyframe is compared with all of them: of its own robot, if far
    enough along the path, and of the others.
    """

    name = "twc"

    def __init__(self, config: PlaceRecognitionConfig):
        self._config = config
        self._texts = SimilarTexts(config.text_similarity_min - 1e-9)
        self._radio = RadioRule.of(config, config.spares_missing_cues)
        self._recent: dict[tuple[int, str], deque[tuple[float, tuple[float, float]]]] = {}
        self._places: list[tuple[Keyframe, SignObservation]] = []
        self._table = SignTable()
        """The same places as `_places`."""
        self.is_wanted: Callable[[Keyframe, Keyframe], bool] | None = None
        """Filter of candidates by target and source; None accepts all."""

    def propose(self, keyframe: Keyframe, skipped_robots: Sequence[int] = ()) -> list[LoopCandidate]:
        """See `Recogniser`; of several matching texts of a pair the most similar counts."""
        if not keyframe.signs:
            return []
        readings = [(self._key(sign.text), sign) for sign in keyframe.signs]
        candidates = self._compare(keyframe, readings, skipped_robots)
        for text, sign in readings:
            for other in self._remember(text, keyframe, sign):
                if other not in skipped_robots:
                    candidates += self._compare_anew(keyframe.robot, other)
        return candidates

    def _compare(
        self, keyframe: Keyframe, readings: Sequence[tuple[str, SignObservation]], skipped_robots: Sequence[int]
    ) -> list[LoopCandidate]:
        """Candidates between a keyframe with these readings and all stored places; one per target keyframe."""
        best: dict[tuple[int, int], tuple[float, int, SignObservation, float, float]] = {}
        for text, sign in readings:
            if math.isnan(sign.facing_rad):
                continue
            alike, apart_m = self._texts.alike(text), self._config.revisit_travel_m
            rows = self._table.like(alike, keyframe, skipped_robots, apart_m, self._radio)
            for k, similarity, macs, rssi in self._passing(rows, keyframe.fingerprint):
                target = self._places[k][0].key
                if target not in best or similarity > best[target][0]:
                    best[target] = similarity, k, sign, macs, rssi
        is_wanted, places = self.is_wanted, self._places
        return [
            self._candidate(keyframe, *entry)
            for entry in best.values()
            if is_wanted is None or is_wanted(places[entry[1]][0], keyframe)
        ]

    def _compare_anew(self, robot: int, other: int) -> list[LoopCandidate]:
        """Candidates between all places of two robots, after the offset of their receivers became known."""
        skipped = {place.robot for place, _ in self._places} - {other}
        return [
            candidate
            for keyframe, sign in self._places
            if keyframe.robot == robot
            for candidate in self._compare(keyframe, [(self._key(sign.text), sign)], sorted(skipped))
        ]

    def _candidate(
        self, source: Keyframe, similarity: float, number: int, sign: SignObservation, macs: float, rssi: float
    ) -> LoopCandidate:
        """The candidate of a sign seen from a keyframe and the stored place of that number."""
        target, target_sign = self._places[number]
        return LoopCandidate(
            target.key, source.key, meet_at_sign(target_sign, sign), self.name, target_sign.position_m,
            text_similarity=similarity, mac_similarity=macs, rssi_similarity=rssi,
        )  # fmt: skip

    def score(self, target: Keyframe, source: Keyframe) -> float:
        """The smallest of the three similarities: the largest common threshold that the pair passes."""
        cues = similarities(target, source, self._config)
        return min(cues.text, cues.macs, cues.rssi)

    def _passing(self, rows: list[list[float]], heard: Fingerprint) -> list[tuple[int, float, float, float]]:
        """Numbers of the places in these table rows whose strengths are similar to `heard`.

        With the similarities of texts, transmitters and strengths.
        """
        if self._config.rssi_mode == "saturating":  # already tested by the table
            return [(int(row[0]), row[1], row[2], row[3]) for row in rows]
        passed = []
        for row, text, macs, _, distance_db, shared in rows:
            k = int(row)
            rssi, is_alike = rssi_cue(distance_db, int(shared), self._config, (self._places[k][0].fingerprint, heard))
            if is_alike:
                passed.append((k, text, macs, rssi))
        return passed

    def _remember(self, text: str, keyframe: Keyframe, sign: SignObservation) -> list[int]:
        """Store a reading, unless no wall is known behind it or the same robot read the same text just before.

        Returns as `SignTable.append`.
        """
        if math.isnan(sign.facing_rad):
            return []
        (x, y, heading), (ahead, left) = keyframe.pose_odom.tolist(), sign.position_m.tolist()
        c, s = math.cos(heading), math.sin(heading)
        position = x + c * ahead - s * left, y + s * ahead + c * left
        for travel_m, other in self._recent.get((keyframe.robot, text), ()):
            if keyframe.travel_m - travel_m < SAME_PLACE_M and math.dist(position, other) < SAME_SIGN_M:
                return []
        recent = self._recent.setdefault((keyframe.robot, text), deque(maxlen=4))
        recent.append((keyframe.travel_m, position))
        self._places.append((keyframe, sign))
        return self._table.append(keyframe, text, self._texts.number_of(text))

    def sparsify(self, is_held: Callable[[Keyframe], bool]) -> None:
        """See `Recogniser`."""
        is_kept = np.array([is_held(keyframe) for keyframe, _ in self._places], bool)
        self._places = [place for place, stays in zip(self._places, is_kept.tolist(), strict=True) if stays]
        texts = {self._key(sign.text) for _, sign in self._places}
        self._table.keep(is_kept, self._texts.keep(texts), texts)
        self._recent = {key: recent for key, recent in self._recent.items() if self._texts.has(key[1])}

    def _key(self, text: str) -> str:
        return normalise(text) if self._config.normalise_text else text


class TextRecogniser(TextWifiRecogniser):
    """Similar texts alone."""

    name = "text"

    def __init__(self, config: PlaceRecognitionConfig):
        super().__init__(config)
        self._radio = RadioRule(-math.inf, -math.inf, config.rssi_tolerance_db)

    def score(self, target: Keyframe, source: Keyframe) -> float:
        """Similarity of the most similar pair of texts."""
        return similarities(target, source, self._config).text

    def _passing(self, rows: list[list[float]], heard: Fingerprint) -> list[tuple[int, float, float, float]]:
        return [(int(row[0]), row[1], math.nan, math.nan) for row in rows]


def meet_at_sign(target: SignObservation, source: SignObservation) -> Array:
    """(3,) pose of the source in the target's frame if both see one sign: the two sign frames coincide."""
    (x, y), heading = source.position_m.tolist(), source.facing_rad
    c, s = math.cos(heading), math.sin(heading)
    x, y, turn = -c * x - s * y, s * x - c * y, wrap_one(-heading)  # the source in the frame of the sign
    (ahead, left), heading = target.position_m.tolist(), target.facing_rad
    c, s = math.cos(heading), math.sin(heading)
    return np.array([ahead + c * x - s * y, left + s * x + c * y, wrap_one(heading + turn)])
