"""Walks of a robot with five phones and wheel odometry through the places of the radio SLAM paper (papers.md R14).

Length, duration and mean odometry error of each walk are those of the published table. The robot moves without stops
along shortest paths between random places.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray as Array
from scipy.ndimage import gaussian_filter1d

from twc_env.config import LidarConfig, OdometryConfig, RadioConfig
from twc_env.errors import ConfigError
from twc_env.maps import load_map
from twc_env.metrics import path_length_m
from twc_env.records.geometry import compose, points_along, poses_along, wrap_angle
from twc_env.records.messages import Fingerprint, WifiScan
from twc_env.records.random_streams import random_stream
from twc_env.reproduce import radio_places
from twc_env.reproduce.routes import RoutePlanner
from twc_env.slam.places.radio_fingerprint import fingerprint
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.sensors.lidar import Lidar, glass_walls
from twc_env.world.sensors.odometry import Odometry
from twc_env.world.sensors.radio import RadioModel
from twc_env.world.sensors.reception import WifiReceiver

PLATFORM = "skid-steer"
PHONES = 5
SCAN_PERIOD_S = 2.0
ODOMETRY_STEP_S = 0.5
STEPS_PER_SCAN = round(SCAN_PERIOD_S / ODOMETRY_STEP_S)
ROUNDING_M = 0.4
"""Length over which corners of the path are rounded."""
TURN_RATE_RAD_S = 0.6
DRIFT_FACTORS, STREAMS_MAX = (0.6, 1.7), 100
MATCHED_SHARE = 0.005
"""Relative tolerance of the odometry error."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedWalk:
    """Measurements of one robot at its radio scans (n), and the ground truth."""

    true_poses: Array
    """(n, 3)."""
    motions: Array
    """(n - 1, 3) odometry from each scan to the next."""
    turned_rad: Array
    """(n - 1,) measured turn from each scan to the next, not wrapped."""
    fingerprints: tuple[Fingerprint, ...]
    """One per scan, merged over the phones; WiFi or LTE, depending on the configuration."""
    drift: float
    odometry_stream: int
    """Seed of the odometry's noise."""

    @property
    def odometry(self) -> Array:
        """(n, 3) dead reckoning from the true first pose."""
        return dead_reckoning(self.true_poses[0], self.motions)


@lru_cache(maxsize=4)
def planner(name: str, resolution_m: float) -> RoutePlanner:
    """The route planner of a named map."""
    return RoutePlanner(load_map(name), resolution_m)


def drive(name: str, length_m: float, speed_m_s: float, seed: int, resolution_m: float = 0.1) -> Array:
    """(steps, 3) true poses every ODOMETRY_STEP_S along a path of this length between random places."""
    way = planner(name, resolution_m).wander(length_m + 1.0, random_stream(seed, f"radio walk {name}"))
    return poses_along_way(way, length_m, speed_m_s)


def poses_along_way(way: Array, length_m: float, speed_m_s: float) -> Array:
    """(steps, 3) poses every ODOMETRY_STEP_S along a path (points, 2), its corners rounded."""
    fine = points_along(way, np.arange(0.0, path_length_m(way), 0.1))
    fine = gaussian_filter1d(fine, ROUNDING_M / 0.1, axis=0, mode="nearest")
    step_m = speed_m_s * ODOMETRY_STEP_S
    positions = points_along(fine, np.arange(0.0, min(length_m, path_length_m(fine)), step_m))
    ahead = np.gradient(positions, axis=0)
    return _turning_slowly(positions, np.arctan2(ahead[:, 1], ahead[:, 0]))


def _turning_slowly(positions: Array, heading: Array) -> Array:
    """Poses (k, 3), with more steps where the robot stops for turns that are too fast for it."""
    turn = wrap_angle(np.diff(heading))
    steps = np.maximum(1, np.ceil(np.abs(turn) / (TURN_RATE_RAD_S * ODOMETRY_STEP_S))).astype(int)
    at = np.repeat(np.arange(len(turn)), steps)
    part = np.arange(len(at)) - np.repeat(np.cumsum(steps) - steps, steps)  # 0 .. steps - 1 of each turn
    turning = heading[at] + turn[at] * (part + 1) / steps[at]
    moved = positions[at + (part + 1 == steps[at])]
    poses = np.column_stack([moved, wrap_angle(turning)])
    return np.concatenate([[[*positions[0], heading[0]]], poses])


def record(
    name: str,
    true_poses: Array,
    radio: RadioConfig,
    seed: int,
    odometry_error_m: float,
    nominal_drift: float,
    storeys: tuple[int, ...] = (0,),
    is_band_split: bool = False,
) -> RecordedWalk:
    """Measurements on a `drive`, with odometry whose mean error is `odometry_error_m`.

    is_band_split: see `scan_radio`.
    """
    at = np.arange(0, len(true_poses), STEPS_PER_SCAN)
    drift, stream = matched_odometry(true_poses, at, odometry_error_m, nominal_drift, seed)
    motions, turned_rad = measured_odometry(true_poses, at, drift, stream)
    plan = radio_places.over_storeys(load_map(name), storeys)
    prints = scan_radio(plan, radio, true_poses[at], seed, is_band_split)
    return RecordedWalk(true_poses[at], motions, turned_rad, prints, drift, stream)


def scan_radio(
    plan: Floorplan, radio: RadioConfig, poses: Array, seed: int, is_band_split: bool = False
) -> tuple[Fingerprint, ...]:
    """Fingerprints at true poses (n, 3), each merged over the phones; is_band_split: each phone scans one band, by
    turns 2.4 and 5 GHz, as phones do that are set to (papers.md R3)."""
    model = _model(radio, plan)
    receivers = [WifiReceiver(radio, model, device, seed) for device in range(PHONES)]
    prints = []
    for k, pose in enumerate(poses):
        scans = [receiver.scan(pose[:2], k * SCAN_PERIOD_S) for receiver in receivers]
        if is_band_split:
            scans = [_in_band(scan, model, device % 2) for device, scan in enumerate(scans)]
        prints.append(fingerprint(scans, 0.0))
    return tuple(prints)


def _in_band(scan: WifiScan, model: RadioModel, band: int) -> WifiScan:
    """The readings of one band."""
    kept = model.band_of[np.searchsorted(model.macs, scan.macs)] == band
    return WifiScan(scan.macs[kept], scan.rssi_dbm[kept])


def subsampled(fingerprints: Sequence[Fingerprint], share: float, seed: int) -> tuple[Fingerprint, ...]:
    """The fingerprints with only this share of the transmitters."""
    known = np.unique(np.concatenate([f.macs for f in fingerprints]))
    kept = known[random_stream(seed, "transmitters kept").random(len(known)) < share]
    return tuple(
        Fingerprint(f.macs[is_kept], f.rssi_dbm[is_kept])
        for f, is_kept in ((f, np.isin(f.macs, kept)) for f in fingerprints)
    )


def scan_lidar(plan: Floorplan, lidar: LidarConfig, poses: Array, seed: int) -> Array:
    """(n, beams) ranges at true poses (n, 3)."""
    scanner = Lidar(lidar, plan.wall_index, 0.2, 1, seed, glass_walls(plan))
    return np.concatenate([scanner.scan(pose[None]) for pose in poses])


def dead_reckoning(start: Array, motions: Array) -> Array:
    """(n, 3) poses from the first one and the motions (n - 1, 3)."""
    return compose(start, poses_along(motions))


def odometry_of(drift: float, seed: int) -> Odometry:
    """The robot's odometry."""
    return Odometry(OdometryConfig(platform=PLATFORM, drift=drift), ODOMETRY_STEP_S, 1, seed)


def measured_odometry(true_poses: Array, at: Array, drift: float, seed: int) -> tuple[Array, Array]:
    """Motions (scans - 1, 3) between the scans, at the steps `at`, and turns (scans - 1,), not wrapped."""
    odometry = odometry_of(drift, seed)
    steps = np.array([odometry.measure(a[None], b[None])[0][0] for a, b in itertools.pairwise(true_poses)])
    motions = steps[at[:-1]]
    for k in range(1, int(at[1] - at[0])):
        motions = compose(motions, steps[at[:-1] + k])
    turned = np.concatenate([[0.0], np.cumsum(steps[:, 2])])
    return motions, np.diff(turned[at])


def matched_odometry(
    true_poses: Array, at: Array, wanted_m: float, nominal_drift: float, seed: int
) -> tuple[float, int]:
    """Drift near the nominal one, and the noise stream, for which the mean odometry error is `wanted_m`.

    The error is mostly random; noise streams that would need a very different drift are skipped.
    """
    for stream in range(STREAMS_MAX * seed, STREAMS_MAX * (seed + 1)):
        low, high = (factor * nominal_drift for factor in DRIFT_FACTORS)
        away = [_odometry_error_m(true_poses, at, drift, stream) - wanted_m for drift in (low, high)]
        if away[0] > 0 or away[1] < 0:
            continue
        while True:
            drift = (low + high) / 2
            error = _odometry_error_m(true_poses, at, drift, stream) - wanted_m
            if abs(error) <= MATCHED_SHARE * wanted_m or high - low < 1e-6:
                return drift, stream
            low, high = (drift, high) if error < 0 else (low, drift)
    raise ConfigError(f"no odometry is off by {wanted_m:g} m at a drift near {nominal_drift:g}; choose another drift")


def _odometry_error_m(true_poses: Array, at: Array, drift: float, stream: int) -> float:
    reckoned = dead_reckoning(true_poses[0], measured_odometry(true_poses, at, drift, stream)[0])
    return float(np.linalg.norm(reckoned[:, :2] - true_poses[at, :2], axis=1).mean())


@lru_cache(maxsize=2)
def _model(radio: RadioConfig, plan: Floorplan) -> RadioModel:
    return radio_places.RememberingModel(radio, plan)
