"""Log-odds that two sign readings show one place, from text, radio, walls, neighbouring signs and the paths to them.

Each cue contributes the log-likelihood ratio of its measurement at one place against two places. The statistics are
learned while the robots drive: which texts a building repeats and where, and how far radio fingerprints differ at one
place and between places. Only estimates are used, never a true pose.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.geometry import compose, inverse
from twc_env.records.messages import Keyframe, SignObservation
from twc_env.slam.places.radio_statistics import RadioStatistics, radio_difference_db
from twc_env.slam.places.scan_descriptor import scan_agreement
from twc_env.slam.places.sign_place import SignPlace, SignView
from twc_env.slam.places.text_likelihood import log_text_likelihood, log_unknown_text
from twc_env.slam.places.text_similarity import normalise

SAME_PASS_M, SAME_PASS_TRAVEL_M = 0.5, 4.0
"""Readings within this distance and path length are of one sign, whatever their texts."""
SAME_SIGN_M = 2.0
"""Assumed maximum drift between later readings of one sign, whose texts must then be similar."""
OPPOSITE_RAD, MISPLACED_M, SAME_TEXT_SIMILARITY = 2.2, 1.0, 0.8
"""Readings that face opposite directions are of different signs, unless they are so near and so similar to the
consensus of the other's readings that one facing must be wrong."""
FACING_RAD = 0.8
"""Readings whose facings differ by more are of one sign only if their texts are this similar: wall normals are
imprecise at corners, but a door and the floor plan behind it may both bear the room's name."""
HIDDEN_TWIN_SHARE = 0.1
"""Expected number of unknown signs with the same text for each known one."""
NEIGHBOUR_REACH_M = 8.0
MEETING_M, MEETING_PER_M = 0.5, 0.06
"""Under a hypothesis, neighbouring signs nearer than this count as the same sign."""
SEQUENCE_M, SEQUENCE_BESIDE_M = (2.0, 4.0, 6.0, 8.0), 2.0
"""Keyframes at these path distances before and after a view are compared with the nearest ones of the other
path."""
SEQUENCE_END_M = 10.0
"""Maximum path distance of a keyframe that replaces a missing one at such a distance."""
SAME_RADIO_M, ELSEWHERE_M = 3.0, (5.0, 20.0)
"""Own keyframes within the first distance give fingerprint differences at one place, those in the second range
elsewhere."""
RADIO_APART_S = 2.5
"""Keyframes closer in time share WiFi scans and are not used for the statistics."""
RADIO_LIMIT = 5.0
GEOMETRY_WEIGHT, GEOMETRY_LIMIT = 8.0, 2.0
NEIGHBOURS_WEIGHT, NEIGHBOURS_LIMIT = 0.5, 4.0
SEQUENCE_WEIGHT, SEQUENCE_LIMIT = 0.25, 2.0
"""Weight and log-odds limit of each cue, fitted on twin-01 and generated buildings."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """Log-odds that two readings show one place, by cue; the recogniser decides by `total`."""

    text: float
    """Against all other signs that either robot knows and one unknown sign."""
    radio: float
    geometry: float
    neighbours: float
    sequence: float
    """Fingerprints of the keyframes before and after, where the two paths are side by side."""
    total: float


GEOMETRY_EVEN = 0.6
"""With this share of points on the other scan's walls, and none seen through, geometry contributes 0."""
TEXT_FLOOR = -15.0
"""Text log-odds below this end the comparison."""
NO_EVIDENCE = Evidence(-math.inf, 0.0, 0.0, 0.0, 0.0, -math.inf)


class PlaceMemory:
    """The data behind the evidence: the signs on each robot's map and the radio statistics of the building."""

    def __init__(self, range_max_m: float):
        self.radio = RadioStatistics()
        self.signs: dict[int, list[SignPlace]] = {}
        self._range_max_m = range_max_m
        self._path: dict[int, list[Keyframe]] = {}
        self._place_of: dict[tuple[int, int], list[tuple[Array, SignPlace]]] = {}

    def observe(self, keyframe: Keyframe) -> list[SignPlace]:
        """Add a keyframe; returns the sign of each of its readings."""
        self._learn_radio(keyframe)
        return [self._add_reading(keyframe, sign) for sign in keyframe.signs]

    def sparsify(self, is_held: Callable[[Keyframe], bool]) -> None:
        """Remove keyframes that are no longer held, and signs without remaining views."""
        for places in self.signs.values():
            for place in places:
                place.views[:] = [view for view in place.views if is_held(view[0])]
        read, self._place_of = self._place_of, {}
        for path in self._path.values():
            path[:] = filter(is_held, path)
            for keyframe in filter(lambda keyframe: keyframe.signs, path):
                known = self._place_of[keyframe.key] = read[keyframe.key]
                for (_, place), sign in zip(known, keyframe.signs, strict=True):
                    place.views[:] = place.views or [(keyframe, sign)]
        for places in self.signs.values():
            places[:] = [place for place in places if place.views]

    def place_of(self, view: SignView) -> SignPlace | None:
        """The stored sign that this reading was assigned to."""
        keyframe, sign = view
        known = self._place_of.get(keyframe.key, ())
        return min(known, key=lambda entry: math.dist(entry[0], sign.position_m), default=(None, None))[1]

    def _add_reading(self, keyframe: Keyframe, sign: SignObservation) -> SignPlace:
        text = normalise(sign.text).replace(" ", "")  # OCR loses spaces most often
        position = compose(keyframe.pose_odom, [*sign.position_m, 0.0])[:2]
        facing = math.remainder(sign.facing_rad + float(keyframe.pose_odom[2]), 2 * math.pi)
        place = self._find(text, keyframe, position, facing)
        if place is None:
            place = SignPlace(keyframe.robot, position, keyframe.travel_m)
            self.signs.setdefault(keyframe.robot, []).append(place)
        place.add(text, keyframe, sign, position, facing)
        self._place_of.setdefault(keyframe.key, []).append((sign.position_m, place))
        return place

    def _find(self, text: str, keyframe: Keyframe, position: Array, facing: float) -> SignPlace | None:
        best, best_m = None, SAME_SIGN_M
        for place in self.signs.get(keyframe.robot, ()):
            away = math.dist(place.position_odom, position)
            if away >= best_m:
                continue
            turn = abs(math.remainder(facing - place.facing_odom, 2 * math.pi))
            if turn > OPPOSITE_RAD:
                is_same = away <= MISPLACED_M and place.agrees_on(text, SAME_TEXT_SIMILARITY)
            elif turn > FACING_RAD:
                is_same = place.reads_like(text, False, SAME_TEXT_SIMILARITY)
            else:
                is_pass = away < SAME_PASS_M and keyframe.travel_m - place.travel_m < SAME_PASS_TRAVEL_M
                is_same = is_pass or place.reads_like(text, away < SAME_PASS_M)
            if is_same:
                best, best_m = place, away
        return best

    def _learn_radio(self, keyframe: Keyframe) -> None:
        """Update the radio statistics from pairs with some keyframes of the own path, spread over all of it and recent
        ones."""
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

    def weigh(self, seen: SignView, again: SignView) -> Evidence:
        """The evidence that these two readings, both added before, are of one sign."""
        a, b, target, source = self.place_of(seen), self.place_of(again), seen[0], again[0]
        if a is None or b is None:
            return NO_EVIDENCE
        radio = self._radio(target, source)
        text = min(self._text(a, b, source), self._text(b, a, target))
        if text < TEXT_FLOOR:
            return Evidence(text, radio, 0.0, 0.0, 0.0, text + radio)
        geometry = neighbours = sequence = 0.0
        guess = self.guess(seen, again)
        if guess is not None:
            geometry = self._geometry(target, source, guess)
            if a.robot != b.robot:  # within one map both cues agree for any guess
                neighbours = self._neighbours(a, b, target, source, guess)
                sequence = self._sequence(target, source, guess)
        total = text + radio + geometry + neighbours + sequence
        return Evidence(text, radio, geometry, neighbours, sequence, total)

    def guess(self, seen: SignView, again: SignView) -> Array | None:
        """(3,) pose of the second keyframe in the first one's frame if both readings are of one sign.

        Uses the consensus facing of each sign; None if a sign has no known wall behind it.
        """
        frames = []
        for view, sign in (seen, again):
            place = self.place_of((view, sign))
            if place is None or math.isnan(place.facing_odom):
                return None
            frames.append(np.array([*sign.position_m, place.facing_odom - view.pose_odom[2]]))
        return compose(frames[0], inverse(frames[1]))

    def like_text(self, place: SignPlace, robot: int) -> list[SignPlace]:
        """Signs on a robot's map whose text is likelier for `place` than that of an unknown sign."""
        places = self.signs.get(robot, [])
        likelihood = _likelihood(place, places)
        floor = log_unknown_text(place.consensus)
        return [p for p, likely in zip(places, likelihood, strict=True) if likely > floor]

    def best_view(self, views: Sequence[SignView], keyframe: Keyframe) -> SignView:
        """The view whose fingerprint is most similar to a keyframe's."""
        return max(views, key=lambda view: self._radio(view[0], keyframe))

    def _radio(self, target: Keyframe, source: Keyframe) -> float:
        ratio = self.radio.log_ratio(radio_difference_db(target.fingerprint, source.fingerprint))
        return min(max(ratio, -RADIO_LIMIT), RADIO_LIMIT)

    def _text(self, known: SignPlace, other: SignPlace, view: Keyframe) -> float:
        """Log-odds that `other` is `known`, against the other signs on the map of that robot and one unknown sign.

        Each alternative is weighted by its text and by its fingerprint against the view in which `other` was read, so
        that a repeated text at a place with a different fingerprint does not count.
        """
        places = self.signs[known.robot]
        likelihood = _likelihood(other, places)
        own = likelihood[places.index(known)]
        unknown = np.logaddexp(log_unknown_text(other.consensus), own + math.log(HIDDEN_TWIN_SHARE))
        best_known = likelihood.max() - RADIO_LIMIT
        if own - best_known < TEXT_FLOOR:
            return float(own - best_known)
        rivals = [unknown]
        for place, likely in zip(places, likelihood, strict=True):
            if place is known or place is other or likely + RADIO_LIMIT < unknown - 3.0:
                continue
            rivals.append(likely + max(self._radio(keyframe, view) for keyframe, _ in place.views))
        return float(own - np.logaddexp.reduce(rivals))

    def _geometry(self, target: Keyframe, source: Keyframe, guess: Array) -> float:
        met, through = scan_agreement(target.ranges_m, source.ranges_m, guess, self._range_max_m)
        odds = GEOMETRY_WEIGHT * (met - 2.0 * through - GEOMETRY_EVEN)
        return min(max(odds, -GEOMETRY_LIMIT), GEOMETRY_LIMIT)

    def _neighbours(self, a: SignPlace, b: SignPlace, target: Keyframe, source: Keyframe, guess: Array) -> float:
        """Neighbouring signs: pairs that coincide under the guess should have the same text."""
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
            total += min(max(like - chance, -NEIGHBOURS_LIMIT), NEIGHBOURS_LIMIT)
        return float(min(max(NEIGHBOURS_WEIGHT * total, -NEIGHBOURS_LIMIT), NEIGHBOURS_LIMIT))

    def _sequence(self, target: Keyframe, source: Keyframe, guess: Array) -> float:
        """Fingerprints of keyframes before and after: where the paths are side by side under the guess, they should
        agree."""
        beside = self._around(target)
        total = 0.0
        for keyframe, position in self._around(source) if beside else ():
            here = compose(guess, [*position, 0.0])[:2]
            away, nearest = min((math.dist(here, there), k) for k, (_, there) in enumerate(beside))
            if away < SEQUENCE_BESIDE_M:
                total += self._radio(beside[nearest][0], keyframe)
        return float(min(max(SEQUENCE_WEIGHT * total, -SEQUENCE_LIMIT), SEQUENCE_LIMIT))

    def _around(self, view: Keyframe) -> list[tuple[Keyframe, Array]]:
        """Keyframes at SEQUENCE_M before and after one on its path, with their positions (2,) in its frame."""
        path = self._path[view.robot]
        robot_odom = inverse(view.pose_odom)
        chosen = []
        for away_m in SEQUENCE_M:
            chosen.append(bisect.bisect_right(path, view.travel_m - away_m, key=attrgetter("travel_m")) - 1)
            chosen.append(bisect.bisect_left(path, view.travel_m + away_m, key=attrgetter("travel_m")))
        return [
            (path[k], compose(robot_odom, path[k].pose_odom)[:2])
            for k in dict.fromkeys(chosen)
            if 0 <= k < len(path) and abs(path[k].travel_m - view.travel_m) < SEQUENCE_END_M
        ]

    def _near(self, centre: SignPlace, view: Keyframe) -> list[tuple[SignPlace, Array]]:
        """Signs with a text near another on the same map, with positions in the frame of one of its views."""
        robot_odom = inverse(view.pose_odom)
        others = [place for place in self.signs[centre.robot] if place is not centre and place.consensus]
        return [
            (place, compose(robot_odom, [*place.position_odom, 0.0])[:2])
            for place in others
            if math.dist(place.position_odom, centre.position_odom) < NEIGHBOUR_REACH_M
        ]


def _likelihood(reading: SignPlace, others: Sequence[SignPlace]) -> Array:
    """(others,) log probability of the reading's text if it is of each of the other signs."""
    return log_text_likelihood(
        reading.consensus, [p.consensus for p in others], reading.support, np.array([p.support for p in others])
    )
