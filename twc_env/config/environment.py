"""Settings of observations, actions and rewards, and the complete settings of an episode."""

from __future__ import annotations

from dataclasses import dataclass, field

from twc_env.config.checks import Checked, choice, later, name_sections, number
from twc_env.config.clutter import ClutterConfig
from twc_env.config.people import PeopleConfig
from twc_env.config.robots import Overrides, overrides_of, sections_with
from twc_env.config.slam import SlamConfig
from twc_env.config.world import (
    ROBOTS_MAX,
    BuildingConfig,
    DynamicsConfig,
    FailureConfig,
    LidarConfig,
    LinkConfig,
    OdometryConfig,
    RadioConfig,
    SignsConfig,
)
from twc_env.errors import ConfigError


@dataclass(frozen=True, slots=True, kw_only=True)
class ObservationConfig(Checked):
    """Which observation blocks there are, and their shapes. `ExplorationEnv` describes each block."""

    kind: str = choice("dict", "flat")
    """`flat` concatenates all blocks, in the order below, to one float32 vector (uint8 channels scaled to [0, 1])."""
    lidar: bool = True
    map: bool = True
    overview: bool = False
    pose: bool = True
    wifi: bool = True
    signs: bool = True
    team: bool = True
    frontiers: bool = False
    """Always on with `action.kind = "frontier"`."""
    map_cells: int = number(64, 8, 512)
    """Rows and columns of `map` (and `radio`); the default CNN of stable-baselines3 needs at least 36."""
    map_cell_m: float = number(0.25, 0.05, 5.0)
    overview_cells: int = number(32, 8, 512)
    """Rows and columns of the merged map, downscaled to fit; the default CNN of stable-baselines3 needs at least 36."""
    path_m: float = number(100.0, 0.0, 10_000.0)
    """Length of the robot's own past path shown in `map`."""
    wifi_slots: int = number(16, 1, 512)
    sign_slots: int = number(4, 1, 64)
    sign_memory_s: float = number(5.0, 0.0, 3600.0)
    """How long a reading counts as recent."""
    frontier_period_s: float = number(1.0, 0.01, 60.0)
    """Update interval of `frontiers` while no decision depends on it (an update costs a path search)."""
    equal_shapes: bool = later(False)
    """In a team whose scanners have different numbers of beams, fill each `lidar` block with 0, which no scanner
    measures, up to the longest, so that agents may share a network; false: each agent has a space of its own."""
    gains: bool = later(False)
    """The unknown area that each of `frontiers` would show; needs that block."""
    other_maps: bool = later(False)
    """How far each of `frontiers` is from where robots of other maps are likely to have been, by the access points that
    both heard and by pending closures; needs that block."""
    time_left: bool = later(False)
    """The share of the episode's time that is left: what pays late in it differs from what pays early."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionConfig(Checked):
    """What an action means and how long it lasts."""

    kind: str = choice("velocity", "waypoint", "frontier")
    """`velocity`: one command per time step. `waypoint` and `frontier`: the environment drives until the goal is
    reached."""
    timing: str = choice("synchronous", "asynchronous", "in-turn")
    """With `waypoint` and `frontier`, a step ends when all robots have arrived, as soon as one has, or as soon as it is
    one robot's turn: each decides alone, when it has arrived or `decision_max_s` after its last decision."""
    frontier_slots: int = number(8, 1, 64)
    goals: str = choice("frontiers", "views", is_later=True)
    """What `frontier` actions choose from: the nearest `frontiers`, or the `views`, places on open floor and frontiers,
    that would show most unknown floor for the way there (docs/learning.md)."""
    reverses: bool = later(False)
    """Whether robots drive backwards to what lies behind them where `waypoint` and `frontier` actions drive them: those
    whose scanner sees all around, and that nobody carries in his hands."""
    waypoint_reach_m: float = number(5.0, 0.5, 100.0)
    """Distance of the goal for an action of length 1."""
    decision_max_s: float = number(10.0, 0.1, 600.0)
    """Maximum duration of a step; in turn, of a decision."""
    stay_s: float = number(1.0, 0.1, 60.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class RewardConfig(Checked):
    """Weights of the terms in `exploration/assessment/rewards.py`; by default only mapped floor is rewarded."""

    period_steps: int = number(10, 1, 10000)
    """How often the first three terms are evaluated; always at the last step."""
    sharing: str = choice("team", "individual")
    """Whether the first three terms refer to the team or to each robot's own map and localisation."""
    coverage: float = number(1.0, -1000.0, 1000.0)
    merge: float = number(0.0, -1000.0, 1000.0)
    localisation: float = number(0.0, -1000.0, 1000.0)
    collision: float = number(0.0, -1000.0, 1000.0)
    """Negative values penalise; also for the next two."""
    time: float = number(0.0, -1000.0, 1000.0)
    bytes: float = number(0.0, -1000.0, 1000.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeConfig(Checked):
    """How an episode begins and ends."""

    starts: str = choice("random", "entrance", "map", is_later=True)
    """Where robots start unless `reset` is told: `random`, scattered over the building; `entrance`, side by side at one
    place, as after entering by one door; `map`, at the map's own starts."""
    ends_at_coverage: float = number(0.0, 0.0, 1.0, is_later=True)
    """Share of the floor at which the episode ends as terminated, once the best correctly merged group has mapped it
    correctly (0: episodes last `max_cycles` time steps). Checked every `reward.period_steps` time steps."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EnvConfig(Checked):
    """All settings of an episode."""

    map: str = "twin-01"
    """A bundled map ("twin-01"), a generated building ("gen:office:800:7", "train/0007") or a file: twc_env or
    HouseExpo JSON, ROS map_server yaml, png, pgm or GeoJSON. A set of buildings ("gen:office+ward:2000:train") gives
    each episode one of them, drawn by its seed."""
    robots: int = number(3, 1, ROBOTS_MAX)
    robot: tuple[Overrides, ...] = later(())
    """For a mixed team a list with an entry for each robot: a preset ("handheld", "legged", "turtlebot-burger", ...) or
    a table with `preset`, `lidar.preset`, and what else of `dynamics`, `odometry`, `lidar`, `radio`, `signs` and
    `slam.odometry_filter` is the robot's own (docs/world.md). Empty: all robots are alike. Without `robots`, the list
    says how many there are. `team` is short for it: "twc-slam", or "handheld, wheeled, legged"."""
    max_cycles: int = number(2000, 1, 10_000_000)
    building: BuildingConfig = field(default_factory=BuildingConfig)
    dynamics: DynamicsConfig = field(default_factory=DynamicsConfig)
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    lidar: LidarConfig = field(default_factory=LidarConfig)
    radio: RadioConfig = field(default_factory=RadioConfig)
    signs: SignsConfig = field(default_factory=SignsConfig)
    link: LinkConfig = field(default_factory=LinkConfig)
    failure: FailureConfig = field(default_factory=FailureConfig)
    people: PeopleConfig = field(default_factory=PeopleConfig, metadata={"is_later": True})
    clutter: ClutterConfig = field(default_factory=ClutterConfig, metadata={"is_later": True})
    slam: SlamConfig = field(default_factory=SlamConfig)
    episode: EpisodeConfig = field(default_factory=EpisodeConfig)
    observation: ObservationConfig = field(default_factory=ObservationConfig)
    action: ActionConfig = field(default_factory=ActionConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        if self.failure.robots > self.robots:
            raise ConfigError(
                f"failure.robots is {self.failure.robots}, and robots is {self.robots}: set fewer to fail"
            )
        if not self.robot:
            object.__setattr__(self, "robot", ())
            return
        object.__setattr__(self, "robot", overrides_of(self.robot))
        if len(self.robot) != self.robots:
            raise ConfigError(
                f"robot lists {len(self.robot)} robots, and robots is {self.robots}: give one entry for each robot"
            )
        for k, overrides in enumerate(self.robot):
            sections_with(self, k, overrides)  # refuses values out of range


name_sections(EnvConfig)
