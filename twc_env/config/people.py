"""Settings of the people in the building."""

from __future__ import annotations

from dataclasses import dataclass

from twc_env.config.checks import Checked, number

PEOPLE_MAX = 200
"""Largest crowd."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PeopleConfig(Checked):
    """People who walk between places, stand in groups or sit; none by default (docs/people.md).

    Scanners see their legs, cameras do not see signs behind them, and they weaken WiFi. They are no part of the true
    map. Those who neither walk nor sit stand in groups."""

    count: int = number(0, 0, PEOPLE_MAX)
    walking_share: float = number(0.5, 0.0, 1.0)
    """Share of the people who walk from one place of the building to another, pause there and walk on."""
    sitting_share: float = number(0.25, 0.0, 1.0)
    """Share of the people who sit near a wall for the whole episode; at most what the walking ones leave."""
    speed_mean_m_s: float = number(1.29, 0.1, 3.0)
    """Mean of the speed at which people walk if nobody is in the way (Moussaid et al. 2009)."""
    speed_std_m_s: float = number(0.19, 0.0, 1.0)
    """Variation of that speed between people."""
    pause_mean_s: float = number(10.0, 0.0, 3600.0)
    """Mean time that a walking person stays at a place, exponentially distributed."""
    body_loss_db: float = number(7.0, 0.0, 40.0)
    """RSSI lost per person in the line of sight to an access point. ITU-R P.1238 reports 6 to 8 dB (at 1.7 GHz), and
    no effect where there is no line of sight."""
