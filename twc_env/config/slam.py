"""Settings of the SLAM engine, in the order of a step."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from twc_env.config.checks import Checked, choice, later, number

EARLIER_SESSION = "earlier-session"
"""Begins `SlamConfig.prior` where the map is that of an earlier session in the environment."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryFilterConfig(Checked):
    """Noise assumptions of a robot's EKF.

    The defaults suit odometry and gyro with `odometry.drift` 1. For better sensors (`drift` 0.1), reduce noise, scale
    and bias accordingly; otherwise scan matches with few or noisy beams degrade a pose that odometry knows better.
    """

    backend: str = choice("compiled", "filterpy")
    """Two implementations of the same equations: a compiled kernel, or filterpy's ExtendedKalmanFilter (reference;
    about 20 x slower, and without the check for robots that are carried or whose odometry misreads)."""
    position_std_per_m: float = number(0.04, 0.0, 1.0)
    position_std_m: float = number(0.002, 0.0, 1.0)
    """Per step, independent of the motion."""
    turn_std_rad: float = number(0.003, 0.0, 1.0)
    """Gyro heading noise per step."""
    odometry_turn_std_rad: float = number(0.02, 1e-6, 1.0)
    """Odometry heading noise per step."""
    odometry_scale_std: float = number(0.03, 0.0, 0.5)
    """Prior standard deviation of the odometry's scale error, as a fraction (0: scale is not estimated)."""
    gyro_bias_std_rad_s: float = number(0.02, 0.0, 1.0)
    """Initial standard deviation of the gyro bias."""
    gyro_bias_walk_rad_s: float = number(1e-4, 0.0, 1.0)
    match_std_m: float = number(0.04, 1e-4, 1.0)
    """Standard deviation of one beam's distance to the local map."""
    match_correlation: float = number(8.0, 1.0, 1000.0)
    """Number of neighbouring beams that count as one independent measurement."""
    match_gate: float = number(16.27, 1.0, 1e9)
    """Gate on the squared Mahalanobis distance between match and prediction (99.9 % quantile of chi squared). A match
    beyond it is rejected unless it explains clearly more of the scan than the prediction: then the robot slipped."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalMapConfig(Checked):
    """The local map around a robot, to which its scans are matched."""

    size_m: float = number(40.0, 4.0, 200.0)
    resolution_m: float = number(0.1, 0.02, 0.5)
    memory_m: float = number(25.0, 1.0, 1000.0)
    """When the local map is redrawn around a new centre, keyframes further back along the path are dropped."""
    match_distance_max_m: float = number(0.5, 0.1, 2.0)
    match_iterations_max: int = number(10, 1, 100)
    degenerate_share: float = number(0.02, 0.0, 1.0)
    """A direction constrained by fewer than this share of the beams (such as a corridor's axis) is left to odometry."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyframeConfig(Checked):
    """When a robot creates a keyframe, and what goes into it."""

    distance_m: float = number(0.7, 0.05, 10.0)
    """A keyframe is created at this distance from the previous one ..."""
    turn_rad: float = number(1.0, 0.05, math.pi)
    """... or after turning by this much ..."""
    distance_new_m: float = number(0.4, 0.05, 10.0)
    """... or at this distance (and a rotation reduced in proportion) if the scan shows something new, that is if"""
    explained_min: float = number(0.98, 0.0, 1.0)
    """fewer than this share of its beams end near walls of the local map."""
    still_s: float = number(0.0, 0.0, 3600.0, is_later=True)
    """A robot that stands creates one after this time as well, so that its map notices doors that open (0: never)."""
    mask_teammates: bool = True
    """Ignore beams that hit something with the shape and size of a robot (`dynamics.robot_radius_m`)."""
    fingerprint_window_s: float = number(2.0, 0.1, 60.0)
    fingerprint_scans_max: int = number(12, 1, 200)
    fingerprint_detection_min: float = number(0.4, 0.0, 1.0)
    """Minimum share of the scans in the window in which a transmitter must be heard."""
    fingerprint_age_max_s: float = number(4.0, 0.0, 3600.0)
    """Repeated readings older than this are ignored, as they were received elsewhere."""
    std_mode: str = choice("population", "sample", "paper")
    """Definition of the spread used to reject outliers (TWC-SLAM Eq. 7); `paper` is the published formula, which never
    rejects anything."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceRecognitionConfig(Checked):
    """Place recognition between keyframes. The thresholds are those of TWC-SLAM's Algorithm 1 (papers.md T4-T9)."""

    recogniser: str = choice("twc", "text", "wifi", "lidar", "fused", or_class=True)
    """`twc`: Algorithm 1; `text`, `wifi`: its two parts; `lidar`: scan similarity; `fused`: log-odds over all cues;
    FILE.py:CLASS: your own (docs/library.md)."""
    text_similarity_min: float = number(0.8, 0.0, 1.0)
    """alpha."""
    mac_similarity_min: float = number(0.8, 0.0, 1.0)
    """beta."""
    rssi_similarity_min: float = number(0.8, 0.0, 1.0)
    """gamma."""
    rssi_tolerance_db: float = number(5.0, 0.1, 50.0)
    """tau: root mean square RSSI difference that still counts as the same place."""
    rssi_mode: str = choice(
        "saturating", "paper", "linear", "saturating-sum", "inverse", "inverse-rms", "exponential", "range",
        "cosine", "cosine-rounded", "cosine-raw",
    )  # fmt: skip
    """Interpretation of Eq. 10 (`slam.rssi_similarity`); `paper` accepts if the distance d >= gamma, as published."""
    normalise_text: bool = True
    scan_similarity_min: float = number(0.7, 0.0, 1.0)
    """For `lidar`."""
    log_odds_min: float = number(3.0, -50.0, 50.0)
    """For `fused`; 3 corresponds to a probability of 95 %."""
    revisit_travel_m: float = number(12.0, 0.0, 1000.0)
    """Minimum path length between two keyframes of one robot for a loop closure."""
    proximity_m: float = number(2.5, 0.0, 50.0)
    """Keyframes closer than this in the current estimate are also loop candidates (0: never)."""
    spares_missing_cues: bool = True
    """With `twc`: a robot without a sign reading for a long time is compared by WiFi alone, one without WiFi for a long
    time by signs alone. Off: both cues are always required, as in TWC-SLAM."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VerificationConfig(Checked):
    """Verification of loop candidates by scan matching."""

    method: str = choice("point-to-line", "point-to-point", "fitness")
    """`point-to-line`: matching to wall lines, with a search if the initial guess is not close enough;
    `point-to-point`: ICP as in TWC-SLAM (Eq. 11-12), from the initial guess only; `fitness`: the same, accepted by the
    rule of radio SLAM (papers.md R12) instead of overlap and contradiction."""
    window_m: float = number(0.6, 0.1, 10.0)
    window_rad: float = number(0.15, 0.01, math.pi)
    cloud_reach_m: float = number(3.0, 0.0, 20.0)
    """Scans of keyframes within this path length are added to the candidate's scan."""
    overlap_min: float = number(0.65, 0.0, 1.0)
    """Minimum share of source points within 0.15 m of a target wall."""
    contradiction_max: float = number(0.12, 0.0, 1.0)
    """Maximum share of source points in the target's free space, or vice versa."""
    backlog_per_step: int = number(2, 1, 1000)
    """Candidates verified per step, or a 32nd of the queue if that is more; the others wait."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseGraphConfig(Checked):
    """Robust pose-graph optimisation in SE(2)."""

    robust: str = choice("ours", "plain", "dcs", "cauchy", "gnc", "pcm", or_class=True)
    """How loop closures are accepted: `ours` evaluates the evidence of groups of closures and keeps revising the
    decision, `plain` accepts all (TWC-SLAM); see `twc_env.slam.pose_graph.robust_back_end`. FILE.py:CLASS: your own
    (docs/library.md)."""
    robust_scale: float = number(5.0, 0.01, 1000.0)
    period_steps: int = number(10, 1, 10000)
    """Minimum interval between optimisations, which also require new closures."""
    iterations_max: int = number(15, 1, 1000)


@dataclass(frozen=True, slots=True, kw_only=True)
class MergingConfig(Checked):
    """When two robots' maps are merged into one frame."""

    enabled: bool = True
    """If off, robots never share a map."""
    closures_min: int = number(3, 1, 100)
    """Minimum number of mutually consistent closures; one if robots saw each other (`mutual_observations_check`)."""
    spread_min_m: float = number(1.5, 0.0, 100.0)
    """Minimum distance between the signs behind the closures (0: one sign is enough)."""
    signs_read_alike_min: int = number(1, 0, 100)
    """Minimum number of these signs that both robots read identically (0: none; recognition alone decides)."""
    consistency_m: float = number(0.6, 0.01, 10.0)
    consistency_rad: float = number(0.15, 0.01, math.pi)
    contradiction_max: float = number(0.10, 0.0, 1.0)
    """Maximum share of one map's walls that lie in the other's free space."""
    wifi_check: bool = True
    """Check all fingerprints that a merge would bring together against the variation along each robot's own path."""
    mutual_observations_check: bool = True
    """Check that robots see each other's bodies in laser scans when and where a merge implies it; where they did at ten
    keyframes, one closure by a sign is enough. Needs robots that move at the same time (`slam.keyframe.mask_teammates`,
    laser cue)."""
    undo: bool = True
    """Re-examine merges as evidence accumulates, and undo those found to be wrong."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioSlamConfig(Checked):
    """SLAM from radio fingerprints (`twc_env.slam.radio.radio_slam`)."""

    online: bool = False
    """Add radio constraints to the pose graph (`slam.radio_constraints`); always on without the laser cue."""
    weighting: str = choice("ours", "paper")
    """`paper` follows the publication literally: every similar pair has full weight, distances come from Eq. 3."""
    similarity: str = choice("shifted", "raw", "linear")
    similarity_min: float = number(0.7, 0.0, 1.0)
    """theta_s."""
    apart_m: float = number(20.0, 0.0, 1000.0)
    """Minimum path length between two places of one path for a closure (`paper`: 100 m)."""
    bin_width: float = number(0.05, 0.001, 1.0)
    """r of Eq. 3."""
    window_wifi_m: float = number(60.0, 1.0, 10_000.0)
    """The similarity model is trained on pairs within this path length (papers.md R5)."""
    window_lte_m: float = number(150.0, 1.0, 10_000.0)
    smoothing_wifi_m: float = number(5.0, 0.0, 100.0)
    """Scans within this path length are averaged into one fingerprint."""
    smoothing_lte_m: float = number(15.0, 0.0, 100.0)
    spacing_m: float = number(3.0, 0.1, 100.0)
    """Path length between places of the graph; increased on long paths to keep at most `places_max`."""
    places_max: int = number(600, 10, 100_000)
    cell_m: float = number(6.0, 0.1, 100.0)
    """Only the strongest closure between two path segments of this length is kept."""
    closures_per_place: int = number(3, 1, 1000)
    trail_places_max: int = number(400, 50, 100_000)
    """Maximum number of places in the incremental version, `radio_trail`."""
    trail_period_m: float = number(30.0, 1.0, 10_000.0)
    """Path length between two of its optimisations."""
    robust_scale: float = number(2.0, 0.1, 1000.0)
    """Cauchy kernel: residual, in standard deviations, at which a closure has half its weight."""
    position_std_per_m: float = number(0.03, 0.0, 1.0)
    """Odometry noise over one metre; grows with the square root of the path length."""
    heading_std_per_m: float = number(0.002, 0.0, 1.0)
    heading_std_per_rad: float = number(0.004, 0.0, 1.0)
    """Heading noise over a turn of one radian."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KVisibilityConfig(Checked):
    """A separate wall map estimated from signal strength (`Belief.radio_map`), and its signal model."""

    enabled: bool = False
    """Also adds the observation block `radio`: probably free and probably wall, from radio alone."""
    power_at_1m_dbm: float = number(-35.0, -80.0, 30.0)
    path_loss_exponent: float = number(2.3, 0.0, 6.0)
    wall_loss_db: float = number(6.0, 0.5, 40.0)
    noise_std_db: float = number(4.0, 0.1, 20.0)
    located_from_dbm: float = number(-48.0, -120.0, 30.0)
    """RSSI above which a transmitter was passed closely enough to be localised."""
    are_transmitters_known: bool = False
    """Give the engine the true transmitter positions, as inverse k-visibility assumes: an oracle, for comparison."""
    period_scans: int = number(10, 1, 10_000)
    """Number of scans between updates of the map."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CuesConfig(Checked):
    """Which cues the engine may use for localisation, in any combination; see `twc_env.slam.cues`."""

    text: bool = True
    wifi: bool = True
    lte: bool = True
    lidar: bool = True
    """If off, scans are not matched; they are still drawn into the map and used to align signs with their walls."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SlamConfig(Checked):
    """The SLAM engine; it also uses the scanner's specification (`lidar`)."""

    mode: str = choice("cooperative", "off", "localisation")
    """`off`: no SLAM; poses come from odometry alone, maps stay empty and robots are never merged. `localisation`: the
    map is `prior`, which does not change; robots only find their poses in it."""
    oracle: str = choice("none", "starts", "poses")
    """Ground truth given to the engine, for comparison with systems that have it. `starts`: the robots' relative start
    poses, so all share one frame from the first step. `poses`: also perfect odometry (`odometry.drift` becomes 0),
    which is used as is, without scan matching or loop closures."""
    resolution_m: float = number(0.1, 0.02, 0.5)
    """Cell size of the merged map."""
    prior: str = later("")
    """File of a map saved in an earlier session (`--save`, docs/lasting_maps.md): robots start anywhere in it, find it
    as they find each other, and go on with it. With mode `localisation` also the .yaml of a ROS map. In an environment
    also `earlier-session:STEPS`: the map of one robot that explored the same building for so many time steps."""
    undoes_rolling: bool = later(True)
    """Whether scans whose beams were measured one after the other are undone by odometry and gyro; false shows what
    that is worth."""
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
