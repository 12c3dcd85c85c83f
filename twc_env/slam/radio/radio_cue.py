"""One kind of radio (WiFi or LTE) along a path: similarities, their distance model, and signal strength fields."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import RadioSlamConfig
from twc_env.records.geometry import poses_along
from twc_env.records.messages import Fingerprint
from twc_env.slam.odometry.odometry_calibration import Motions
from twc_env.slam.pose_graph.distance_factor import Distances
from twc_env.slam.radio import radio_closures, radio_field
from twc_env.slam.radio.radio_evidence import FieldEvidence
from twc_env.slam.radio.radio_similarity import all_similarities, averaged, feature_rows, split_cues
from twc_env.slam.radio.similarity_model import SimilarityModel, train_on_path

CUES = ("wifi", "lte")
PAPER_APART_M = 100.0
BANDWIDTHS_M = {"wifi": (8.0, 8.0, 5.0, 4.0, 4.0, 4.0), "lte": (40.0, 40.0, 30.0, 30.0, 25.0, 25.0, 20.0, 20.0, 20.0)}
"""Bandwidths of the signal strength fields, round by round."""
FIELD_SMOOTHING = 0.6
"""Smoothing length of the fingerprints for fields, as a share of that for similarities."""
EVIDENCE_SMOOTHING_M = 3.0
"""Smoothing length for the evidence. With longer ones, neighbouring places share scans and are more similar than the
field explains."""
ALONG_SMOOTHING = {"wifi": 0.67, "lte": 1.0}
"""Smoothing length of the final fit, as a share of the place spacing: most scans are used, mostly at one place only."""


@dataclass(slots=True, eq=False)
class RadioCue:
    """Data of one kind of radio at n places."""

    name: str
    travel_m: Array
    """(n,) path length at each place."""
    similarity: Array
    """(n, n)."""
    model: SimilarityModel
    feature: Array
    """(n, transmitters) input of the fields."""
    evidence: FieldEvidence
    """Evidence of a layout."""
    evidence_along: FieldEvidence
    """The same with all places, and with a term for correlation along the path."""
    field_weights: dict[float, float] = field(default_factory=dict)
    """Weight of field differences, by bandwidth."""

    @property
    def rounds(self) -> int:
        """Number of field rounds, from coarse to fine."""
        return len(BANDWIDTHS_M[self.name])

    def closures(self, config: RadioSlamConfig, cell_m: float) -> Distances:
        """Distances between similar places; with weighting `ours` the strongest per pair of cells."""
        if config.weighting == "ours":
            return radio_closures.closures(
                self.similarity, self.travel_m, self.model, config.similarity_min, config.apart_m, cell_m,
                config.closures_per_place,
            )  # fmt: skip
        i, j = radio_closures.similar_pairs(self.similarity, self.travel_m, config.similarity_min, PAPER_APART_M)
        return Distances(np.column_stack([i, j]), *self.model.distance(self.similarity[i, j]))

    def constraints(
        self, poses: Array, motions: Motions, round_: int, apart_m: float, cell_m: float
    ) -> radio_field.FieldConstraints:  # fmt: skip
        """Constraints from the fields of a round's bandwidth, between places near each other at poses (n, 3)."""
        bandwidths = BANDWIDTHS_M[self.name]
        bandwidth_m = max(bandwidths[min(round_, len(bandwidths) - 1)], 1.5 * cell_m / 2)
        if bandwidth_m not in self.field_weights:
            reckoned = poses_along(motions.motion)[:, :2]
            weight = radio_field.learn_weight(self.feature, reckoned, self.travel_m, bandwidth_m)
            self.field_weights[bandwidth_m] = weight
        weight = self.field_weights[bandwidth_m]
        return radio_field.field_constraints(self.feature, poses[:, :2], self.travel_m, bandwidth_m, apart_m, weight)


def prepared(
    name: str, fingerprints: Sequence[Fingerprint], travel_m: Array, places: Array, odometry: Array,
    config: RadioSlamConfig,
) -> RadioCue | None:  # fmt: skip
    """The cue of this name at scans `places` (n,) of a log with path length travel_m (scans,) and dead-reckoned poses
    (n, 3) there; None if too little was received."""
    rows = feature_rows([split_cues(f)[name] for f in fingerprints], config.similarity)
    if rows.nnz == 0:
        return None
    is_ours = config.weighting == "ours"
    smoothing_m = config.smoothing_wifi_m if name == "wifi" else config.smoothing_lte_m
    window_m = config.window_wifi_m if name == "wifi" else config.window_lte_m
    similarity = all_similarities(averaged(rows, travel_m, smoothing_m if is_ours else 0.0, places))
    model = train_on_path(
        similarity, travel_m[places], odometry[:, :2], config.similarity_min, window_m, config.bin_width,
        "repaired" if is_ours else "paper",
    )  # fmt: skip
    if not len(model.centre):
        return None
    feature = averaged(rows, travel_m, FIELD_SMOOTHING * smoothing_m, places).toarray().astype(np.float32)
    sharp = averaged(rows, travel_m, EVIDENCE_SMOOTHING_M, places).toarray()
    own_m = ALONG_SMOOTHING[name] * float(travel_m[places[-1]]) / max(len(places) - 1, 1)
    along = FieldEvidence(averaged(rows, travel_m, own_m, places).toarray(), travel_m[places], len(places))
    return RadioCue(name, travel_m[places], similarity, model, feature, FieldEvidence(sharp), along)
