"""Settings of the building, the robots, their sensors and their radio, in the order of a step."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from twc_env.config.checks import Checked, choice, later, number
from twc_env.config.range_noise import RangeNoise
from twc_env.errors import ConfigError
from twc_env.records.scanner import DARK_REFLECTIVITY, WHITE_REFLECTIVITY, Scanner

ROBOTS_MAX = 64
"""Largest team."""
TYPICAL_RANGE_M = 3.4
"""Root mean square of the default scanner's ranges in the test buildings: for the noise that the engine expects."""
CIRCLE_BEAMS_MIN, CIRCLE_BEAMS_MAX = 8, 360
"""Limits of `LidarConfig.circle_beam_count` for scanners other than the default kind; more directions cost the engine
time and give it nothing: neighbouring beams of finer scanners hit the same walls."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BuildingConfig(Checked):
    """How many of the map's signs and access points are kept, which controls the difficulty of place recognition; and
    glass.

    What is kept keeps its place, access points also their addresses, power and shadowing. Only the errors of single
    readings and scans are sampled anew, as they are drawn sign after sign and address after address."""

    sign_share: float = number(1.0, 0.0, 1.0)
    sign_duplication: float = number(0.0, 0.0, 1.0)
    """Share of the signs whose text duplicates that of a few others."""
    access_point_share: float = number(1.0, 0.0, 1.0)
    glass_share: float = number(0.0, 0.0, 1.0, is_later=True)
    """Share of the walls with floor on both sides that are glass, beside those that the map says are. They weaken
    signals as before; `lidar.glass_return_probability`, which must be below 1, says how many beams they return."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DynamicsConfig(Checked):
    """Motion model of a robot: a disc with differential drive."""

    time_step_s: float = number(0.1, 0.01, 1.0)
    speed_max_m_s: float = number(1.0, 0.01, 5.0)
    turn_rate_max_rad_s: float = number(1.5, 0.01, 10.0)
    acceleration_max_m_s2: float = number(4.0, 0.1, 100.0)
    turn_acceleration_max_rad_s2: float = number(10.0, 0.1, 1000.0)
    robot_radius_m: float = number(0.2, 0.05, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryConfig(Checked):
    """Error model of odometry and gyro."""

    platform: str = choice("wheeled", "handheld", "legged", "skid-steer", "pioneer-intel")
    """Preset of the error model. `skid-steer` is a poorly calibrated robot; `pioneer-intel` drifts like the raw
    odometry of the Intel Research Lab log."""
    drift: float = number(1.0, 0.0, 10.0)
    """Multiplies every error of the platform's preset: 0 gives perfect odometry and gyro, 1 the preset."""
    variation: float = number(0.0, 0.0, 1.0, is_later=True)
    """Share of the variance of the systematic errors (scale, curl, turns, gyro bias) that comes and goes within an
    episode, over 20 to 200 s: tyres, floors and temperatures change. With 0 they are constant, as the engine's filter
    assumes of all but the gyro bias."""
    bumps_per_m: float = number(0.0, 0.0, 10.0, is_later=True)
    """Rate at which a wheel drives over something 1 cm high, such as a cable, which turns the robot by 0.44 degrees
    unseen by odometry (Borenstein and Feng, UMBmark, 1995)."""
    threshold_slip_m: float = number(0.0, 0.0, 0.5, is_later=True)
    """Way that wheels turn in vain in each doorway (root mean square; half of a normal distribution), beside one
    bump."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarConfig(Checked):
    """2D laser scanner. By default it sees all around at once: beam 0 points ahead, beams run counter-clockwise.

    Every setting from the field of view on is one error or limit of real scanners, off by default. `preset` in the
    lidar table of a config file, or `lidar.preset`, sets them as the data sheet of a scanner says: `ideal` (the
    defaults), `lds-01`, `rplidar-a1`, `utm-30lx`, `lms-200`, `mid-360` (docs/world.md); glass and dropout of a `world`
    stay."""

    beam_count: int = number(180, 8, 4096)
    """With fewer than 90 per circle, robots merge later."""
    range_max_m: float = number(10.0, 0.5, 100.0)
    range_noise_std_m: float = number(0.01, 0.0, 1.0)
    dropout_probability: float = number(0.0, 0.0, 1.0)
    """Probability that a beam that hits something returns nothing. The engine knows this value and does not take gaps
    of a few beams for free floor."""
    glass_return_probability: float = number(1.0, 0.0, 1.0)
    """Probability that a beam is returned by glass at normal incidence; 1 makes glass an ordinary wall. No generated or
    bundled building has glass without `building.glass_share`."""
    glass_incidence_max_rad: float = number(0.6, 0.01, math.pi / 2)
    """Angle of incidence at which that probability has fallen to 0; beyond it beams always pass through glass."""
    field_of_view_rad: float = number(2 * math.pi, 0.1, 2 * math.pi, is_later=True)
    """Angle from the first to the last beam, symmetric to the direction ahead of the scanner. On a full circle, beam 0
    points ahead and the last one stops one step before it."""
    is_clockwise: bool = later(False)
    """Whether beams run clockwise, from left to right."""
    mount_x_m: float = number(0.0, -1.0, 1.0, is_later=True)
    """Place of the scanner ahead of the robot's centre ..."""
    mount_y_m: float = number(0.0, -1.0, 1.0, is_later=True)
    """... and left of it,"""
    mount_yaw_rad: float = number(0.0, -math.pi, math.pi, is_later=True)
    """and the direction in which it looks, counter-clockwise from ahead."""
    range_min_m: float = number(0.0, 0.0, 5.0, is_later=True)
    """Nothing nearer gives a return."""
    rate_hz: float = number(0.0, 0.0, 1000.0, is_later=True)
    """Scans per second, rounded to whole time steps between scans; 0, or more than one per time step: one in each."""
    is_rolling: bool = later(False)
    """Whether beams are measured one after the other while the robot moves, in one turn of the scanner's mirror
    (1 / `rate_hz`, which must be set). The last beam is measured at the time of the frame."""
    range_noise_per_m: float = number(0.0, 0.0, 0.5, is_later=True)
    """Standard deviation of range noise per metre of range, in addition to `range_noise_std_m` (the root of the sum of
    squares)."""
    detection_range_m: float = number(0.0, 0.0, 1000.0, is_later=True)
    """Range at which a white surface facing the scanner is still detected; 0: everything within `range_max_m` is. It
    falls with the root of what a surface reflects: walls less than white ones, dark ones and grazing incidence far
    less."""
    dark_share: float = number(0.0, 0.0, 1.0, is_later=True)
    """Share of all surfaces that are dark, in patches of a metre; without `detection_range_m` they look like others."""
    beam_divergence_rad: float = number(0.0, 0.0, 0.1, is_later=True)
    """Angle of the cone of a beam. A cone that meets two surfaces, at an edge, measures a range between both (a mixed
    pixel)."""
    delay_s: float = number(0.0, 0.0, 0.5, is_later=True)
    """Age of a scan when its frame says that it was measured: the clocks of scanner and odometry differ by this, which
    the engine is not told."""
    mirror_probability: float = number(0.0, 0.0, 1.0, is_later=True)
    """Probability that a beam that meets a wall of material `mirror` measures what it sees in the mirror, as far away
    as the whole path is long; 0 makes mirrors ordinary walls."""

    @property
    def is_full_circle(self) -> bool:
        """Whether the last beam would meet the first."""
        return self.field_of_view_rad >= 2 * math.pi - 1e-9

    @property
    def scanner(self) -> Scanner | None:
        """The geometry of its scans; None: a full circle around the robot at one time, with a return from everything in
        range, which frames need not tell."""
        fields = self.__dataclass_fields__
        names = (
            "is_clockwise",
            "mount_x_m",
            "mount_y_m",
            "mount_yaw_rad",
            "range_min_m",
            "rate_hz",
            "is_rolling",
        )
        is_plain = self.is_full_circle and not self.detection_range_m
        if is_plain and all(getattr(self, name) == fields[name].default for name in names):
            return None
        gaps = self.beam_count if self.is_full_circle else self.beam_count - 1
        side = -1.0 if self.is_clockwise else 1.0
        step_rad = side * self.field_of_view_rad / gaps
        first_rad = 0.0 if self.is_full_circle else -0.5 * side * self.field_of_view_rad
        return Scanner(
            first_rad,
            step_rad,
            (self.mount_x_m, self.mount_y_m, self.mount_yaw_rad),
            self.range_min_m,
            self.range_max_m,
            self.detection_range_m * math.sqrt(DARK_REFLECTIVITY / WHITE_REFLECTIVITY) or math.inf,
            1.0 / self.rate_hz * (self.beam_count - 1) * abs(step_rad) / (2 * math.pi) if self.is_rolling else 0.0,
        )

    @property
    def range_noise(self) -> RangeNoise:
        """Noise of its ranges."""
        typical_range_m = min(TYPICAL_RANGE_M, 0.5 * self.range_max_m)
        return RangeNoise(self.range_noise_std_m, self.range_noise_per_m, typical_range_m)

    @property
    def circle_beam_count(self) -> int:
        """Directions of the full circle around the robot in which the engine holds scans."""
        scanner = self.scanner
        if scanner is None:
            return self.beam_count
        return min(max(round(2 * math.pi / abs(scanner.step_rad)), CIRCLE_BEAMS_MIN), CIRCLE_BEAMS_MAX)

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        if self.is_rolling and not self.rate_hz:
            raise ConfigError(
                "lidar.is_rolling is true and lidar.rate_hz 0: set the scans per second, in which a mirror turns once"
            )
        if self.range_min_m >= self.range_max_m:
            raise ConfigError(
                f"lidar.range_min_m is {self.range_min_m:g} and lidar.range_max_m {self.range_max_m:g}: the scanner "
                "would see nothing; the greatest range must be the longer one"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class HighBandConfig(Checked):
    """The 5 GHz band of the access points, relative to 2.4 GHz."""

    share: float = number(0.0, 0.0, 1.0)
    """Share of each access point's addresses at 5 GHz (spread evenly: with 0.5 every second one)."""
    power_offset_db: float = number(-3.0, -40.0, 40.0)
    """Power at 1 m relative to 2.4 GHz."""
    path_loss_exponent: float = number(2.5, 1.0, 6.0)
    wall_loss_factor: float = number(1.5, 0.0, 5.0)
    """Wall loss relative to 2.4 GHz for walls of unknown material; known materials have their own
    (`world.materials`)."""
    floor_loss_factor: float = number(1.5, 0.0, 5.0)
    detection_offset_db: float = number(0.0, -40.0, 40.0)
    """Added to `detection_floor_dbm`."""
    detection_slope_factor: float = number(1.0, 0.05, 20.0)
    """Multiplies `detection_slope_db`: interference at 2.4 GHz blurs the detection threshold, at 5 GHz it is sharp."""
    miss_probability_offset: float = number(0.0, -1.0, 1.0)
    """Added to `miss_probability`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CellConfig(Checked):
    """LTE cells on masts outside the building (papers.md R14-R15), three sectors per mast, in addition to WiFi."""

    count: int = number(0, 0, 1000)
    distance_min_m: float = number(150.0, 1.0, 100_000.0)
    """Masts are distributed uniformly over the area between these distances from the building's centre."""
    distance_max_m: float = number(1500.0, 1.0, 100_000.0)
    power_at_1m_dbm: float = number(-8.0, -80.0, 60.0)
    """Reference signal power (RSRP) on the axis of a sector, extrapolated to 1 m."""
    path_loss_exponent: float = number(3.5, 1.0, 6.0)
    wall_loss_factor: float = number(1.0, 0.0, 5.0)
    """Wall loss relative to 2.4 GHz for walls of unknown material."""
    shadowing_std_db: float = number(7.0, 0.0, 20.0)
    shadowing_length_m: float = number(40.0, 0.1, 1000.0)
    detection_floor_dbm: float = number(-118.0, -160.0, 0.0)
    listed_max: int = number(0, 0, 1000)
    """How many of the strongest cells a phone reports (its own and a few neighbours); 0: all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioConfig(Checked):
    """RSSI = P(1 m) - 10 n log10 d - wall losses + shadowing + fading + device offset + noise.

    Presets for other types of places: `radio_preset`, or `preset` in the radio table of a config file.
    """

    wifi: bool = True
    """Whether the plan's access points transmit (off for LTE only)."""
    scan_period_s: float = number(0.2, 0.01, 60.0)
    power_at_1m_dbm: float = number(-35.0, -80.0, 30.0)
    path_loss_exponent: float = number(2.3, 0.0, 6.0)
    distance_min_m: float = number(0.5, 0.01, 10.0)
    shadowing_std_db: float = number(2.0, 0.0, 20.0)
    shadowing_length_m: float = number(4.0, 0.1, 100.0)
    fading_std_db: float = number(1.5, 0.0, 20.0)
    """Small-scale fading, redrawn per transmitter whenever a robot has moved by `fading_length_m`."""
    fading_length_m: float = number(0.5, 0.01, 10.0)
    fading_shared: bool = False
    """All addresses of one transmitter (access point and band) share their fading."""
    device_offset_std_db: float = number(0.8, 0.0, 20.0)
    """Constant RSSI offset of a robot's receiver (standard deviation over robots)."""
    device_offset_db: float = number(0.0, -40.0, 40.0, is_later=True)
    """Mean of that offset: of all receivers, or in a mixed team of one robot's."""
    device_sensitivity_std_db: float = number(0.0, 0.0, 20.0)
    """Variation of the detection floor between receivers (standard deviation)."""
    noise_std_db: float = number(3.0, 0.0, 20.0)
    detection_floor_dbm: float = number(-88.0, -120.0, 0.0)
    """RSSI at which a signal is detected in half of the scans."""
    detection_slope_db: float = number(2.0, 0.05, 20.0)
    miss_probability: float = number(0.0, 0.0, 1.0)
    """Probability that a scan misses a transmitter regardless of its strength."""
    quantisation_db: float = number(1.0, 0.01, 10.0)
    power_spread_db: float = number(1.0, 0.0, 20.0)
    """Variation of power between the addresses of one access point (standard deviation)."""
    access_point_spread_db: float = number(0.0, 0.0, 20.0)
    """Variation of power between access points (standard deviation): model, mounting, antenna."""
    bssids_per_access_point: int = number(0, 0, 32)
    """Number of addresses per access point; 0: those of the plan."""
    wall_loss_scale: float = number(1.0, 0.0, 10.0)
    """Multiplies the plan's wall losses on all bands; at 2.2 a 4 dB partition attenuates like concrete."""
    wall_loss_limit_db: float = number(0.0, 0.0, 100.0)
    """Upper bound of the total wall loss: part of a signal reaches the receiver through doors and by reflection, this
    much weaker than in free space, so each further wall costs less (0: no bound)."""
    power_change_std_db: float = number(0.0, 0.0, 20.0, is_later=True)
    """Access points change their power every minute, each by itself, with this standard deviation around its own mean,
    as controllers of large networks do."""
    floor_loss_db: float = number(20.0, 0.0, 100.0)
    """Loss of the first ceiling between a robot and an access point on another storey."""
    floor_loss_further_db: float = number(10.0, 0.0, 100.0)
    """Loss of each further ceiling; less than the first because of indirect paths (ITU-R P.1238: 15 + 4 (n - 1) dB for
    offices)."""
    floor_loss_grazing_db: float = number(0.0, 0.0, 100.0)
    """Extra loss for oblique paths through ceilings: multiplied by 1 - cos(angle to the vertical)."""
    floor_height_m: float = number(4.0, 0.5, 20.0)
    sweep_share: float = number(1.0, 0.01, 1.0)
    """Share of the channels covered by one sweep, starting at a random one; on the others nothing is heard."""
    sweep_share_std: float = number(0.0, 0.0, 1.0)
    """Variation of that share between scans (standard deviation): phones abort sweeps."""
    sweep_duration_s: float = number(0.0, 0.0, 60.0)
    """Duration of a sweep over the channels, 2.4 GHz first, and hence the maximum age of its readings."""
    stale_age_max_s: float = number(0.0, 0.0, 3600.0)
    """Readings that a scan did not renew are repeated, with their age, until they are this old (0: never)."""
    high_band: HighBandConfig = field(default_factory=HighBandConfig)
    cells: CellConfig = field(default_factory=CellConfig)


@dataclass(frozen=True, slots=True, kw_only=True)
class SignsConfig(Checked):
    """The camera: which signs are in view, how legible they are, and how OCR reads them (docs/ocr.md)."""

    reader: str = choice("fast", "paddle", "simple")
    """`fast` samples from an error table measured with a real OCR, `paddle` runs that OCR on a rendered image of each
    sign (slow; extra `ocr`), `simple` uses the same two error probabilities for every sign."""
    period_s: float = number(0.5, 0.01, 60.0)
    range_max_m: float = number(4.0, 0.1, 50.0)
    field_of_view_rad: float = number(2.6, 0.1, 2 * math.pi)
    incidence_max_rad: float = number(1.05, 0.1, math.pi / 2)
    """Maximum angle between the line of sight and the sign's normal."""
    focal_length_px: float = number(740.0, 10.0, 100_000.0)
    """Pixels per radian: 740 spreads 1920 pixels over the field of view."""
    character_height_m: float = number(0.05, 0.002, 2.0)
    """Capital height of all signs."""
    height_min_px: float = number(5.0, 1.0, 1000.0)
    """Signs with a smaller capital height in the image are ignored."""
    exposure_s: float = number(0.005, 0.0, 1.0)
    """Exposure time, during which the robot's motion blurs the image."""
    robots_hide: bool = True
    """Whether other robots occlude letters."""
    bearing_noise_std_rad: float = number(0.01, 0.0, 0.5)
    range_noise_std_m: float = number(0.03, 0.0, 1.0)
    fragment_probability: float = number(0.07, 0.0, 1.0)
    """For `simple`: probability that a reading is a fragment (10 to 45 % of the characters)."""
    character_error_probability: float = number(0.03, 0.0, 1.0)
    """For `simple`: probability that a character is substituted, deleted or followed by an inserted one."""

    @property
    def legible_m(self) -> float:
        """Distance up to which signs are in view and their capitals high enough in the image."""
        return min(self.range_max_m, self.focal_length_px * self.character_height_m / self.height_min_px)


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkConfig(Checked):
    """Communication between robots: who reaches whom and what is sent. Lost messages are resent in the next step."""

    topology: str = choice("central", "peer")
    """`central`: one mapper that all robots reach from everywhere. `peer`: every robot has its own mapper, fed by its
    own keyframes and by all keyframes that robots in range hold (store and forward)."""
    loss_probability: float = number(0.0, 0.0, 0.99)
    """Probability that everything one robot sends to one receiver in a step is lost."""
    range_max_m: float = number(15.0, 0.0, 1e5)
    """For `peer`: communication range."""
    wall_range_m: float = number(0.0, 0.0, 1e5)
    """For `peer`: range lost per wall between two robots; set to `range_max_m` for line of sight only."""
    scan_on_request: bool = False
    """Keyframes are sent as pose, texts and fingerprint; a scan follows only when a mapper requests it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FailureConfig(Checked):
    """Simulated failures; none by default."""

    robots: int = number(0, 0, ROBOTS_MAX)
    """Number of robots, counted from the last, that fail permanently: no motion, sensing or communication."""
    robots_step: int = number(500, 0, 10_000_000)
    """Step at which they fail."""
    link_begin_step: int = number(0, 0, 10_000_000)
    """First step without any communication ..."""
    link_end_step: int = number(0, 0, 10_000_000)
    """... and first step with communication again."""
    device_offset_db: float = number(0.0, -40.0, 40.0)
    """Added to all RSSI readings of the last robot."""
    start_spread_s: float = number(0.0, 0.0, 3600.0, is_later=True)
    """Robots are switched on one after the other, at equal intervals, the last one this long after the first; before,
    they neither move, sense nor communicate."""
    start_s: float = number(0.0, 0.0, 3600.0, is_later=True)
    """A robot is switched on so long after that; each robot may have its own (docs/world.md, Mixed teams)."""
    frame_loss_probability: float = number(0.0, 0.0, 0.99, is_later=True)
    """Probability that a robot's frame never reaches its engine; the next one has the odometry since the last that
    did."""
    clock_offset_std_s: float = number(0.0, 0.0, 1e6, is_later=True)
    """Differences between the clocks of the robots (standard deviation) ..."""
    clock_skew_std_ppm: float = number(0.0, 0.0, 1e5, is_later=True)
    """... and between their rates; 20 to 50 ppm are usual of crystals."""
    kidnap_step: int = number(0, 0, 10_000_000, is_later=True)
    """Step before which the last robot, and no other, is lifted and put down elsewhere, unseen by its odometry (0:
    never). Nobody notices it with scans on request or without laser (docs/people.md)."""
    kidnaps_per_min: float = number(0.0, 0.0, 60.0, is_later=True)
    """Rate at which the same happens to each robot, at random times."""

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        if self.link_end_step < self.link_begin_step:
            raise ConfigError(
                f"failure.link_begin_step is {self.link_begin_step} and failure.link_end_step {self.link_end_step}: "
                "the link must be back after it was lost; set a later end"
            )
