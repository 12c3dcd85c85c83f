"""The three environments of Table 1 of the radio SLAM paper: published values, twins, and walks through them."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from numpy.typing import NDArray as Array

from twc_env.config import RadioConfig, from_dict
from twc_env.reproduce.radio import radio_walks
from twc_env.reproduce.radio.radio_walks import RecordedWalk


@dataclass(frozen=True, slots=True)
class Place:
    """One environment of Table 1: published values and its twin."""

    twin: str
    preset: str
    length_m: float
    duration_s: float
    odometry_m: float
    drift: float
    """Nominal drift of the odometry, which is adjusted to the published error."""
    printed: dict[str, tuple[float, float | None]]
    """Method -> published mean and standard deviation of the error [m]."""
    storeys: tuple[int, ...] = (0,)
    resolution_m: float = 0.1
    """Resolution of the route planner."""
    has_lidar: bool = False

    @property
    def speed_m_s(self) -> float:
        """From the published length and duration (the published 0.4 m/s contradicts them outdoors)."""
        return self.length_m / self.duration_s

    def shortened(self, share: float) -> Place:
        """The place with this share of the path length and of the odometry error."""
        length_m, duration_s, odometry_m = self.length_m * share, self.duration_s * share, self.odometry_m * share
        return dataclasses.replace(self, length_m=length_m, duration_s=duration_s, odometry_m=odometry_m)


PLACES = {
    "indoor": Place(
        "radio-sutd-indoor", "radio-indoor", 1114.9, 3092.1, 10.01, 0.2,
        {"odometry": (10.01, None), "wifi": (3.69, 2.21), "lte": (5.18, 2.59)}, storeys=(0, 1, -1, 2, -2, 3, -3),
    ),
    "semi-indoor": Place(
        "radio-ntu", "radio-semi-indoor", 1072.6, 2583.9, 51.98, 1.7,
        {
            "odometry": (51.98, None), "wifi": (4.48, 2.98), "lte": (12.22, 10.95), "wifi+lidar": (0.84, None),
            "gmapping": (4.31, None),
        },
        has_lidar=True,
    ),
    "outdoor": Place(
        "radio-sutd-outdoor", "radio-outdoor", 5171.3, 5494.7, 75.06, 0.08,
        {"odometry": (75.06, None), "wifi": (8.82, 3.94), "lte": (18.38, 10.70)}, resolution_m=0.5,
    ),
}  # fmt: skip


ONE_BAND = "wifi, one band per phone"


def record(place: Place, kind: str, seed: int) -> RecordedWalk:
    """The walk of a seed with its WiFi or LTE scans; kind: "wifi", "lte" or ONE_BAND."""
    true_poses = true_path(place, seed)
    radio = radio_config(place, kind)
    odometry = place.odometry_m, place.drift
    return radio_walks.record(place.twin, true_poses, radio, seed, *odometry, place.storeys, kind == ONE_BAND)


def true_path(place: Place, seed: int) -> Array:
    """(steps, 3)."""
    return radio_walks.drive(place.twin, place.length_m, place.speed_m_s, seed, place.resolution_m)


def radio_config(place: Place, kind: str) -> RadioConfig:
    """The radio of an environment; half of all addresses send at 5 GHz."""
    values = {"preset": "lte"} if kind == "lte" else {"preset": place.preset, "high_band": {"share": 0.5}}
    return from_dict(values, RadioConfig, "radio")
