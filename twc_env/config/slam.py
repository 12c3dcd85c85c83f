"""What the SLAM engine does with what the robots sense; in the order of a step."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from twc_env.config.checks import Checked, choice, number


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryFilterConfig(Checked):
    """The EKF of one robot: what it assumes about its sensors.

    The defaults are for odometry and gyro as `odometry.drift` 1 has them. With better ones (`drift` 0.1), noises, scale
    and bias should be as much smaller: otherwise matches of few or noisy beams move a pose that odometry knows better.
    """

    backend: str = choice("compiled", "filterpy")
    """Same equations twice: a compiled kernel, or filterpy's ExtendedKalmanFilter (the oracle; about 20 x slower)."""
    position_std_per_m: float = number(0.04, 0.0, 1.0)
    position_std_m: float = number(0.002, 0.0, 1.0)
    """Per step, whatever the motion."""
    turn_std_rad: float = number(0.003, 0.0, 1.0)
    """Gyro heading noise per step."""
    odometry_turn_std_rad: float = number(0.02, 1e-6, 1.0)
    """Odometry heading noise per step."""
    odometry_scale_std: float = number(0.03, 0.0, 0.5)
    """By what share odometry may read distances too long or too short (0: it is believed)."""
    gyro_bias_std_rad_s: float = number(0.02, 0.0, 1.0)
    """How far off the gyro may be at the start."""
    gyro_bias_walk_rad_s: float = number(1e-4, 0.0, 1.0)
    match_std_m: float = number(0.04, 1e-4, 1.0)
    """Distance error of one beam against the local map."""
    match_correlation: float = number(8.0, 1.0, 1000.0)
    """This many neighbouring beams count as one independent measurement."""
    match_gate: float = number(16.27, 1.0, 1e9)
    """A match that contradicts the prediction by more (squared, by covariance; 99.9 % of chi squared) is left out, but
    where it explains clearly more of the scan than the prediction does: then the robot slipped."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalMapConfig(Checked):
    """The map around one robot that its scans are matched to."""

    size_m: float = number(40.0, 4.0, 200.0)
    resolution_m: float = number(0.1, 0.02, 0.5)
    memory_m: float = number(25.0, 1.0, 1000.0)
    """Keyframes further back along the path than this are left out when the local map moves on."""
    match_distance_max_m: float = number(0.5, 0.1, 2.0)
    match_iterations_max: int = number(10, 1, 100)
    degenerate_share: float = number(0.02, 0.0, 1.0)
    """A direction that fewer than this share of the beams fix is left to odometry (a corridor's axis)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyframeConfig(Checked):
    """When a robot remembers a place."""

    distance_m: float = number(0.7, 0.05, 10.0)
    """At the latest so far from the last remembered place ..."""
    turn_rad: float = number(1.0, 0.05, math.pi)
    """... or turned so far ..."""
    distance_new_m: float = number(0.4, 0.05, 10.0)
    """... or so far, or turned by as much less, where the scan shows something new:"""
    explained_min: float = number(0.98, 0.0, 1.0)
    """fewer of its beams than this share end near walls that the local map knows."""
    mask_mates: bool = True
    """Leave out beams that end on something as round and wide as a robot (`dynamics.robot_radius_m`)."""
    fingerprint_window_s: float = number(2.0, 0.1, 60.0)
    fingerprint_scans_max: int = number(12, 1, 200)
    fingerprint_detection_min: float = number(0.4, 0.0, 1.0)
    """A transmitter counts when heard in at least this share of the scans of the window."""
    fingerprint_age_max_s: float = number(4.0, 0.0, 3600.0)
    """Readings that a scan repeats from longer ago are left out: they were heard at another place."""
    std_mode: str = choice("population", "sample", "paper")
    """Spread used to clip scans (TWC-SLAM Eq. 7): `paper` is the literal print, which never rejects anything."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceRecognitionConfig(Checked):
    """Which keyframes look like one place. The thresholds are those of TWC-SLAM's Algorithm 1 (papers.md T4-T9)."""

    recogniser: str = choice("twc", "text", "wifi", "lidar", "fused", or_class=True)
    """`twc`: Algorithm 1; `text`, `wifi`: its halves; `lidar`: like scans; `fused`: all cues weighed as log-odds;
    FILE.py:CLASS: one of your own (docs/library.md)."""
    text_similarity_min: float = number(0.8, 0.0, 1.0)
    """alpha."""
    mac_similarity_min: float = number(0.8, 0.0, 1.0)
    """beta."""
    rssi_similarity_min: float = number(0.8, 0.0, 1.0)
    """gamma."""
    rssi_tolerance_db: float = number(5.0, 0.1, 50.0)
    """tau: rms difference that still counts as the same place."""
    rssi_mode: str = choice(
        "saturating", "paper", "linear", "saturating-sum", "inverse", "inverse-rms", "exponential", "range",
        "cosine", "cosine-rounded", "cosine-raw",
    )  # fmt: skip
    """Reading of Eq. 10 (`slam.rssi_similarity`); `paper` accepts when the distance d >= gamma, as printed."""
    normalise_text: bool = True
    scan_similarity_min: float = number(0.7, 0.0, 1.0)
    """Of `lidar`."""
    log_odds_min: float = number(3.0, -50.0, 50.0)
    """Of `fused`: 3 is 95 % sure."""
    revisit_travel_m: float = number(12.0, 0.0, 1000.0)
    """Two keyframes of one robot are a loop only when it travelled this far in between."""
    proximity_m: float = number(2.5, 0.0, 50.0)
    """Keyframes this near in the present estimate are tried too (0: never)."""
    spares_missing_cues: bool = True
    """With `twc`: a robot that long read no sign is compared by WiFi alone, one that long heard nothing by signs alone.
    Without it, and in TWC-SLAM, never."""
    meets_by_wifi: bool = False
    """With `twc`: robots that share no map are compared by WiFi alone too, wherever they are that both hear ten
    transmitters, and not only where both read a sign. They share one sooner; two of which scans do not fit are compared
    ever more rarely."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VerificationConfig(Checked):
    """Scan matching that accepts or refuses a loop candidate."""

    method: str = choice("point-to-line", "point-to-point")
    """`point-to-line`: matching to lines of walls, which searches where the guess is not near enough;
    `point-to-point`: ICP as TWC-SLAM prints it (Eq. 11-12), from the guess alone."""
    window_m: float = number(0.6, 0.1, 10.0)
    window_rad: float = number(0.15, 0.01, math.pi)
    cloud_reach_m: float = number(3.0, 0.0, 20.0)
    """Keyframes within this path length are joined to the candidate's scan."""
    overlap_min: float = number(0.65, 0.0, 1.0)
    """Share of source points within 0.15 m of a target wall."""
    contradiction_max: float = number(0.12, 0.0, 1.0)
    """Share of source points that lie in the target's free space, or the other way round."""
    backlog_per_step: int = number(2, 1, 1000)
    """Candidates verified per step; the others wait. Of very many a 32nd part is verified."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseGraphConfig(Checked):
    """Robust SE(2) optimisation."""

    robust: str = choice("ours", "plain", "dcs", "cauchy", "gnc", "pcm", or_class=True)
    """Which closures to believe: `ours` weighs groups of them by their evidence and keeps having second thoughts,
    `plain` believes all (TWC-SLAM); see `twc_env.slam.robust_backend`. FILE.py:CLASS: one of your own
    (docs/library.md)."""
    robust_scale: float = number(5.0, 0.01, 1000.0)
    period_steps: int = number(10, 1, 10000)
    """Optimised at most this often, and only when closures arrived."""
    iterations_max: int = number(15, 1, 1000)


@dataclass(frozen=True, slots=True, kw_only=True)
class MergingConfig(Checked):
    """When two robots' maps are put into one frame."""

    enabled: bool = True
    """Without it every robot stays alone."""
    closures_min: int = number(3, 1, 100)
    """Mutually consistent closures needed."""
    spread_min_m: float = number(1.5, 0.0, 100.0)
    """The closures must stem from signs at least this far apart (0: one sign is enough)."""
    signs_read_alike_min: int = number(1, 0, 100)
    """Of these signs so many must be read alike to the letter by both (0: however unlike, as recognition allows)."""
    consistency_m: float = number(0.6, 0.01, 10.0)
    consistency_rad: float = number(0.15, 0.01, math.pi)
    contradiction_max: float = number(0.10, 0.0, 1.0)
    """Largest share of one map's walls that lie in the other's free space."""
    wifi_check: bool = True
    """Compare all fingerprints that the merge would bring together with what each robot's own path taught."""
    undo: bool = True
    """Look at merges again when more is known, and take groups apart whose merge turns out to be wrong."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioSlamConfig(Checked):
    """SLAM from radio fingerprints: see `twc_env.slam.radio_slam`."""

    online: bool = False
    """Radio ties keyframes in the pose graph of an episode (`slam.radio_ties`); without laser among the cues always."""
    weighting: str = choice("ours", "paper")
    """`paper` is the literal print: every similar pair counts in full, distances come from Eq. 3 as printed."""
    similarity: str = choice("shifted", "raw", "linear")
    similarity_min: float = number(0.7, 0.0, 1.0)
    """theta_s."""
    apart_m: float = number(20.0, 0.0, 1000.0)
    """Two places of one path are a closure only when it is this long in between (`paper`: 100 m)."""
    bin_width: float = number(0.05, 0.001, 1.0)
    """r of Eq. 3."""
    window_wifi_m: float = number(60.0, 1.0, 10_000.0)
    """Pairs within this path length teach the model (papers.md R5)."""
    window_lte_m: float = number(150.0, 1.0, 10_000.0)
    smoothing_wifi_m: float = number(5.0, 0.0, 100.0)
    """Scans this near along the path are averaged into one fingerprint."""
    smoothing_lte_m: float = number(15.0, 0.0, 100.0)
    spacing_m: float = number(3.0, 0.1, 100.0)
    """Path length between places of the graph; longer on long paths, so that there are at most `places_max`."""
    places_max: int = number(600, 10, 100_000)
    cell_m: float = number(6.0, 0.1, 100.0)
    """Of all closures between two stretches this long the strongest is kept."""
    closures_per_place: int = number(3, 1, 1000)
    trail_places_max: int = number(400, 50, 100_000)
    """Places that `radio_trail`, which runs scan by scan, keeps at most."""
    trail_period_m: float = number(30.0, 1.0, 10_000.0)
    """Path length between two of its optimisations."""
    robust_scale: float = number(2.0, 0.1, 1000.0)
    """Cauchy: at this many standard deviations a closure has lost half of its weight."""
    position_std_per_m: float = number(0.03, 0.0, 1.0)
    """Odometry noise over one metre; it grows with the root of the path."""
    heading_std_per_m: float = number(0.002, 0.0, 1.0)
    heading_std_per_rad: float = number(0.004, 0.0, 1.0)
    """Heading noise over a turn of one radian."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KVisibilityConfig(Checked):
    """Walls from signal strength as a map of its own (`Belief.radio_map`), and what it assumes about signals."""

    enabled: bool = False
    """Also adds the block `radio` to observations: probably free and probably wall, from radio alone."""
    power_at_1m_dbm: float = number(-35.0, -80.0, 30.0)
    path_loss_exponent: float = number(2.3, 0.0, 6.0)
    wall_loss_db: float = number(6.0, 0.5, 40.0)
    noise_std_db: float = number(4.0, 0.1, 20.0)
    located_from_dbm: float = number(-48.0, -120.0, 30.0)
    """A transmitter heard at least this strongly was passed nearly enough to know where it stands."""
    are_transmitters_known: bool = False
    """The engine is told where all transmitters stand, as inverse k-visibility assumes: an oracle, for comparison."""
    period_scans: int = number(10, 1, 10_000)
    """The map is worked out anew after so many scans."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CuesConfig(Checked):
    """What the engine may place robots by; see `twc_env.slam.cues`. Any combination will do."""

    text: bool = True
    wifi: bool = True
    lte: bool = True
    lidar: bool = True
    """Without it no scan is matched; scans are still drawn, and turn signs to the walls they hang on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SlamConfig(Checked):
    """The whole engine; it also reads the scanner's own data sheet (`lidar`)."""

    mode: str = choice("cooperative", "off")
    """`off` runs no engine: poses come from odometry alone, maps stay empty, nobody is ever merged."""
    oracle: str = choice("none", "starts", "poses")
    """What the engine is told of the truth, to compare with systems that are: `starts`, the robots' relative starts, so
    that all share one frame from the first step; `poses`, that and perfect odometry (`odometry.drift` becomes 0), which
    is then believed as it is: no scan is matched, no closure sought."""
    resolution_m: float = number(0.1, 0.02, 0.5)
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
