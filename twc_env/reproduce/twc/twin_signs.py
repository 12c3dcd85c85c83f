"""Fig. 3 of TWC-SLAM: two signs with one text, and the access points heard at each (papers.md T21)."""

from __future__ import annotations

import itertools

from twc_env.config import EnvConfig
from twc_env.reproduce.routes import SignPass, Walk
from twc_env.slam.places.place_cues import similarities

LISTED = 4
"""Strongest access points shown of each pass."""


def twin_signs(config: EnvConfig, walks: list[Walk]) -> list[str]:
    """Sentences on the first pair of passes of two robots at two signs with one text, and the first at one sign."""
    passes = [(robot, own) for robot, walk in enumerate(walks) for own in walk.sign_passes]
    found: dict[str, str] = {}
    for (a, first), (b, second) in itertools.combinations(passes, 2):
        kind = "one sign" if first.sign == second.sign else "two signs"
        texts = [own.keyframe.signs[0].text for own in (first, second)]
        if a == b or texts[0] != texts[1] or kind in found:
            continue
        cues = similarities(first.keyframe, second.keyframe, config.slam.place_recognition)
        found[kind] = (
            f"{texts[0]!r} read twice at {kind}: shared addresses {cues.macs:.2f}, similar strengths {cues.rssi:.2f}; "
            f"heard {_heard(first)} and {_heard(second)}"
        )
    return [found[kind] for kind in sorted(found, reverse=True)]


def _heard(own: SignPass) -> str:
    heard = own.keyframe.fingerprint
    strongest = sorted(zip(heard.rssi_dbm.tolist(), heard.macs.tolist(), strict=True), reverse=True)[:LISTED]
    return ", ".join(f"{mac:012x} {rssi_dbm:.0f} dBm" for rssi_dbm, mac in strongest)
