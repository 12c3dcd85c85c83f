"""Settings of doors that move and of furniture that the plan does not have."""

from __future__ import annotations

from dataclasses import dataclass

from twc_env.config.checks import Checked, number

FURNITURE_MAX = 500
"""Most pieces of furniture."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClutterConfig(Checked):
    """Doors that open and close, and furniture that the plan does not have; none by default (docs/people.md).

    Scanners, cameras and radio notice them, and robots bump into them. The true map is that of the building without
    them, and the floor that they cover is not scored."""

    door_share: float = number(0.0, 0.0, 1.0)
    """Share of the doorways that have a door."""
    door_open_mean_s: float = number(40.0, 1.0, 3600.0)
    """Mean time that a door stays open, exponentially distributed ..."""
    door_closed_mean_s: float = number(10.0, 1.0, 3600.0)
    """... and closed. People who walk open it on their way, robots wait."""
    furniture: int = number(0, 0, FURNITURE_MAX)
    """Pieces of furniture off the plan: tables, chairs and boxes, as far as the building has room for them."""
    hidden_share: float = number(0.0, 0.0, 1.0)
    """Share of the pieces that lie below the plane of the scan: only who drives against them knows of them."""
    moves_per_min: float = number(0.0, 0.0, 60.0)
    """Rate at which each piece is pushed to another place nearby, while no robot is there."""
    loss_db: float = number(3.5, 0.0, 40.0)
    """RSSI lost in a door leaf, open or closed, and in a tall box; as in wood at 2.4 GHz."""
