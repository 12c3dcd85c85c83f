"""Propose loop candidates: pairs of keyframes that look like one place.

Recognisers are interchangeable by name: `text`, `wifi`, `twc` (TWC-SLAM's Algorithm 1), `lidar` (Scan Context, the
baseline of DCL-SLAM's kind) and `fused` (all cues weighed as log-odds). `make_recogniser` builds one.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twc_env.config import PlaceRecognitionConfig
from twc_env.geometry import compose, inverse
from twc_env.messages import Fingerprint, Keyframe, LoopCandidate, SignObservation
from twc_env.slam.place_evidence import PlaceMemory
from twc_env.slam.radio_fingerprint import FingerprintTable, mac_similarity, rssi_distance_db, rssi_similarity
from twc_env.slam.rssi_similarity import COSINES, by_cosine, by_distance
from twc_env.slam.scan_descriptor import compare, compare_many, describe, ring_key
from twc_env.slam.text_similarity import AlikeTexts, normalise, text_similarity

Array = NDArray

SAME_PLACE_M = 0.5
"""The same text read again within this path length ..."""
SAME_SIGN_M = 1.0
"""... at a place nearer than this is not remembered twice."""
STEP_M = 1.0
"""Recognisers that need no sign compare and remember a place this often along a path."""
RING_KEY_NEIGHBOURS = 10
"""Places whose rings are most alike are compared under every turn."""
CANDIDATES_MAX = 5
"""Most candidates of one keyframe where no sign limits them."""


class Recogniser(Protocol):
    """What all recognisers offer."""

    name: str

    def propose(self, keyframe: Keyframe, skipped_robots: Sequence[int] = ()) -> list[LoopCandidate]:
        """Candidates between this keyframe (source) and all earlier ones (targets) of robots that are not skipped.

        The keyframe is remembered for those that follow.
        """

    def score(self, target: Keyframe, source: Keyframe) -> float:
        """How much two keyframes look like one place; the larger the more."""


@dataclass(frozen=True, slots=True)
class Similarities:
    """The three cues of Algorithm 1 between two keyframes."""

    text: float
    """Of the two texts most alike (Eq. 5); 0 where either side read none."""
    macs: float
    """Eq. 9."""
    rssi: float
    """SPEC T8; in the printed mode the distance itself (Eq. 10)."""

    def passes(self, alpha: float, beta: float, gamma: float) -> bool:
        """Algorithm 1: all three reach their thresholds."""
        return self.text >= alpha - 1e-9 and self.macs >= beta - 1e-9 and self.rssi >= gamma - 1e-9


def similarities(target: Keyframe, source: Keyframe, rule: PlaceRecognitionConfig) -> Similarities:
    """All three cues between two keyframes, whatever the thresholds."""
    clean = normalise if rule.normalise_text else str
    text = max((text_similarity(clean(a.text), clean(b.text)) for a in target.signs for b in source.signs), default=0.0)
    macs = mac_similarity(target.fingerprint, source.fingerprint)
    prints = target.fingerprint, source.fingerprint
    return Similarities(text, macs, _rssi_cue(*rssi_distance_db(*prints), rule, prints)[0])


def _rssi_cue(
    distance_db: float, shared: int, rule: PlaceRecognitionConfig, prints: tuple[Fingerprint, Fingerprint]
) -> tuple[float, bool]:
    """The likeness of two fingerprints' strengths, and whether it reaches gamma."""
    if rule.rssi_mode == "paper":
        return distance_db, shared > 0 and distance_db >= rule.rssi_similarity_min
    if rule.rssi_mode == "saturating":  # the common case, without arrays
        rssi = rssi_similarity(distance_db, shared, rule.rssi_tolerance_db)
    elif rule.rssi_mode in COSINES:
        rssi = by_cosine(rule.rssi_mode, *prints)
    else:
        rssi = float(by_distance(rule.rssi_mode, np.array(distance_db), np.array(shared), rule.rssi_tolerance_db))
    return rssi, rssi >= rule.rssi_similarity_min - 1e-9


def make_recogniser(config: PlaceRecognitionConfig, range_max_m: float) -> Recogniser:
    """The recogniser that the configuration names; `range_max_m` is the scanner's."""
    by_signs: dict[str, type[TextWifiRecogniser]] = {"twc": TextWifiRecogniser, "text": TextRecogniser}
    if config.recogniser in by_signs:
        return by_signs[config.recogniser](config)
    if config.recogniser == "wifi":
        return WifiRecogniser(config, range_max_m)
    if config.recogniser == "lidar":
        return ScanRecogniser(config, range_max_m)
    return FusedRecogniser(config, range_max_m)


class TextWifiRecogniser:
    """Algorithm 1 of TWC-SLAM: like text, then shared transmitters, then like strengths (SPEC T9).

    Every text that was ever read is kept with its keyframe; a new keyframe is compared with all of them, of its own
    robot (when enough path lies between) and of the others.
    """

    name = "twc"

    def __init__(self, config: PlaceRecognitionConfig):
        self._config = config
        self._texts = AlikeTexts(config.text_similarity_min - 1e-9)
        self._numbers_of: list[list[int]] = []
        """Of each text the places where it was read, by number."""
        self._recent: dict[tuple[int, str], deque[tuple[float, Array]]] = {}
        self._places: list[tuple[Keyframe, SignObservation]] = []
        self._fingerprints = FingerprintTable()
        """One row per place."""

    def propose(self, keyframe: Keyframe, skipped_robots: Sequence[int] = ()) -> list[LoopCandidate]:
        """See `Recogniser`; the better of two texts speaks for a pair."""
        best: dict[tuple[int, int], LoopCandidate] = {}
        readings = [(self._key(sign.text), sign) for sign in keyframe.signs]
        for text, sign in readings:
            if math.isnan(sign.facing_rad):
                continue
            similarity = self._like_text(text, keyframe, skipped_robots)
            for k, macs, rssi in self._like_radio(sorted(similarity), keyframe.fingerprint):
                target, target_sign = self._places[k]
                held = best.get((target.robot, target.index))
                if held is None or similarity[k] > held.text_similarity:
                    candidate = LoopCandidate(
                        target=(target.robot, target.index),
                        source=(keyframe.robot, keyframe.index),
                        guess=_meet_at_sign(target_sign, sign),
                        recogniser=self.name,
                        sign_m=target_sign.position_m,
                        text_similarity=similarity[k],
                        mac_similarity=macs,
                        rssi_similarity=rssi,
                    )
                    best[candidate.target] = candidate
        for text, sign in readings:
            self._remember(text, keyframe, sign)
        return list(best.values())

    def score(self, target: Keyframe, source: Keyframe) -> float:
        """The smallest of the three similarities: at this threshold for all of them the pair would just pass."""
        cues = similarities(target, source, self._config)
        return min(cues.text, cues.macs, cues.rssi)

    def _like_text(self, text: str, keyframe: Keyframe, skipped_robots: Sequence[int]) -> dict[int, float]:
        """Numbers of the places whose text is alike and that the keyframe may be compared with -> similarity."""
        found = {}
        latest_m = keyframe.travel_m - self._config.revisit_travel_m
        for other, similarity in self._texts.alike(text):
            for k in self._numbers_of[other]:
                target = self._places[k][0]
                is_own = target.robot == keyframe.robot
                if target.robot not in skipped_robots and not (is_own and target.travel_m > latest_m):
                    found[k] = similarity
        return found

    def _like_radio(self, numbers: list[int], fingerprint: Fingerprint) -> list[tuple[int, float, float]]:
        """Those of the places whose fingerprint passes, with the similarities of transmitters and of strengths."""
        rule = self._config
        if not numbers:
            return []
        macs, distance_db, shared = self._fingerprints.compare(numbers, fingerprint)
        passed = []
        for row in np.flatnonzero(macs >= rule.mac_similarity_min - 1e-9).tolist():
            k, distance, count = numbers[row], float(distance_db[row]), int(shared[row])
            rssi, is_alike = _rssi_cue(distance, count, rule, (self._places[k][0].fingerprint, fingerprint))
            if is_alike:
                passed.append((k, float(macs[row]), rssi))
        return passed

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
        number = self._texts.number_of(text)
        if number == len(self._numbers_of):
            self._numbers_of.append([])
        self._numbers_of[number].append(len(self._places))
        self._places.append((keyframe, sign))
        self._fingerprints.append(keyframe.fingerprint)

    def _key(self, text: str) -> str:
        return normalise(text) if self._config.normalise_text else text


class TextRecogniser(TextWifiRecogniser):
    """Like text alone."""

    name = "text"

    def score(self, target: Keyframe, source: Keyframe) -> float:
        """Similarity of the two texts most alike."""
        return similarities(target, source, self._config).text

    def _like_radio(self, numbers: list[int], fingerprint: Fingerprint) -> list[tuple[int, float, float]]:
        return [(k, math.nan, math.nan) for k in numbers]


class _PlacesOnTheWay:
    """Keyframes about STEP_M apart along each robot's path, with the descriptors of their scans."""

    def __init__(self, range_max_m: float):
        self._range_max_m = range_max_m
        self.keyframes: list[Keyframe] = []
        self._descriptors: list[Array] = []
        self._keys: list[Array] = []
        self._last_m: dict[int, float] = {}

    def is_due(self, keyframe: Keyframe) -> bool:
        """Whether the robot has gone far enough since its last remembered place."""
        return keyframe.travel_m - self._last_m.get(keyframe.robot, -math.inf) >= STEP_M

    def add(self, keyframe: Keyframe, descriptor: Array) -> None:
        """Remember a place."""
        self._last_m[keyframe.robot] = keyframe.travel_m
        self.keyframes.append(keyframe)
        self._descriptors.append(descriptor)
        self._keys.append(ring_key(descriptor))

    def others(self, keyframe: Keyframe, skipped_robots: Sequence[int], revisit_travel_m: float) -> Array:
        """Numbers of the places a keyframe may be compared with."""
        return np.array(
            [
                k
                for k, place in enumerate(self.keyframes)
                if place.robot not in skipped_robots
                and (place.robot != keyframe.robot or keyframe.travel_m - place.travel_m >= revisit_travel_m)
            ],
            int,
        )

    def most_alike(self, numbers: Array, descriptor: Array) -> tuple[Array, Array, Array]:
        """Of these places those with like rings: their numbers, similarities and turns, the best first."""
        keys = np.array([self._keys[k] for k in numbers])
        near = numbers[np.argsort(((keys - ring_key(descriptor)) ** 2).sum(axis=1), kind="stable")]
        near = near[:RING_KEY_NEIGHBOURS]
        similarity, turn = compare_many(np.array([self._descriptors[k] for k in near]), descriptor)
        order = np.argsort(-similarity, kind="stable")
        return near[order], similarity[order], turn[order]

    def turn_to(self, number: int, descriptor: Array) -> float:
        """Heading of a scan in the frame of a remembered one [rad]."""
        return compare(self._descriptors[number], descriptor)[1]

    def describe(self, keyframe: Keyframe) -> Array:
        """The descriptor of a keyframe's scan."""
        return describe(keyframe.ranges_m, self._range_max_m)


class WifiRecogniser:
    """Shared transmitters and like strengths alone; the scans only tell how the two keyframes are turned."""

    name = "wifi"

    def __init__(self, config: PlaceRecognitionConfig, range_max_m: float):
        self._config = config
        self._places = _PlacesOnTheWay(range_max_m)

    def propose(self, keyframe: Keyframe, skipped_robots: Sequence[int] = ()) -> list[LoopCandidate]:
        """See `Recogniser`; the few most alike."""
        if not self._places.is_due(keyframe):
            return []
        rule, found = self._config, []
        for k in self._places.others(keyframe, skipped_robots, rule.revisit_travel_m):
            target = self._places.keyframes[k]
            macs = mac_similarity(target.fingerprint, keyframe.fingerprint)
            if macs < rule.mac_similarity_min - 1e-9:
                continue
            prints = target.fingerprint, keyframe.fingerprint
            rssi, is_alike = _rssi_cue(*rssi_distance_db(*prints), rule, prints)
            if is_alike:
                found.append((min(macs, rssi), int(k), macs, rssi))
        found.sort(key=lambda entry: (-entry[0], entry[1]))
        descriptor = self._places.describe(keyframe)
        candidates = []
        for _, k, macs, rssi in found[:CANDIDATES_MAX]:
            guess = np.array([0.0, 0.0, self._places.turn_to(k, descriptor)])
            candidates.append(
                _candidate(self._places.keyframes[k], keyframe, guess, self.name, mac=macs, rssi=rssi),
            )
        self._places.add(keyframe, descriptor)
        return candidates

    def score(self, target: Keyframe, source: Keyframe) -> float:
        """The smaller of the two similarities."""
        cues = similarities(target, source, self._config)
        return min(cues.macs, cues.rssi)


class ScanRecogniser:
    """Scan Context: like scans under some turn."""

    name = "lidar"

    def __init__(self, config: PlaceRecognitionConfig, range_max_m: float):
        self._config, self._range_max_m = config, range_max_m
        self._places = _PlacesOnTheWay(range_max_m)

    def propose(self, keyframe: Keyframe, skipped_robots: Sequence[int] = ()) -> list[LoopCandidate]:
        """See `Recogniser`; the few most alike."""
        if not self._places.is_due(keyframe):
            return []
        descriptor = self._places.describe(keyframe)
        numbers = self._places.others(keyframe, skipped_robots, self._config.revisit_travel_m)
        candidates: list[LoopCandidate] = []
        if len(numbers):
            for k, similarity, turn in zip(*self._places.most_alike(numbers, descriptor), strict=True):
                if similarity >= self._config.scan_similarity_min and len(candidates) < CANDIDATES_MAX:
                    guess = np.array([0.0, 0.0, turn])
                    candidates.append(_candidate(self._places.keyframes[k], keyframe, guess, self.name))
        self._places.add(keyframe, descriptor)
        return candidates

    def score(self, target: Keyframe, source: Keyframe) -> float:
        """Similarity of the two scans at the best turn."""
        scans = (describe(keyframe.ranges_m, self._range_max_m) for keyframe in (target, source))
        return compare(*scans)[0]


class FusedRecogniser:
    """Text, radio, walls, neighbouring signs and the ways there, weighed together instead of against thresholds."""

    name = "fused"

    def __init__(self, config: PlaceRecognitionConfig, range_max_m: float):
        self._config = config
        self.memory = PlaceMemory(range_max_m)
        """What the evidence rests on."""

    def propose(self, keyframe: Keyframe, skipped_robots: Sequence[int] = ()) -> list[LoopCandidate]:
        """See `Recogniser`; of each sign on another map the view whose radio signature fits best."""
        best: dict[tuple[int, int], LoopCandidate] = {}
        places = self.memory.observe(keyframe)
        for sign, place in zip(keyframe.signs, places, strict=True):
            for robot in sorted(set(self.memory.signs) - set(skipped_robots)):
                for known in self.memory.like_text(place, robot):
                    views = [view for view in known.views if self._is_apart(view[0], keyframe)]
                    if not views:
                        continue
                    target, target_sign = self.memory.best_view(views, keyframe)
                    candidate = self._weigh(target, target_sign, keyframe, sign)
                    held = best.get(candidate.target) if candidate is not None else None
                    if candidate is not None and (held is None or candidate.log_odds > held.log_odds):
                        best[candidate.target] = candidate
        return list(best.values())

    def score(self, target: Keyframe, source: Keyframe) -> float:
        """Log-odds of the pair of signs that speaks most for one place; both keyframes must have been proposed."""
        pairs = [(a, b) for a in target.signs for b in source.signs]
        return max((self.memory.weigh(target, a, source, b).total for a, b in pairs), default=-math.inf)

    def _is_apart(self, earlier: Keyframe, keyframe: Keyframe) -> bool:
        is_own = earlier.robot == keyframe.robot
        return not is_own or keyframe.travel_m - earlier.travel_m >= self._config.revisit_travel_m

    def _weigh(
        self, target: Keyframe, target_sign: SignObservation, source: Keyframe, source_sign: SignObservation
    ) -> LoopCandidate | None:
        evidence = self.memory.weigh(target, target_sign, source, source_sign)
        if evidence.total < self._config.log_odds_min:
            return None
        guess = self.memory.guess(target, target_sign, source, source_sign)
        if guess is None:
            return None
        candidate = _candidate(target, source, guess, self.name)
        return dataclasses.replace(candidate, sign_m=target_sign.position_m, log_odds=evidence.total)


def _candidate(
    target: Keyframe, source: Keyframe, guess: Array, name: str, mac: float = math.nan, rssi: float = math.nan
) -> LoopCandidate:
    ends = (target.robot, target.index), (source.robot, source.index)
    return LoopCandidate(*ends, guess, name, mac_similarity=mac, rssi_similarity=rssi)


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
        for x, y in tried:
            if abs(a - x) < reach_m and abs(b - y) < reach_m:
                return False
        tried.append((a, b))
        return True
