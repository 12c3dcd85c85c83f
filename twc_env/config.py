"""Every number the environment can be configured with, in one place; the sections follow the order of a step.

A config is a frozen value: build it once, hand each module its section, never edit it. `from_dict` and `load` refuse
keys they do not know and values of the wrong type or out of range; `digest` names the values in logs and tables.
"""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import json
import math
import tomllib
import typing
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from twc_env.errors import ConfigError


def _number(default, minimum: float = -math.inf, maximum: float = math.inf):
    """A number with its allowed range (both ends included)."""
    return field(default=default, metadata={"minimum": minimum, "maximum": maximum})


def _choice(default: str, *others: str):
    """A name out of a fixed list."""
    return field(default=default, metadata={"choices": (default, *others)})


class _Checked:
    """Checks each field against the range or list it was declared with."""

    __slots__ = ()

    def __post_init__(self) -> None:
        where = type(self).__name__.removesuffix("Config").lower()
        for f in dataclasses.fields(self):  # type: ignore[arg-type]
            value = getattr(self, f.name)
            if (choices := f.metadata.get("choices")) and value not in choices:
                near = difflib.get_close_matches(str(value), choices, n=1)
                hint = f"; did you mean {near[0]!r}?" if near else ""
                raise ConfigError(f"{where}.{f.name} must be one of {', '.join(choices)}; got {value!r}{hint}")
            if "minimum" in f.metadata:
                low, high = f.metadata["minimum"], f.metadata["maximum"]
                if isinstance(value, bool) or not isinstance(value, (int, float)):
                    raise ConfigError(f"{where}.{f.name} must be a number; got {value!r}")
                if not low <= value <= high:
                    raise ConfigError(f"{where}.{f.name} must lie in [{low:g}, {high:g}]; got {value!r}")


@dataclass(frozen=True, slots=True, kw_only=True)
class BuildingConfig(_Checked):
    """What is left of the map's signs and access points: dials for how hard places are to recognise."""

    sign_share: float = _number(1.0, 0.0, 1.0)
    sign_duplication: float = _number(0.0, 0.0, 1.0)
    """Share of the signs whose text is taken from a few others."""
    access_point_share: float = _number(1.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class DynamicsConfig(_Checked):
    """How commands move a robot: a disc on differential wheels."""

    time_step_s: float = _number(0.1, 0.01, 1.0)
    speed_max_m_s: float = _number(1.0, 0.01, 5.0)
    turn_rate_max_rad_s: float = _number(1.5, 0.01, 10.0)
    acceleration_max_m_s2: float = _number(4.0, 0.1, 100.0)
    turn_acceleration_max_rad_s2: float = _number(10.0, 0.1, 1000.0)
    robot_radius_m: float = _number(0.2, 0.05, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryConfig(_Checked):
    """How measured motion differs from true motion."""

    platform: str = _choice("wheeled", "handheld", "legged", "skid-steer", "pioneer-intel")
    """`skid-steer` is a robot that was never calibrated well; `pioneer-intel` drifts as the raw odometry of the Intel
    Research Lab log does."""
    drift: float = _number(1.0, 0.0, 10.0)
    """Multiplies every error of the platform's preset: 0 gives perfect odometry and gyro, 1 the preset."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarConfig(_Checked):
    """2D laser scanner over the full circle; beam 0 points ahead, beams run counter-clockwise."""

    beam_count: int = _number(180, 8, 4096)
    range_max_m: float = _number(10.0, 0.5, 100.0)
    range_noise_std_m: float = _number(0.01, 0.0, 1.0)
    dropout_probability: float = _number(0.0, 0.0, 1.0)
    """Chance that a beam has no return though something is there."""
    glass_return_probability: float = _number(1.0, 0.0, 1.0)
    """Chance that a glass wall hit head-on is seen; 1 makes glass a wall like any other."""
    glass_incidence_max_rad: float = _number(0.6, 0.01, math.pi / 2)
    """From head-on to this angle of incidence the chance falls to nothing; beyond it a beam always passes glass."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HighBandConfig(_Checked):
    """The 5 GHz band of the access points: how it differs from 2.4 GHz."""

    share: float = _number(0.0, 0.0, 1.0)
    """Of each access point's addresses, sent at 5 GHz (spread evenly: 0.5 makes every second one)."""
    power_offset_db: float = _number(-3.0, -40.0, 40.0)
    """Strength at 1 m against 2.4 GHz."""
    path_loss_exponent: float = _number(2.5, 1.0, 6.0)
    wall_loss_factor: float = _number(1.5, 0.0, 5.0)
    """Loss of a wall of no known material against 2.4 GHz; known materials have their own (`world.materials`)."""
    floor_loss_factor: float = _number(1.5, 0.0, 5.0)
    detection_offset_db: float = _number(0.0, -40.0, 40.0)
    """Added to `detection_floor_dbm`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CellConfig(_Checked):
    """LTE cells on masts outside the building (SPEC R14-R15): three sectors per mast, heard beside the WiFi."""

    count: int = _number(0, 0, 1000)
    distance_min_m: float = _number(150.0, 1.0, 100_000.0)
    """Masts stand between these distances from the building's middle, evenly over the area."""
    distance_max_m: float = _number(1500.0, 1.0, 100_000.0)
    power_at_1m_dbm: float = _number(-8.0, -80.0, 60.0)
    """Reference signal strength in the middle of a sector, extrapolated to 1 m."""
    path_loss_exponent: float = _number(3.5, 1.0, 6.0)
    wall_loss_factor: float = _number(1.0, 0.0, 5.0)
    """Loss of a wall of no known material against 2.4 GHz."""
    shadowing_std_db: float = _number(7.0, 0.0, 20.0)
    shadowing_length_m: float = _number(40.0, 0.1, 1000.0)
    detection_floor_dbm: float = _number(-118.0, -160.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioConfig(_Checked):
    """Radio strength: rssi = P(1 m) - 10 n log10 d - wall losses + shadowing + fading + device offset + noise.

    Named settings for other places come from `radio_preset`, or as `preset` in the radio table of a config file.
    """

    wifi: bool = True
    """Whether the plan's access points send at all (an LTE-only study turns them off)."""
    scan_period_s: float = _number(0.2, 0.01, 60.0)
    power_at_1m_dbm: float = _number(-35.0, -80.0, 30.0)
    path_loss_exponent: float = _number(2.3, 0.0, 6.0)
    distance_min_m: float = _number(0.5, 0.01, 10.0)
    shadowing_std_db: float = _number(2.0, 0.0, 20.0)
    shadowing_length_m: float = _number(4.0, 0.1, 100.0)
    fading_std_db: float = _number(1.5, 0.0, 20.0)
    """Small-scale fading, redrawn for each transmitter whenever a robot has moved `fading_length_m`."""
    fading_length_m: float = _number(0.5, 0.01, 10.0)
    fading_shared: bool = False
    """All addresses of one transmitter (access point and band) fade together, as one box's networks do."""
    device_offset_std_db: float = _number(0.8, 0.0, 20.0)
    """How much louder or fainter one robot's receiver reads everything."""
    device_sensitivity_std_db: float = _number(0.0, 0.0, 20.0)
    """How much the detection floor differs between receivers."""
    noise_std_db: float = _number(3.0, 0.0, 20.0)
    detection_floor_dbm: float = _number(-88.0, -120.0, 0.0)
    """A signal of this strength is heard in half of the scans."""
    detection_slope_db: float = _number(2.0, 0.05, 20.0)
    miss_probability: float = _number(0.0, 0.0, 1.0)
    """Chance that a scan misses a transmitter however strong it is."""
    quantisation_db: float = _number(1.0, 0.01, 10.0)
    power_spread_db: float = _number(1.0, 0.0, 20.0)
    """How much the addresses of one access point differ in power (standard deviation)."""
    access_point_spread_db: float = _number(0.0, 0.0, 20.0)
    """How much access points differ in power: make, mounting, antenna."""
    bssids_per_access_point: int = _number(0, 0, 32)
    """Addresses each access point sends under; 0 takes those of the plan."""
    wall_loss_scale: float = _number(1.0, 0.0, 10.0)
    """Multiplies the plan's wall losses on all bands: thin partitions drawn as 4 dB become concrete at 2.2."""
    floor_loss_db: float = _number(20.0, 0.0, 100.0)
    """Loss of the first ceiling between the robots and an access point of another storey."""
    floor_loss_further_db: float = _number(10.0, 0.0, 100.0)
    """Loss of each further ceiling: other ways around add up (ITU-R P.1238 has 15 + 4 (n - 1) dB for offices)."""
    floor_height_m: float = _number(4.0, 0.5, 20.0)
    sweep_share: float = _number(1.0, 0.01, 1.0)
    """Share of the channels that one sweep comes to, from a random one on; what they hear keeps its last reading."""
    sweep_share_std: float = _number(0.0, 0.0, 1.0)
    """How much that share differs from scan to scan: phones break sweeps off."""
    sweep_duration_s: float = _number(0.0, 0.0, 60.0)
    """Channels are listened to one after the other over this long, 2.4 GHz first: readings are that old at most."""
    stale_age_max_s: float = _number(0.0, 0.0, 3600.0)
    """Readings that a scan did not renew are repeated with their age until they are this old (0: never)."""
    high_band: HighBandConfig = field(default_factory=HighBandConfig)
    cells: CellConfig = field(default_factory=CellConfig)


@dataclass(frozen=True, slots=True, kw_only=True)
class SignsConfig(_Checked):
    """The camera: which signs are in view, how well their letters show, and how OCR reads them."""

    reader: str = _choice("fast", "paddle", "simple")
    """`fast` draws from the measured table, `paddle` runs a real OCR on a picture of each sign (slow; extra `ocr`),
    `simple` takes the same two probabilities for every sign."""
    period_s: float = _number(0.5, 0.01, 60.0)
    range_max_m: float = _number(4.0, 0.1, 50.0)
    field_of_view_rad: float = _number(2.6, 0.1, 2 * math.pi)
    incidence_max_rad: float = _number(1.05, 0.1, math.pi / 2)
    """Largest angle between the line of sight and the sign's normal."""
    focal_length_px: float = _number(740.0, 10.0, 100_000.0)
    """Pixels per radian: 740 spreads 1920 pixels over the field of view."""
    character_height_m: float = _number(0.05, 0.002, 2.0)
    """Height of the capitals on all signs."""
    height_min_px: float = _number(5.0, 1.0, 1000.0)
    """Signs with lower capitals in the picture are not looked at."""
    exposure_s: float = _number(0.005, 0.0, 1.0)
    """While it lasts, turning and passing by smear the picture."""
    robots_hide: bool = True
    """Whether other robots hide the letters behind them."""
    bearing_noise_std_rad: float = _number(0.01, 0.0, 0.5)
    range_noise_std_m: float = _number(0.03, 0.0, 1.0)
    fragment_probability: float = _number(0.07, 0.0, 1.0)
    """Of `simple`: chance that a reading is a fragment (10 to 45 % of the characters)."""
    character_error_probability: float = _number(0.03, 0.0, 1.0)
    """Of `simple`: chance that a character is changed, lost or doubled with another."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkConfig(_Checked):
    """Radio between the robots: who hears whom, and what is sent; what is lost is sent again in the next step."""

    topology: str = _choice("central", "peer")
    """`central`: all robots reach one mapper from everywhere; `peer`: every robot has its own mapper, fed by its own
    keyframes and by those that robots in range carry, their own and others' (store and forward)."""
    loss_probability: float = _number(0.0, 0.0, 0.99)
    """Chance that all that one robot sends to one listener in one step is lost."""
    range_max_m: float = _number(15.0, 0.0, 1e5)
    """Of `peer`: robots further apart do not hear each other."""
    wall_range_m: float = _number(0.0, 0.0, 1e5)
    """Of `peer`: every wall between two robots shortens their range by so much; `range_max_m` leaves line of sight."""
    scan_on_request: bool = False
    """Keyframes travel as pose, texts and fingerprint; scans only follow where a mapper asks for them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FailureConfig(_Checked):
    """What breaks. By default nothing does."""

    robots: int = _number(0, 0, 64)
    """So many robots, the last of the team, stop for good: they stand still, sense nothing and say nothing more."""
    robots_step: int = _number(500, 0, 10_000_000)
    """From this step on."""
    link_begin_step: int = _number(0, 0, 10_000_000)
    """Nobody hears anybody from this step on ..."""
    link_end_step: int = _number(0, 0, 10_000_000)
    """... until this one."""
    device_offset_db: float = _number(0.0, -40.0, 40.0)
    """Added to all that the last robot's WiFi receiver hears."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryFilterConfig(_Checked):
    """The EKF of one robot: what it assumes about its sensors."""

    backend: str = _choice("compiled", "filterpy")
    """Same equations twice: a compiled kernel, or filterpy's ExtendedKalmanFilter (the oracle; about 20 x slower)."""
    position_std_per_m: float = _number(0.04, 0.0, 1.0)
    position_std_m: float = _number(0.002, 0.0, 1.0)
    """Per step, whatever the motion."""
    turn_std_rad: float = _number(0.003, 0.0, 1.0)
    """Gyro heading noise per step."""
    odometry_turn_std_rad: float = _number(0.02, 1e-6, 1.0)
    """Odometry heading noise per step."""
    gyro_bias_std_rad_s: float = _number(0.02, 0.0, 1.0)
    """How far off the gyro may be at the start."""
    gyro_bias_walk_rad_s: float = _number(1e-4, 0.0, 1.0)
    match_std_m: float = _number(0.04, 1e-4, 1.0)
    """Distance error of one beam against the local map."""
    match_correlation: float = _number(8.0, 1.0, 1000.0)
    """This many neighbouring beams count as one independent measurement."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalMapConfig(_Checked):
    """The map around one robot that its scans are matched to."""

    size_m: float = _number(32.0, 4.0, 200.0)
    resolution_m: float = _number(0.1, 0.02, 0.5)
    memory_m: float = _number(25.0, 1.0, 1000.0)
    """Keyframes further back along the path than this are left out when the local map moves on."""
    match_distance_max_m: float = _number(0.5, 0.1, 2.0)
    match_iterations_max: int = _number(10, 1, 100)
    degenerate_share: float = _number(0.04, 0.0, 1.0)
    """A direction that fewer than this share of the beams fix is left to odometry (a corridor's axis)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyframeConfig(_Checked):
    """When a robot remembers a place."""

    distance_m: float = _number(0.7, 0.05, 10.0)
    """At the latest so far from the last remembered place ..."""
    turn_rad: float = _number(1.0, 0.05, math.pi)
    """... or turned so far ..."""
    distance_new_m: float = _number(0.4, 0.05, 10.0)
    """... or so far, or turned by as much less, where the scan shows something new:"""
    explained_min: float = _number(0.98, 0.0, 1.0)
    """fewer of its beams than this share end near walls that the local map knows."""
    mask_mates: bool = True
    """Leave out beams that end on something as round and wide as a robot (`dynamics.robot_radius_m`)."""
    fingerprint_window_s: float = _number(2.0, 0.1, 60.0)
    fingerprint_scans_max: int = _number(12, 1, 200)
    fingerprint_detection_min: float = _number(0.4, 0.0, 1.0)
    """A transmitter counts when heard in at least this share of the scans of the window."""
    fingerprint_age_max_s: float = _number(4.0, 0.0, 3600.0)
    """Readings that a scan repeats from longer ago are left out: they were heard at another place."""
    std_mode: str = _choice("population", "sample", "paper")
    """Spread used to clip scans (TWC-SLAM Eq. 7): `paper` is the literal print, which never rejects anything."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceRecognitionConfig(_Checked):
    """Which keyframes look like one place. The thresholds are those of TWC-SLAM's Algorithm 1 (SPEC T4-T9)."""

    recogniser: str = _choice("twc", "text", "wifi", "lidar", "fused")
    """`twc`: Algorithm 1; `text`, `wifi`: its halves; `lidar`: like scans; `fused`: all cues weighed as log-odds."""
    text_similarity_min: float = _number(0.8, 0.0, 1.0)
    """alpha."""
    mac_similarity_min: float = _number(0.8, 0.0, 1.0)
    """beta."""
    rssi_similarity_min: float = _number(0.8, 0.0, 1.0)
    """gamma."""
    rssi_tolerance_db: float = _number(5.0, 0.1, 50.0)
    """tau: rms difference that still counts as the same place."""
    rssi_mode: str = _choice(
        "saturating", "paper", "linear", "saturating-sum", "inverse", "inverse-rms", "exponential", "range",
        "cosine", "cosine-rounded", "cosine-raw",
    )  # fmt: skip
    """Reading of Eq. 10 (`slam.rssi_similarity`); `paper` accepts when the distance d >= gamma, as printed."""
    normalise_text: bool = True
    scan_similarity_min: float = _number(0.7, 0.0, 1.0)
    """Of `lidar`."""
    log_odds_min: float = _number(3.0, -50.0, 50.0)
    """Of `fused`: 3 is 95 % sure."""
    revisit_travel_m: float = _number(12.0, 0.0, 1000.0)
    """Two keyframes of one robot are a loop only when it travelled this far in between."""
    proximity_m: float = _number(2.5, 0.0, 50.0)
    """Keyframes this near in the present estimate are tried too (0: never)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VerificationConfig(_Checked):
    """Scan matching that accepts or refuses a loop candidate."""

    method: str = _choice("point-to-line", "point-to-point")
    """`point-to-line`: matching to lines of walls, which searches where the guess is not near enough;
    `point-to-point`: ICP as TWC-SLAM prints it (Eq. 11-12), from the guess alone."""
    window_m: float = _number(0.6, 0.1, 10.0)
    window_rad: float = _number(0.15, 0.01, math.pi)
    cloud_reach_m: float = _number(3.0, 0.0, 20.0)
    """Keyframes within this path length are joined to the candidate's scan."""
    overlap_min: float = _number(0.65, 0.0, 1.0)
    """Share of source points within 0.15 m of a target wall."""
    contradiction_max: float = _number(0.12, 0.0, 1.0)
    """Share of source points that lie in the target's free space, or the other way round."""
    backlog_per_step: int = _number(2, 1, 1000)
    """Candidates verified per step at most; the others wait."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseGraphConfig(_Checked):
    """Robust SE(2) optimisation."""

    robust: str = _choice("ours", "plain", "dcs", "cauchy", "gnc", "pcm")
    """Which closures to believe: `ours` weighs groups of them by their evidence and keeps having second thoughts,
    `plain` believes all (TWC-SLAM); see `twc_env.slam.robust_backend`."""
    robust_scale: float = _number(5.0, 0.01, 1000.0)
    period_steps: int = _number(10, 1, 10000)
    """Optimised at most this often, and only when closures arrived."""
    iterations_max: int = _number(15, 1, 1000)


@dataclass(frozen=True, slots=True, kw_only=True)
class MergingConfig(_Checked):
    """When two robots' maps are put into one frame."""

    enabled: bool = True
    """Without it every robot stays alone."""
    closures_min: int = _number(3, 1, 100)
    """Mutually consistent closures needed."""
    spread_min_m: float = _number(1.5, 0.0, 100.0)
    """The closures must stem from signs at least this far apart (0: one sign is enough)."""
    consistency_m: float = _number(0.6, 0.01, 10.0)
    consistency_rad: float = _number(0.15, 0.01, math.pi)
    contradiction_max: float = _number(0.10, 0.0, 1.0)
    """Largest share of one map's walls that lie in the other's free space."""
    wifi_check: bool = True
    """Compare all fingerprints that the merge would bring together with what each robot's own path taught."""
    undo: bool = True
    """Look at merges again when more is known, and take groups apart whose merge turns out to be wrong."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioSlamConfig(_Checked):
    """SLAM from radio fingerprints: see `twc_env.slam.radio_slam`."""

    online: bool = False
    """Radio ties keyframes in the pose graph of an episode (`slam.radio_ties`); without laser among the cues always."""
    weighting: str = _choice("ours", "paper")
    """`paper` is the literal print: every similar pair counts in full, distances come from Eq. 3 as printed."""
    similarity: str = _choice("shifted", "raw", "linear")
    similarity_min: float = _number(0.7, 0.0, 1.0)
    """theta_s."""
    apart_m: float = _number(20.0, 0.0, 1000.0)
    """Two places of one path are a closure only when it is this long in between (`paper`: 100 m)."""
    bin_width: float = _number(0.05, 0.001, 1.0)
    """r of Eq. 3."""
    window_wifi_m: float = _number(60.0, 1.0, 10_000.0)
    """Pairs within this path length teach the model (SPEC R5)."""
    window_lte_m: float = _number(150.0, 1.0, 10_000.0)
    smoothing_wifi_m: float = _number(5.0, 0.0, 100.0)
    """Scans this near along the path are averaged into one fingerprint."""
    smoothing_lte_m: float = _number(15.0, 0.0, 100.0)
    spacing_m: float = _number(3.0, 0.1, 100.0)
    """Path length between places of the graph; longer on long paths, so that there are at most `places_max`."""
    places_max: int = _number(600, 10, 100_000)
    cell_m: float = _number(6.0, 0.1, 100.0)
    """Of all closures between two stretches this long the strongest is kept."""
    closures_per_place: int = _number(3, 1, 1000)
    trail_places_max: int = _number(400, 50, 100_000)
    """Places that `radio_trail`, which runs scan by scan, keeps at most."""
    trail_period_m: float = _number(30.0, 1.0, 10_000.0)
    """Path length between two of its optimisations."""
    robust_scale: float = _number(2.0, 0.1, 1000.0)
    """Cauchy: at this many standard deviations a closure has lost half of its weight."""
    position_std_per_m: float = _number(0.03, 0.0, 1.0)
    """Odometry noise over one metre; it grows with the root of the path."""
    heading_std_per_m: float = _number(0.002, 0.0, 1.0)
    heading_std_per_rad: float = _number(0.004, 0.0, 1.0)
    """Heading noise over a turn of one radian."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KVisibilityConfig(_Checked):
    """Walls from signal strength as a map of its own (`Belief.radio_map`), and what it assumes about signals."""

    enabled: bool = False
    """Also adds the block `radio` to observations: probably free and probably wall, from radio alone."""
    power_at_1m_dbm: float = _number(-35.0, -80.0, 30.0)
    path_loss_exponent: float = _number(2.3, 0.0, 6.0)
    wall_loss_db: float = _number(6.0, 0.5, 40.0)
    noise_std_db: float = _number(4.0, 0.1, 20.0)
    located_from_dbm: float = _number(-48.0, -120.0, 30.0)
    """A transmitter heard at least this strongly was passed nearly enough to know where it stands."""
    are_transmitters_known: bool = False
    """The engine is told where all transmitters stand, as inverse k-visibility assumes: an oracle, for comparison."""
    period_scans: int = _number(10, 1, 10_000)
    """The map is worked out anew after so many scans."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CuesConfig(_Checked):
    """What the engine may place robots by; see `twc_env.slam.cues`. Any combination will do."""

    text: bool = True
    wifi: bool = True
    lte: bool = True
    lidar: bool = True
    """Without it no scan is matched; scans are still drawn, and turn signs to the walls they hang on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SlamConfig(_Checked):
    """The whole engine; it also reads the scanner's own data sheet (`lidar`)."""

    mode: str = _choice("cooperative", "off")
    """`off` runs no engine: poses come from odometry alone, maps stay empty, nobody is ever merged."""
    oracle: str = _choice("none", "starts", "poses")
    """What the engine is told of the truth, to compare with systems that are: `starts`, the robots' relative starts, so
    that all share one frame from the first step; `poses`, that and perfect odometry (`odometry.drift` becomes 0), which
    is then believed as it is: no scan is matched, no closure sought."""
    resolution_m: float = _number(0.1, 0.02, 0.5)
    """Cell size of the merged map."""
    cues: CuesConfig = field(default_factory=CuesConfig)
    odometry_filter: OdometryFilterConfig = field(default_factory=OdometryFilterConfig)
    local_map: LocalMapConfig = field(default_factory=LocalMapConfig)
    keyframe: KeyframeConfig = field(default_factory=KeyframeConfig)
    place_recognition: PlaceRecognitionConfig = field(default_factory=PlaceRecognitionConfig)
    verification: VerificationConfig = field(default_factory=VerificationConfig)
    pose_graph: PoseGraphConfig = field(default_factory=PoseGraphConfig)
    merging: MergingConfig = field(default_factory=MergingConfig)
    radio_slam: RadioSlamConfig = field(default_factory=RadioSlamConfig)
    k_visibility: KVisibilityConfig = field(default_factory=KVisibilityConfig)


@dataclass(frozen=True, slots=True, kw_only=True)
class ObservationConfig(_Checked):
    """What a learner sees: which blocks, and their shapes. `ExplorationEnv` describes each."""

    kind: str = _choice("dict", "flat")
    """`flat` joins all blocks, in the order below, to one vector of float32 (uint8 channels scaled to [0, 1])."""
    lidar: bool = True
    map: bool = True
    overview: bool = False
    pose: bool = True
    wifi: bool = True
    signs: bool = True
    team: bool = True
    frontiers: bool = False
    """Always there when the action is the choice of a frontier."""
    map_cells: int = _number(64, 8, 512)
    map_cell_m: float = _number(0.25, 0.05, 5.0)
    overview_cells: int = _number(32, 8, 512)
    """Rows and columns of the whole merged map, shrunk to fit."""
    path_m: float = _number(100.0, 0.0, 10_000.0)
    """Length of the robot's own path that `map` shows."""
    wifi_slots: int = _number(16, 1, 512)
    sign_slots: int = _number(4, 1, 64)
    sign_memory_s: float = _number(5.0, 0.0, 3600.0)
    """Readings stay among the recent ones for so long."""
    frontier_period_s: float = _number(1.0, 0.01, 60.0)
    """How often `frontiers` is worked out anew when nothing is decided on it (it costs a path search)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionConfig(_Checked):
    """What an agent commands, and how long one decision lasts."""

    kind: str = _choice("velocity", "waypoint", "frontier")
    """`velocity` decides every time step; the other two are driven by the environment until they are over."""
    timing: str = _choice("synchronous", "asynchronous")
    """A step of `waypoint` and `frontier` ends when all robots are done, or as soon as one is."""
    frontier_slots: int = _number(8, 1, 64)
    waypoint_reach_m: float = _number(5.0, 0.5, 100.0)
    """The goal that an action of length 1 stands for."""
    decision_max_s: float = _number(10.0, 0.1, 600.0)
    """A step never lasts longer."""
    stay_s: float = _number(1.0, 0.1, 60.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class RewardConfig(_Checked):
    """Weights of the named terms of `twc_env.exploration.rewards`; the default pays only for rightly mapped floor."""

    period_steps: int = _number(10, 1, 10000)
    """The team is judged this often, and always at the last step."""
    sharing: str = _choice("team", "individual")
    """Whose map and place the first three terms look at."""
    coverage: float = _number(1.0, -1000.0, 1000.0)
    merge: float = _number(0.0, -1000.0, 1000.0)
    localisation: float = _number(0.0, -1000.0, 1000.0)
    collision: float = _number(0.0, -1000.0, 1000.0)
    """Negative to discourage, as for the next two."""
    time: float = _number(0.0, -1000.0, 1000.0)
    bytes: float = _number(0.0, -1000.0, 1000.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class EnvConfig(_Checked):
    """One episode's worth of settings."""

    map: str = "twin-01"
    """A bundled map ("twin-01"), a generated building ("gen:office:800:7", "train/0007") or a file: twc_env or
    HouseExpo JSON, ROS map_server yaml, png, pgm or GeoJSON."""
    robots: int = _number(3, 1, 64)
    max_cycles: int = _number(2000, 1, 10_000_000)
    building: BuildingConfig = field(default_factory=BuildingConfig)
    dynamics: DynamicsConfig = field(default_factory=DynamicsConfig)
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    lidar: LidarConfig = field(default_factory=LidarConfig)
    radio: RadioConfig = field(default_factory=RadioConfig)
    signs: SignsConfig = field(default_factory=SignsConfig)
    link: LinkConfig = field(default_factory=LinkConfig)
    failure: FailureConfig = field(default_factory=FailureConfig)
    slam: SlamConfig = field(default_factory=SlamConfig)
    observation: ObservationConfig = field(default_factory=ObservationConfig)
    action: ActionConfig = field(default_factory=ActionConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)


RADIO_PRESETS: dict[str, dict] = {
    "twc": {},
    "sfw": {
        "power_at_1m_dbm": -29.0,
        "path_loss_exponent": 1.25,
        "wall_loss_scale": 0.85,
        "shadowing_std_db": 3.0,
        "shadowing_length_m": 0.5,
        "fading_std_db": 0.0,
        "noise_std_db": 3.0,
        "power_spread_db": 0.0,
        "device_offset_std_db": 0.0,
    },
    "radio-indoor": {
        "scan_period_s": 2.0,
        "power_at_1m_dbm": -31.8,
        "path_loss_exponent": 2.2,
        "wall_loss_scale": 0.88,
        "shadowing_std_db": 4.8,
        "shadowing_length_m": 19.0,
        "fading_std_db": 5.1,
        "fading_shared": True,
        "noise_std_db": 2.4,
        "device_offset_std_db": 2.0,
        "device_sensitivity_std_db": 2.5,
        "access_point_spread_db": 6.0,
        "detection_floor_dbm": -93.0,
        "miss_probability": 0.02,
        "floor_loss_db": 17.8,
        "floor_loss_further_db": 14.0,
        "high_band": {
            "share": 0.5,
            "power_offset_db": -5.0,
            "path_loss_exponent": 2.07,
            "wall_loss_factor": 1.54,
            "floor_loss_factor": 1.75,
        },
    },
    "radio-mall": {
        "scan_period_s": 2.0,
        "power_at_1m_dbm": -27.5,
        "path_loss_exponent": 3.52,
        "wall_loss_scale": 1.32,
        "shadowing_std_db": 3.18,
        "shadowing_length_m": 8.37,
        "fading_std_db": 3.46,
        "fading_shared": True,
        "noise_std_db": 1.0,
        "device_offset_std_db": 2.99,
        "device_sensitivity_std_db": 3.51,
        "access_point_spread_db": 9.0,
        "detection_floor_dbm": -89.0,
        "detection_slope_db": 1.07,
        "miss_probability": 0.0186,
        "floor_loss_db": 30.0,
        "floor_loss_further_db": 9.0,
        "sweep_share": 0.754,
        "sweep_share_std": 0.431,
        "sweep_duration_s": 2.09,
        "stale_age_max_s": 30.3,
        "high_band": {
            "share": 0.416,
            "power_offset_db": 2.55,
            "path_loss_exponent": 1.6,
            "wall_loss_factor": 2.48,
            "floor_loss_factor": 2.0,
            "detection_offset_db": -1.0,
        },
    },
    "radio-semi-indoor": {
        "scan_period_s": 2.0,
        "power_at_1m_dbm": -59.3,
        "path_loss_exponent": 3.6,
        "wall_loss_scale": 4.5,
        "shadowing_std_db": 3.8,
        "shadowing_length_m": 8.0,
        "fading_std_db": 2.5,
        "fading_shared": True,
        "noise_std_db": 2.9,
        "device_offset_std_db": 1.0,
        "device_sensitivity_std_db": 3.5,
        "access_point_spread_db": 10.0,
        "detection_floor_dbm": -84.0,
        "detection_slope_db": 1.0,
        "miss_probability": 0.55,
        "high_band": {"share": 0.5, "path_loss_exponent": 2.17},
    },
    "radio-outdoor": {
        "scan_period_s": 2.0,
        "power_at_1m_dbm": -37.5,
        "path_loss_exponent": 3.4,
        "shadowing_std_db": 5.0,
        "shadowing_length_m": 12.0,
        "fading_std_db": 5.5,
        "fading_shared": True,
        "noise_std_db": 2.5,
        "device_offset_std_db": 1.0,
        "device_sensitivity_std_db": 3.1,
        "access_point_spread_db": 7.0,
        "detection_floor_dbm": -85.0,
        "miss_probability": 0.3,
        "high_band": {"share": 0.5, "path_loss_exponent": 3.5},
    },
    "lte": {
        "wifi": False,
        "scan_period_s": 2.0,
        "fading_std_db": 0.5,
        "fading_length_m": 1.0,
        "noise_std_db": 3.1,
        "device_offset_std_db": 1.0,
        "device_sensitivity_std_db": 2.0,
        "quantisation_db": 2.0,
        "miss_probability": 0.6,
        "cells": {
            "count": 90,
            "distance_max_m": 2180.0,
            "power_at_1m_dbm": 9.1,
            "path_loss_exponent": 3.83,
            "wall_loss_factor": 0.25,
            "shadowing_std_db": 3.6,
            "shadowing_length_m": 204.0,
        },
    },
}
"""What differs from the defaults, which are the preset `twc`."""


def radio_preset(name: str) -> RadioConfig:
    """Settings of the radio for one kind of place; ConfigError for an unknown name."""
    if name not in RADIO_PRESETS:
        known = ", ".join(RADIO_PRESETS)
        raise ConfigError(f"radio.preset must be one of {known}; got {name!r}{_did_you_mean(name, RADIO_PRESETS)}")
    return from_dict(RADIO_PRESETS[name], RadioConfig, "radio")


@lru_cache(maxsize=16)
def digest(config: EnvConfig) -> str:
    """Twelve hex digits that change if and only if a value changes."""
    text = json.dumps(dataclasses.asdict(config), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def to_dict(config: EnvConfig) -> dict:
    """Nested plain values, ready for JSON; `from_dict` reads it back."""
    return dataclasses.asdict(config)


def from_dict(values: dict, cls: type = EnvConfig, where: str = "config"):
    """Build a (nested) config from plain values; what is not named keeps its default.

    Raises ConfigError for an unknown key (with the nearest known one), a wrong type or a value out of range.
    """
    if not isinstance(values, dict):
        raise ConfigError(f"{where} must be a table of settings; got {values!r}")
    types = typing.get_type_hints(cls)
    arguments: dict = {}
    if cls is RadioConfig and "preset" in values:
        values = dict(values)
        values = _merged(dataclasses.asdict(radio_preset(values.pop("preset"))), values)
    for key, value in values.items():
        if key not in types:
            raise ConfigError(f"{where}.{key} is unknown{_did_you_mean(key, types)}")
        arguments[key] = _value(types[key], value, f"{where}.{key}")
    return cls(**arguments)


def load(path: str | Path) -> EnvConfig:
    """Read a TOML or JSON file that overrides the defaults it names."""
    path = Path(path)
    try:
        text = path.read_text()
        values = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except OSError as error:
        raise ConfigError(f"cannot read the config file {path}: {error.strerror}") from error
    except ValueError as error:
        raise ConfigError(f"{path} is not valid {path.suffix[1:].upper() or 'TOML'}: {error}") from error
    return from_dict(values)


def override(config: EnvConfig, assignments: dict[str, object]) -> EnvConfig:
    """A copy with dotted keys replaced: `override(config, {"lidar.beam_count": 360})`.

    Values given as text are read as the type of the field, so they can come straight from a command line.
    """
    values = to_dict(config)
    for dotted, value in assignments.items():
        if dotted == "radio.preset":
            values["radio"] = dataclasses.asdict(radio_preset(str(value)))
            continue
        node, parts = values, dotted.split(".")
        for depth, part in enumerate(parts):
            if not isinstance(node, dict) or part not in node:
                known = node if isinstance(node, dict) else ()
                raise ConfigError(f"config.{'.'.join(parts[: depth + 1])} is unknown{_did_you_mean(part, known)}")
            if depth < len(parts) - 1:
                node = node[part]
        node[parts[-1]] = _from_text(value, node[parts[-1]], dotted)
    return from_dict(values)


def _value(kind: type, value, where: str):
    if dataclasses.is_dataclass(kind):
        return value if isinstance(value, kind) else from_dict(value, kind, where)
    if kind is float and type(value) is int:
        return float(value)
    if type(value) is not kind:
        raise ConfigError(f"{where} must be of type {kind.__name__}; got {value!r}")
    return value


def _merged(base: dict, changes: dict) -> dict:
    """`base` with the (nested) values that `changes` names."""
    merged = dict(base)
    for key, value in changes.items():
        nested = isinstance(value, dict) and isinstance(base.get(key), dict)
        merged[key] = _merged(base[key], value) if nested else value
    return merged


def _from_text(value, old, where: str):
    if not isinstance(value, str) or isinstance(old, str):
        return value
    if isinstance(old, bool):
        if value.lower() in ("true", "false"):
            return value.lower() == "true"
        raise ConfigError(f"config.{where} must be true or false; got {value!r}")
    try:
        return type(old)(value)
    except (TypeError, ValueError):
        raise ConfigError(f"config.{where} must be of type {type(old).__name__}; got {value!r}") from None


def _did_you_mean(key, known) -> str:
    near = difflib.get_close_matches(str(key), list(known), n=1)
    return f"; did you mean {near[0]!r}?" if near else f"; known are {', '.join(known)}" if known else ""
