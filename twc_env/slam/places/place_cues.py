"""The three cues of TWC-SLAM's Algorithm 1 between two keyframes: sign texts, transmitter sets and signal strengths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twc_env.config import PlaceRecognitionConfig
from twc_env.records.messages import Fingerprint, Keyframe
from twc_env.slam.places.radio_fingerprint import mac_similarity, rssi_distance_db, rssi_similarity
from twc_env.slam.places.rssi_similarity import COSINES, by_cosine, by_distance
from twc_env.slam.places.text_similarity import normalise, text_similarity


@dataclass(frozen=True, slots=True)
class Similarities:
    """The three cues of Algorithm 1 between two keyframes."""

    text: float
    """Similarity of the most similar pair of texts (Eq. 5); 0 if either side read none."""
    macs: float
    """Transmitter sets (Eq. 9)."""
    rssi: float
    """Signal strengths, see papers.md T8; in mode `paper` the distance itself (Eq. 10)."""

    def passes(self, alpha: float, beta: float, gamma: float) -> bool:
        """Algorithm 1: all three reach their thresholds."""
        return self.text >= alpha - 1e-9 and self.macs >= beta - 1e-9 and self.rssi >= gamma - 1e-9


def similarities(target: Keyframe, source: Keyframe, rule: PlaceRecognitionConfig) -> Similarities:
    """All three cues between two keyframes, independent of the thresholds."""
    clean = normalise if rule.normalise_text else str
    text = max((text_similarity(clean(a.text), clean(b.text)) for a in target.signs for b in source.signs), default=0.0)
    macs = mac_similarity(target.fingerprint, source.fingerprint)
    prints = target.fingerprint, source.fingerprint
    return Similarities(text, macs, rssi_cue(*rssi_distance_db(*prints), rule, prints)[0])


def rssi_cue(
    distance_db: float, shared: int, rule: PlaceRecognitionConfig, prints: tuple[Fingerprint, Fingerprint]
) -> tuple[float, bool]:
    """Similarity of two fingerprints' signal strengths, and whether it reaches gamma."""
    if rule.rssi_mode == "paper":
        return distance_db, shared > 0 and distance_db >= rule.rssi_similarity_min
    if rule.rssi_mode == "saturating":  # the default, computed without arrays
        rssi: float = rssi_similarity(distance_db, shared, rule.rssi_tolerance_db)
    elif rule.rssi_mode in COSINES:
        rssi = by_cosine(rule.rssi_mode, *prints)
    else:
        rssi = float(by_distance(rule.rssi_mode, np.array(distance_db), np.array(shared), rule.rssi_tolerance_db))
    return rssi, rssi >= rule.rssi_similarity_min - 1e-9
