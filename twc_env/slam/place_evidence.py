"""How strongly two sightings of signs speak for one place: text, radio, walls and neighbouring signs as log-odds.

Nothing here is a threshold. Each cue gives the logarithm of how much likelier its measurement is at one place than at
two; what is needed for that is learned while the robots drive: which texts a building repeats and where, and how far
radio signatures differ at one place and between places. Only estimates are used, never a true pose.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray
from rapidfuzz.distance import Levenshtein
from rapidfuzz.process import cdist

from twc_env.geometry import compose, inverse, wrap_angle
from twc_env.messages import Fingerprint, Keyframe, SignObservation
from twc_env.slam.scan_descriptor import scan_agreement
from twc_env.slam.text_similarity import normalise

Array = NDArray

FRAGMENT_PROBABILITY, CHARACTER_ERROR_PROBABILITY = 0.07, 0.03
"""How often OCR gives a fragment, and how often it gets a character wrong (SPEC T3)."""
INDEPENDENT_READINGS_MAX = 2
"""More readings that agree prove no more: the mistakes of one reader with one sign stay the same."""
WRONG_CHARACTERS = 6.0
"""A wrong character is one of about this many (most are look-alikes)."""
LANGUAGE_CHARACTERS = 12.0
"""An unknown text is as hard to guess as if each character were one of this many."""
SAME_PASS_M, SAME_PASS_TRAVEL_M = 0.5, 4.0
"""Readings this near to each other, within this path, are of one sign, whatever they say."""
SAME_SIGN_M, SAME_SIGN_SIMILARITY = 2.0, 0.6
"""Later, the path may have drifted by this much, but then the texts must be alike."""
OPPOSITE_RAD, MISPLACED_M, SAME_TEXT_SIMILARITY = 2.2, 1.0, 0.8
"""Readings on walls that face away from each other are of two signs, unless they are so near and so alike that one
facing must be wrong."""
FACING_RAD = 0.8
"""Readings that face further apart than this are of one sign only if their texts are alike: walls blur at corners."""
READINGS_MAX, VIEWS_MAX = 15, 6
"""Texts and keyframes kept per sign."""
HIDDEN_TWIN_SHARE = 0.1
"""How many more signs of the same text to expect where nobody has been, for each one that is known."""
NEIGHBOUR_REACH_M = 8.0
MEETING_M, MEETING_PER_M = 0.5, 0.06
"""Under a hypothesis, neighbouring signs nearer than this to each other are taken for one."""
SAME_RADIO_M, ELSEWHERE_M = 3.0, (5.0, 20.0)
"""Own keyframes this near teach how far fingerprints differ at one place; those this far, how far elsewhere."""
RADIO_APART_S = 2.5
"""Keyframes nearer in time share scans and teach nothing."""
DIFFERENCE_MIN_DB = 0.5
FLOOR_DBM = -90.0
"""Stands in for a transmitter that only one side hears."""


@dataclass(frozen=True, slots=True)
class EvidenceWeights:
    """How much each cue counts, and up to which log-odds it may speak. Fitted on twin-01 and drawn buildings."""

    radio: float = 1.0
    radio_limit: float = 5.0
    geometry: float = 8.0
    geometry_limit: float = 2.0
    neighbours: float = 0.5
    neighbours_limit: float = 4.0


@dataclass(frozen=True, slots=True)
class Evidence:
    """What speaks for one place, each as log-odds; `total` is what the recogniser decides by."""

    text: float
    """The texts, against all other signs that either robot knows and against one nobody has seen."""
    radio: float
    geometry: float
    neighbours: float
    total: float


GEOMETRY_EVEN = 0.6
"""With this share of points on the other's walls, and none seen through, the walls speak neither way."""
TEXT_FLOOR = -15.0
"""Texts that speak more strongly against one place end the comparison."""
NO_EVIDENCE = Evidence(-math.inf, 0.0, 0.0, 0.0, -math.inf)


# --- text ---


def log_text_likelihood(reading: str, others: Sequence[str], reading_count: int, other_counts: Array) -> Array:
    """(others,) log probability of a reading if the sign is the one that gave each of the others.

    A noisy channel twice: characters go wrong singly, or only a fragment is left (SPEC T3). Counts say how many
    readings agreed on a text: the more, the less likely it is wrong.
    """
    if not others:
        return np.zeros(0)
    count = np.minimum(np.minimum(np.asarray(other_counts, float), reading_count), INDEPENDENT_READINGS_MAX)
    wrong = 2 * CHARACTER_ERROR_PROBABILITY / count
    fragment = 2 * FRAGMENT_PROBABILITY / count**2
    length = np.array([len(other) for other in others], float)
    longest = np.maximum(length, len(reading))
    edits = cdist([reading], list(others), scorer=Levenshtein.distance)[0].astype(float)
    whole = np.log1p(-fragment) + (longest - edits) * np.log1p(-wrong) + edits * np.log(wrong / WRONG_CHARACTERS)
    shortest = np.minimum(length, len(reading))
    is_part = np.array([reading in other or other in reading for other in others]) & (shortest <= 0.5 * longest)
    cuts = (longest - shortest + 1) * np.maximum(0.35 * longest, 1)
    part = np.where(is_part, np.log(fragment / cuts), -np.inf)
    noise = np.log(fragment) + log_unknown_text(reading) - 2.0
    return np.logaddexp(np.logaddexp(whole, part), noise)


def log_unknown_text(reading: str) -> float:
    """Log probability of a reading if nothing is known of the sign."""
    return -len(reading) * math.log(LANGUAGE_CHARACTERS)


# --- radio ---


def radio_difference_db(a: Fingerprint, b: Fingerprint) -> float:
    """RMS difference over all transmitters that either heard, without the devices' common offset; NaN with none.

    A transmitter that only one side hears stands at the detection floor on the other.
    """
    return _radio_difference(a.macs, a.rssi_dbm, b.macs, b.rssi_dbm, FLOOR_DBM)


@njit(cache=True, error_model="numpy")
def _radio_difference(macs_a, levels_a, macs_b, levels_b, floor):
    total = squares = 0.0
    i = j = count = 0
    while i < len(macs_a) or j < len(macs_b):
        if j >= len(macs_b) or (i < len(macs_a) and macs_a[i] < macs_b[j]):
            difference = max(levels_a[i] - floor, 0.0)
            i += 1
        elif i >= len(macs_a) or macs_b[j] < macs_a[i]:
            difference = -max(levels_b[j] - floor, 0.0)
            j += 1
        else:
            difference = levels_a[i] - levels_b[j]
            i += 1
            j += 1
        total += difference
        squares += difference * difference
        count += 1
    if len(macs_a) == 0 or len(macs_b) == 0:
        return np.nan
    return math.sqrt(max(squares / count - (total / count) ** 2, 0.0))


class RadioStatistics:
    """How far fingerprints of this building differ at one place and between places, learned from own trajectories.

    The logarithm of the difference is taken as normal in both cases with one spread, so that the log-likelihood ratio
    falls steadily with the difference. Starts from a weak guess.
    """

    def __init__(self):
        self._count = np.array([10.0, 10.0])
        self._sum = self._count * np.log([4.0, 10.0])
        self._squares = 0.35**2 * self._count + self._sum**2 / self._count
        self._line: tuple[float, float] | None = None

    def learn(self, difference_db: float, is_same_place: bool) -> None:
        """Take in one pair of keyframes of one robot."""
        if math.isnan(difference_db):
            return
        value = math.log(max(difference_db, DIFFERENCE_MIN_DB))
        k = 0 if is_same_place else 1
        self._count[k] += 1
        self._sum[k] += value
        self._squares[k] += value * value
        self._line = None

    def log_ratio(self, difference_db: float) -> float:
        """Log of how much likelier this difference is at one place than between places; 0 where unknown."""
        if math.isnan(difference_db):
            return 0.0
        if self._line is None:
            same, apart = (self._sum / self._count).tolist()
            variance = float((self._squares - self._sum**2 / self._count).sum() / self._count.sum())
            self._line = max(apart - same, 0.05) / max(variance, 0.1**2), 0.5 * (same + apart)
        slope, middle = self._line
        return slope * (middle - math.log(max(difference_db, DIFFERENCE_MIN_DB)))


# --- memory ---


@dataclass(slots=True, eq=False)
class SignPlace:
    """A sign on one robot's own map."""

    robot: int
    position_odom: Array
    """(2,) mean of the latest pass."""
    travel_m: float
    facing_odom: float = math.nan
    """The facing that is nearest to all readings of it; NaN where none is known."""
    texts: list[str] = field(default_factory=list)
    views: list[tuple[Keyframe, SignObservation]] = field(default_factory=list)
    """Keyframes that read it, spread over its passes, and what they saw."""
    consensus: str = ""
    support: int = 1
    """How many readings agree on the consensus."""
    _facings: list[float] = field(default_factory=list)

    def add(self, text: str, keyframe: Keyframe, sign: SignObservation, position: Array, facing: float) -> None:
        """Take in one more reading, at a position and facing in the odom frame."""
        is_settled = text == self.consensus and self.support == len(self.texts) < READINGS_MAX
        self.texts = [*self.texts[1 - READINGS_MAX :], text]
        if not self.views or self.views[-1][0].index != keyframe.index:
            if len(self.views) == VIEWS_MAX:
                self.views.pop(1)
            self.views.append((keyframe, sign))
        self.position_odom, self.travel_m = position, keyframe.travel_m
        if not math.isnan(facing):
            self._facings = [*self._facings[1 - READINGS_MAX :], facing]
            gaps = np.abs(wrap_angle(np.subtract.outer(self._facings, self._facings)))
            self.facing_odom = self._facings[int(np.argmin(gaps.sum(axis=1)))]
        if is_settled:
            self.support += 1
        else:
            self._vote()

    def reads_like(self, text: str, is_near: bool, similarity_min: float = SAME_SIGN_SIMILARITY) -> bool:
        """Whether a reading is like any that was kept; nearby, a fragment of the consensus is enough."""
        if is_near and (text in self.consensus or self.consensus in text):
            return True
        return bool(cdist([text], self.texts, scorer=Levenshtein.normalized_similarity).max() >= similarity_min)

    def _vote(self) -> None:
        """The reading that explains all readings best, as fragments of it or by few wrong characters."""
        cost = np.minimum(3.0 * cdist(self.texts, self.texts, scorer=Levenshtein.distance), 12.0)
        is_part = np.array([[part in whole for part in self.texts] for whole in self.texts])
        total = np.where(is_part, np.minimum(cost, 5.0), cost).sum(axis=1)
        best = np.flatnonzero(total == total.min())
        self.consensus = max((self.texts[k] for k in best), key=lambda text: (len(text), text))
        self.support = max(1, sum(text == self.consensus for text in self.texts))


class PlaceMemory:
    """Everything the evidence rests on: the signs of each robot's map and the radio statistics of the building."""

    def __init__(self, range_max_m: float, weights: EvidenceWeights | None = None):
        self.weights = weights or EvidenceWeights()
        self.radio = RadioStatistics()
        self.signs: dict[int, list[SignPlace]] = {}
        self._range_max_m = range_max_m
        self._path: dict[int, list[Keyframe]] = {}
        self._place_of: dict[tuple[int, int], list[tuple[Array, SignPlace]]] = {}

    def observe(self, keyframe: Keyframe) -> list[SignPlace]:
        """Remember a keyframe; gives the place of each of its readings."""
        self._learn_radio(keyframe)
        return [self._take_in(keyframe, sign) for sign in keyframe.signs]

    def place_of(self, keyframe: Keyframe, sign: SignObservation) -> SignPlace | None:
        """The remembered sign that this reading belongs to."""
        known = self._place_of.get((keyframe.robot, keyframe.index), ())
        return min(known, key=lambda entry: math.dist(entry[0], sign.position_m), default=(None, None))[1]

    def _take_in(self, keyframe: Keyframe, sign: SignObservation) -> SignPlace:
        text = normalise(sign.text).replace(" ", "")  # the space between two words is what OCR loses most
        position = compose(keyframe.pose_odom, [*sign.position_m, 0.0])[:2]
        facing = math.remainder(sign.facing_rad + float(keyframe.pose_odom[2]), 2 * math.pi)
        place = self._find(text, keyframe, position, facing)
        if place is None:
            place = SignPlace(keyframe.robot, position, keyframe.travel_m)
            self.signs.setdefault(keyframe.robot, []).append(place)
        place.add(text, keyframe, sign, position, facing)
        self._place_of.setdefault((keyframe.robot, keyframe.index), []).append((sign.position_m, place))
        return place

    def _find(self, text: str, keyframe: Keyframe, position: Array, facing: float) -> SignPlace | None:
        best, best_m = None, SAME_SIGN_M
        for place in self.signs.get(keyframe.robot, ()):
            away = math.dist(place.position_odom, position)
            if away >= best_m:
                continue
            turn = abs(math.remainder(facing - place.facing_odom, 2 * math.pi))
            is_pass = away < SAME_PASS_M and keyframe.travel_m - place.travel_m < SAME_PASS_TRAVEL_M
            if turn > OPPOSITE_RAD and (away > MISPLACED_M or not place.reads_like(text, False, SAME_TEXT_SIMILARITY)):
                continue
            if place.reads_like(text, away < SAME_PASS_M) or (is_pass and not turn > FACING_RAD):
                best, best_m = place, away
        return best

    def _learn_radio(self, keyframe: Keyframe) -> None:
        """Compare with some keyframes all along the own path and with some of the last."""
        path = self._path.setdefault(keyframe.robot, [])
        stride = max(1, len(path) // 6)
        for other in [*path[keyframe.index % stride : -8 : stride], *path[-8::2]]:
            if keyframe.time_s - other.time_s < RADIO_APART_S:
                break
            away = math.dist(keyframe.pose_odom[:2], other.pose_odom[:2])
            if away <= SAME_RADIO_M or ELSEWHERE_M[0] <= away <= ELSEWHERE_M[1]:
                difference = radio_difference_db(keyframe.fingerprint, other.fingerprint)
                self.radio.learn(difference, away <= SAME_RADIO_M)
        path.append(keyframe)

    # --- weighing ---

    def weigh(
        self, target: Keyframe, target_sign: SignObservation, source: Keyframe, source_sign: SignObservation
    ) -> Evidence:
        """The evidence that these two readings, both remembered, are of one sign."""
        a, b = self.place_of(target, target_sign), self.place_of(source, source_sign)
        if a is None or b is None:
            return NO_EVIDENCE
        radio = self._radio(target, source)
        text = min(self._text(a, b, source), self._text(b, a, target))
        if text < TEXT_FLOOR:
            return Evidence(text, radio, 0.0, 0.0, text + radio)
        geometry = neighbours = 0.0
        guess = self.guess(target, target_sign, source, source_sign)
        if guess is not None:
            geometry = self._geometry(target, source, guess)
            if a.robot != b.robot:  # one's own map agrees with itself anywhere
                neighbours = self._neighbours(a, b, target, source, guess)
        return Evidence(text, radio, geometry, neighbours, text + radio + geometry + neighbours)

    def guess(
        self, target: Keyframe, target_sign: SignObservation, source: Keyframe, source_sign: SignObservation
    ) -> Array | None:
        """(3,) pose of the source in the target's frame if both readings are of one sign.

        The walls' facings are those that most readings of the sign agree on; None where no wall is known behind it.
        """
        frames = []
        for view, sign in ((target, target_sign), (source, source_sign)):
            place = self.place_of(view, sign)
            if place is None or math.isnan(place.facing_odom):
                return None
            frames.append(np.array([*sign.position_m, place.facing_odom - view.pose_odom[2]]))
        return compose(frames[0], inverse(frames[1]))

    def like_text(self, place: SignPlace, robot: int) -> list[SignPlace]:
        """Signs on a robot's map whose text `place` may have: likelier than anything unknown."""
        places = self.signs.get(robot, [])
        likelihood = _likelihood(place, places)
        floor = log_unknown_text(place.consensus)
        return [p for p, likely in zip(places, likelihood, strict=True) if likely > floor]

    def best_view(
        self, views: Sequence[tuple[Keyframe, SignObservation]], keyframe: Keyframe
    ) -> tuple[Keyframe, SignObservation]:
        """The view whose radio signature fits a keyframe's best."""
        return max(views, key=lambda view: self._radio(view[0], keyframe))

    def _radio(self, target: Keyframe, source: Keyframe) -> float:
        w = self.weights
        ratio = w.radio * self.radio.log_ratio(radio_difference_db(target.fingerprint, source.fingerprint))
        return min(max(ratio, -w.radio_limit), w.radio_limit)

    def _text(self, known: SignPlace, other: SignPlace, view: Keyframe) -> float:
        """Log-odds that `other` is `known`, rather than another sign on the map of its robot or one nobody has seen.

        The others count by what they say and by how their radio signature fits that of the view in which `other` was
        read, so a repeated text that is elsewhere by its signature does no harm.
        """
        places = self.signs[known.robot]
        likelihood = _likelihood(other, places)
        own = likelihood[places.index(known)]
        unknown = np.logaddexp(log_unknown_text(other.consensus), own + math.log(HIDDEN_TWIN_SHARE))
        best_known = likelihood.max() - self.weights.radio_limit
        if own - best_known < TEXT_FLOOR:
            return float(own - best_known)
        rivals = [unknown]
        for place, likely in zip(places, likelihood, strict=True):
            if place is known or place is other or likely + self.weights.radio_limit < unknown - 3.0:
                continue
            rivals.append(likely + max(self._radio(keyframe, view) for keyframe, _ in place.views))
        return float(own - np.logaddexp.reduce(rivals))

    def _geometry(self, target: Keyframe, source: Keyframe, guess: Array) -> float:
        w = self.weights
        met, through = scan_agreement(target.ranges_m, source.ranges_m, guess, self._range_max_m)
        odds = w.geometry * (met - 2.0 * through - GEOMETRY_EVEN)
        return min(max(odds, -w.geometry_limit), w.geometry_limit)

    def _neighbours(self, a: SignPlace, b: SignPlace, target: Keyframe, source: Keyframe, guess: Array) -> float:
        """Other signs nearby: where two of them would meet under the guess, their texts should agree."""
        w = self.weights
        near_a, near_b = self._near(a, target), self._near(b, source)
        total = 0.0
        for place, position in near_b if near_a else ():
            here = compose(guess, [*position, 0.0])[:2]
            facing = place.facing_odom - source.pose_odom[2] + guess[2] + target.pose_odom[2]
            reach = MEETING_M + MEETING_PER_M * math.hypot(*position)
            meets = [
                other
                for other, there in near_a
                if math.dist(here, there) < reach
                and not abs(math.remainder(facing - other.facing_odom, 2 * math.pi)) > FACING_RAD
            ]
            if not meets:
                continue
            like = _likelihood(place, meets).max()
            any_text = [*_likelihood(place, self.signs[a.robot]), log_unknown_text(place.consensus)]
            chance = np.logaddexp.reduce(any_text) - math.log(len(any_text))
            total += min(max(like - chance, -w.neighbours_limit), w.neighbours_limit)
        return float(min(max(w.neighbours * total, -w.neighbours_limit), w.neighbours_limit))

    def _near(self, centre: SignPlace, view: Keyframe) -> list[tuple[SignPlace, Array]]:
        """Signs near another on the same map, in the frame of one of its views."""
        robot_odom = inverse(view.pose_odom)
        return [
            (place, compose(robot_odom, [*place.position_odom, 0.0])[:2])
            for place in self.signs[centre.robot]
            if place is not centre and math.dist(place.position_odom, centre.position_odom) < NEIGHBOUR_REACH_M
        ]


def _likelihood(reading: SignPlace, others: Sequence[SignPlace]) -> Array:
    """(others,) log probability of what was read at one place if it is the sign of each of the others."""
    return log_text_likelihood(
        reading.consensus, [p.consensus for p in others], reading.support, np.array([p.support for p in others])
    )
