"""What agents see, command and are paid for, and the whole of an episode's settings."""

from __future__ import annotations

from dataclasses import dataclass, field

from twc_env.config.checks import Checked, choice, number
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


@dataclass(frozen=True, slots=True, kw_only=True)
class ObservationConfig(Checked):
    """What a learner sees: which blocks, and their shapes. `ExplorationEnv` describes each."""

    kind: str = choice("dict", "flat")
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
    map_cells: int = number(64, 8, 512)
    map_cell_m: float = number(0.25, 0.05, 5.0)
    overview_cells: int = number(32, 8, 512)
    """Rows and columns of the whole merged map, shrunk to fit; stable-baselines3's own network needs 36."""
    path_m: float = number(100.0, 0.0, 10_000.0)
    """Length of the robot's own path that `map` shows."""
    wifi_slots: int = number(16, 1, 512)
    sign_slots: int = number(4, 1, 64)
    sign_memory_s: float = number(5.0, 0.0, 3600.0)
    """Readings stay among the recent ones for so long."""
    frontier_period_s: float = number(1.0, 0.01, 60.0)
    """How often `frontiers` is worked out anew when nothing is decided on it (it costs a path search)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionConfig(Checked):
    """What an agent commands, and how long one decision lasts."""

    kind: str = choice("velocity", "waypoint", "frontier")
    """`velocity` decides every time step; the other two are driven by the environment until they are over."""
    timing: str = choice("synchronous", "asynchronous")
    """A step of `waypoint` and `frontier` ends when all robots are done, or as soon as one is."""
    frontier_slots: int = number(8, 1, 64)
    waypoint_reach_m: float = number(5.0, 0.5, 100.0)
    """The goal that an action of length 1 stands for."""
    decision_max_s: float = number(10.0, 0.1, 600.0)
    """A step never lasts longer."""
    stay_s: float = number(1.0, 0.1, 60.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class RewardConfig(Checked):
    """Weights of the named terms of `twc_env.exploration.rewards`; the default pays only for rightly mapped floor."""

    period_steps: int = number(10, 1, 10000)
    """The team is judged this often, and always at the last step."""
    sharing: str = choice("team", "individual")
    """Whose map and place the first three terms look at."""
    coverage: float = number(1.0, -1000.0, 1000.0)
    merge: float = number(0.0, -1000.0, 1000.0)
    localisation: float = number(0.0, -1000.0, 1000.0)
    collision: float = number(0.0, -1000.0, 1000.0)
    """Negative to discourage, as for the next two."""
    time: float = number(0.0, -1000.0, 1000.0)
    bytes: float = number(0.0, -1000.0, 1000.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class EnvConfig(Checked):
    """One episode's worth of settings."""

    map: str = "twin-01"
    """A bundled map ("twin-01"), a generated building ("gen:office:800:7", "train/0007") or a file: twc_env or
    HouseExpo JSON, ROS map_server yaml, png, pgm or GeoJSON."""
    robots: int = number(3, 1, ROBOTS_MAX)
    max_cycles: int = number(2000, 1, 10_000_000)
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
