"""What the building, the robots, their sensors and their radio are like; in the order of a step."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from twc_env.config.checks import Checked, choice, number

ROBOTS_MAX = 64
"""Of one team."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BuildingConfig(Checked):
    """What is left of the map's signs and access points: dials for how hard places are to recognise."""

    sign_share: float = number(1.0, 0.0, 1.0)
    sign_duplication: float = number(0.0, 0.0, 1.0)
    """Share of the signs whose text is taken from a few others."""
    access_point_share: float = number(1.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class DynamicsConfig(Checked):
    """How commands move a robot: a disc on differential wheels."""

    time_step_s: float = number(0.1, 0.01, 1.0)
    speed_max_m_s: float = number(1.0, 0.01, 5.0)
    turn_rate_max_rad_s: float = number(1.5, 0.01, 10.0)
    acceleration_max_m_s2: float = number(4.0, 0.1, 100.0)
    turn_acceleration_max_rad_s2: float = number(10.0, 0.1, 1000.0)
    robot_radius_m: float = number(0.2, 0.05, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryConfig(Checked):
    """How measured motion differs from true motion."""

    platform: str = choice("wheeled", "handheld", "legged", "skid-steer", "pioneer-intel")
    """`skid-steer` is a robot that was never calibrated well; `pioneer-intel` drifts as the raw odometry of the Intel
    Research Lab log does."""
    drift: float = number(1.0, 0.0, 10.0)
    """Multiplies every error of the platform's preset: 0 gives perfect odometry and gyro, 1 the preset."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarConfig(Checked):
    """2D laser scanner over the full circle; beam 0 points ahead, beams run counter-clockwise."""

    beam_count: int = number(180, 8, 4096)
    """With fewer than 90, robots merge later."""
    range_max_m: float = number(10.0, 0.5, 100.0)
    range_noise_std_m: float = number(0.01, 0.0, 1.0)
    dropout_probability: float = number(0.0, 0.0, 1.0)
    """Chance that a beam has no return though something is there. The engine knows it: gaps of a few beams are no floor
    to it."""
    glass_return_probability: float = number(1.0, 0.0, 1.0)
    """Chance that a glass wall hit head-on is seen; 1 makes glass a wall like any other."""
    glass_incidence_max_rad: float = number(0.6, 0.01, math.pi / 2)
    """From head-on to this angle of incidence the chance falls to nothing; beyond it a beam always passes glass."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HighBandConfig(Checked):
    """The 5 GHz band of the access points: how it differs from 2.4 GHz."""

    share: float = number(0.0, 0.0, 1.0)
    """Of each access point's addresses, sent at 5 GHz (spread evenly: 0.5 makes every second one)."""
    power_offset_db: float = number(-3.0, -40.0, 40.0)
    """Strength at 1 m against 2.4 GHz."""
    path_loss_exponent: float = number(2.5, 1.0, 6.0)
    wall_loss_factor: float = number(1.5, 0.0, 5.0)
    """Loss of a wall of no known material against 2.4 GHz; known materials have their own (`world.materials`)."""
    floor_loss_factor: float = number(1.5, 0.0, 5.0)
    detection_offset_db: float = number(0.0, -40.0, 40.0)
    """Added to `detection_floor_dbm`."""
    detection_slope_factor: float = number(1.0, 0.05, 20.0)
    """Times `detection_slope_db`: what crowds 2.4 GHz loses strong signals too, 5 GHz has an edge."""
    miss_probability_offset: float = number(0.0, -1.0, 1.0)
    """Added to `miss_probability`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CellConfig(Checked):
    """LTE cells on masts outside the building (papers.md R14-R15): three sectors per mast, heard beside the WiFi."""

    count: int = number(0, 0, 1000)
    distance_min_m: float = number(150.0, 1.0, 100_000.0)
    """Masts stand between these distances from the building's middle, evenly over the area."""
    distance_max_m: float = number(1500.0, 1.0, 100_000.0)
    power_at_1m_dbm: float = number(-8.0, -80.0, 60.0)
    """Reference signal strength in the middle of a sector, extrapolated to 1 m."""
    path_loss_exponent: float = number(3.5, 1.0, 6.0)
    wall_loss_factor: float = number(1.0, 0.0, 5.0)
    """Loss of a wall of no known material against 2.4 GHz."""
    shadowing_std_db: float = number(7.0, 0.0, 20.0)
    shadowing_length_m: float = number(40.0, 0.1, 1000.0)
    detection_floor_dbm: float = number(-118.0, -160.0, 0.0)
    listed_max: int = number(0, 0, 1000)
    """A phone lists its own cell and few neighbours: so many of the strongest it hears; 0 lists all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioConfig(Checked):
    """Radio strength: rssi = P(1 m) - 10 n log10 d - wall losses + shadowing + fading + device offset + noise.

    Named settings for other places come from `radio_preset`, or as `preset` in the radio table of a config file.
    """

    wifi: bool = True
    """Whether the plan's access points send at all (an LTE-only study turns them off)."""
    scan_period_s: float = number(0.2, 0.01, 60.0)
    power_at_1m_dbm: float = number(-35.0, -80.0, 30.0)
    path_loss_exponent: float = number(2.3, 0.0, 6.0)
    distance_min_m: float = number(0.5, 0.01, 10.0)
    shadowing_std_db: float = number(2.0, 0.0, 20.0)
    shadowing_length_m: float = number(4.0, 0.1, 100.0)
    fading_std_db: float = number(1.5, 0.0, 20.0)
    """Small-scale fading, redrawn for each transmitter whenever a robot has moved `fading_length_m`."""
    fading_length_m: float = number(0.5, 0.01, 10.0)
    fading_shared: bool = False
    """All addresses of one transmitter (access point and band) fade together, as one box's networks do."""
    device_offset_std_db: float = number(0.8, 0.0, 20.0)
    """How much louder or fainter one robot's receiver reads everything."""
    device_sensitivity_std_db: float = number(0.0, 0.0, 20.0)
    """How much the detection floor differs between receivers."""
    noise_std_db: float = number(3.0, 0.0, 20.0)
    detection_floor_dbm: float = number(-88.0, -120.0, 0.0)
    """A signal of this strength is heard in half of the scans."""
    detection_slope_db: float = number(2.0, 0.05, 20.0)
    miss_probability: float = number(0.0, 0.0, 1.0)
    """Chance that a scan misses a transmitter however strong it is."""
    quantisation_db: float = number(1.0, 0.01, 10.0)
    power_spread_db: float = number(1.0, 0.0, 20.0)
    """How much the addresses of one access point differ in power (standard deviation)."""
    access_point_spread_db: float = number(0.0, 0.0, 20.0)
    """How much access points differ in power: make, mounting, antenna."""
    bssids_per_access_point: int = number(0, 0, 32)
    """Addresses each access point sends under; 0 takes those of the plan."""
    wall_loss_scale: float = number(1.0, 0.0, 10.0)
    """Multiplies the plan's wall losses on all bands: thin partitions drawn as 4 dB become concrete at 2.2."""
    wall_loss_limit_db: float = number(0.0, 0.0, 100.0)
    """Some of a signal comes round the walls, by doors and reflections: this much fainter than in the open, so that
    further walls cost less and less and all together no more than this (0: nothing comes round)."""
    floor_loss_db: float = number(20.0, 0.0, 100.0)
    """Loss of the first ceiling between the robots and an access point of another storey."""
    floor_loss_further_db: float = number(10.0, 0.0, 100.0)
    """Loss of each further ceiling: other ways around add up (ITU-R P.1238 has 15 + 4 (n - 1) dB for offices)."""
    floor_loss_grazing_db: float = number(0.0, 0.0, 100.0)
    """More is lost the flatter the way through the ceilings: this times 1 - cos of the angle off the plumb line."""
    floor_height_m: float = number(4.0, 0.5, 20.0)
    sweep_share: float = number(1.0, 0.01, 1.0)
    """Share of the channels that one sweep comes to, from a random one on; what they hear keeps its last reading."""
    sweep_share_std: float = number(0.0, 0.0, 1.0)
    """How much that share differs from scan to scan: phones break sweeps off."""
    sweep_duration_s: float = number(0.0, 0.0, 60.0)
    """Channels are listened to one after the other over this long, 2.4 GHz first: readings are that old at most."""
    stale_age_max_s: float = number(0.0, 0.0, 3600.0)
    """Readings that a scan did not renew are repeated with their age until they are this old (0: never)."""
    high_band: HighBandConfig = field(default_factory=HighBandConfig)
    cells: CellConfig = field(default_factory=CellConfig)


@dataclass(frozen=True, slots=True, kw_only=True)
class SignsConfig(Checked):
    """The camera: which signs are in view, how well their letters show, and how OCR reads them."""

    reader: str = choice("fast", "paddle", "simple")
    """`fast` draws from the measured table, `paddle` runs a real OCR on a picture of each sign (slow; extra `ocr`),
    `simple` takes the same two probabilities for every sign."""
    period_s: float = number(0.5, 0.01, 60.0)
    range_max_m: float = number(4.0, 0.1, 50.0)
    field_of_view_rad: float = number(2.6, 0.1, 2 * math.pi)
    incidence_max_rad: float = number(1.05, 0.1, math.pi / 2)
    """Largest angle between the line of sight and the sign's normal."""
    focal_length_px: float = number(740.0, 10.0, 100_000.0)
    """Pixels per radian: 740 spreads 1920 pixels over the field of view."""
    character_height_m: float = number(0.05, 0.002, 2.0)
    """Height of the capitals on all signs."""
    height_min_px: float = number(5.0, 1.0, 1000.0)
    """Signs with lower capitals in the picture are not looked at."""
    exposure_s: float = number(0.005, 0.0, 1.0)
    """While it lasts, turning and passing by smear the picture."""
    robots_hide: bool = True
    """Whether other robots hide the letters behind them."""
    bearing_noise_std_rad: float = number(0.01, 0.0, 0.5)
    range_noise_std_m: float = number(0.03, 0.0, 1.0)
    fragment_probability: float = number(0.07, 0.0, 1.0)
    """Of `simple`: chance that a reading is a fragment (10 to 45 % of the characters)."""
    character_error_probability: float = number(0.03, 0.0, 1.0)
    """Of `simple`: chance that a character is changed, lost or doubled with another."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkConfig(Checked):
    """Radio between the robots: who hears whom, and what is sent; what is lost is sent again in the next step."""

    topology: str = choice("central", "peer")
    """`central`: all robots reach one mapper from everywhere; `peer`: every robot has its own mapper, fed by its own
    keyframes and by those that robots in range carry, their own and others' (store and forward)."""
    loss_probability: float = number(0.0, 0.0, 0.99)
    """Chance that all that one robot sends to one listener in one step is lost."""
    range_max_m: float = number(15.0, 0.0, 1e5)
    """Of `peer`: robots further apart do not hear each other."""
    wall_range_m: float = number(0.0, 0.0, 1e5)
    """Of `peer`: every wall between two robots shortens their range by so much; `range_max_m` leaves line of sight."""
    scan_on_request: bool = False
    """Keyframes travel as pose, texts and fingerprint; scans only follow where a mapper asks for them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FailureConfig(Checked):
    """What breaks. By default nothing does."""

    robots: int = number(0, 0, ROBOTS_MAX)
    """So many robots, the last of the team, stop for good: they stand still, sense nothing and say nothing more."""
    robots_step: int = number(500, 0, 10_000_000)
    """From this step on."""
    link_begin_step: int = number(0, 0, 10_000_000)
    """Nobody hears anybody from this step on ..."""
    link_end_step: int = number(0, 0, 10_000_000)
    """... until this one."""
    device_offset_db: float = number(0.0, -40.0, 40.0)
    """Added to all that the last robot's WiFi receiver hears."""
