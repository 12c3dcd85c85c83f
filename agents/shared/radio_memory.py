"""What each robot heard of the access points where, and what it was told of others: which parts of a building look
alike by radio, before any map is shared.

Fingerprints are compared as in TWC-SLAM (papers.md T7-T8): mean absolute difference of RSSI over all addresses that
either place hears, where an address that is not heard counts as just below the detection floor.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.geometry import compose, inverse
from twc_env.records.messages import Belief

SPACING_M = 1.0
"""Path length that one fingerprint averages over."""
UNHEARD_DBM = -92.0


class RadioMemory:
    """Fingerprints along the paths of all robots. A robot knows those of another up to their last contact."""

    def __init__(self, agents: Sequence[str]):
        self._columns: dict[int, int] = {}
        self._poses_odom: dict[str, list[Array]] = {agent: [] for agent in agents}
        self._sums: dict[str, list[tuple[dict[int, float], dict[int, int]]]] = {agent: [] for agent in agents}
        self._told: dict[tuple[str, str], int] = {}

    def note(self, beliefs: dict[str, Belief]) -> None:
        """Add what each robot hears now, and exchange with those in contact."""
        for agent, belief in beliefs.items():
            poses, sums = self._poses_odom[agent], self._sums[agent]
            if not poses or np.hypot(*(poses[-1][:2] - belief.pose_odom[:2])) >= SPACING_M:
                poses.append(np.array(belief.pose_odom))
                sums.append(({}, {}))
            if belief.wifi is not None:
                total, count = sums[-1]
                for mac, rssi in zip(belief.wifi.macs.tolist(), belief.wifi.rssi_dbm.tolist(), strict=True):
                    self._columns.setdefault(mac, len(self._columns))
                    total[mac], count[mac] = total.get(mac, 0.0) + rssi, count.get(mac, 0) + 1
            for other, theirs in beliefs.items():
                if belief.contact_steps.get(theirs.robot, -1) == belief.step:
                    self._told[agent, other] = len(self._poses_odom[other])

    def places_m(self, agent: str, beliefs: dict[str, Belief]) -> Array:
        """(k, 2) where a robot took its fingerprints, in the map frame of its belief."""
        belief = beliefs[agent]
        pose_map_odom = compose(belief.pose_map_robot, inverse(belief.pose_odom))
        return compose(pose_map_odom, np.array(self._poses_odom[agent]).reshape(-1, 3))[:, :2]

    def rssi_dbm(self, agent: str, until: int | None = None) -> Array:
        """(k, addresses) mean RSSI at these places; only the first `until` of them."""
        rows = self._sums[agent][:until]
        table = np.full((len(rows), len(self._columns)), UNHEARD_DBM)
        for row, (total, count) in zip(table, rows, strict=True):
            for mac, value in total.items():
                row[self._columns[mac]] = value / count[mac]
        return table

    def rssi_of_others_dbm(self, agent: str, others: Sequence[str]) -> Array:
        """(k, addresses) fingerprints of other robots, as far as they were told."""
        parts = [self.rssi_dbm(other, self._told.get((agent, other), 0)) for other in others]
        return np.vstack([np.zeros((0, len(self._columns))), *parts])


def apart_db(rssi_dbm: Array, others_dbm: Array) -> Array:
    """(n,) for each of n fingerprints the difference [dB] to the most similar of the others; infinite without any."""
    if not len(others_dbm):
        return np.full(len(rssi_dbm), np.inf)
    either = (rssi_dbm[:, None] > UNHEARD_DBM) | (others_dbm[None] > UNHEARD_DBM)  # (n, m, addresses)
    total = np.where(either, np.abs(rssi_dbm[:, None] - others_dbm[None]), 0.0).sum(axis=-1)
    return (total / np.maximum(either.sum(axis=-1), 1)).min(axis=1)
