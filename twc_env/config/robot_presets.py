"""Robots and teams by name, for mixed teams. Numbers are of the data sheets that are named; others are ours.

Of platforms without a sheet, `slam.odometry_filter` assumes by a third more noise than `odometry.platform` has, as its
defaults do of wheels.
"""

from __future__ import annotations

from typing import Any

ROBOT_PRESETS: dict[str, dict[str, Any]] = {
    "wheeled": {"odometry.platform": "wheeled"},
    # A person who walks with the device held ahead; disc as wide as shoulders.
    "handheld": {
        "odometry.platform": "handheld",
        "dynamics.speed_max_m_s": 1.2,
        "dynamics.robot_radius_m": 0.25,
        "slam.odometry_filter.position_std_per_m": 0.09,
        "slam.odometry_filter.turn_std_rad": 0.006,
        "slam.odometry_filter.odometry_scale_std": 0.06,
    },
    # Unitree Go2 data sheet: 0.70 m x 0.31 m standing. The disc has the mean of both as its diameter: it turns its
    # length into doors.
    "legged": {
        "odometry.platform": "legged",
        "dynamics.robot_radius_m": 0.25,
        "slam.odometry_filter.position_std_per_m": 0.065,
        "slam.odometry_filter.turn_std_rad": 0.0045,
        "slam.odometry_filter.odometry_scale_std": 0.045,
    },
    # Clearpath Jackal J100 data sheet: 0.508 m x 0.430 m, of which the disc is the circumscribed circle.
    "skid-steer": {
        "odometry.platform": "skid-steer",
        "dynamics.robot_radius_m": 0.33,
        "slam.odometry_filter.odometry_turn_std_rad": 0.05,
    },
    # ROBOTIS e-Manual, TurtleBot3 specifications: 0.22 m/s, 2.84 rad/s, 138 mm x 178 mm; scanner of its description
    # (turtlebot3_burger.urdf) 32 mm behind the centre.
    "turtlebot-burger": {
        "odometry.platform": "wheeled",
        "dynamics.speed_max_m_s": 0.22,
        "dynamics.turn_rate_max_rad_s": 2.84,
        "dynamics.robot_radius_m": 0.113,
        "lidar.preset": "lds-01",
        "lidar.mount_x_m": -0.032,
    },
    # The same: 0.26 m/s, 1.82 rad/s, 281 mm x 306 mm; scanner 64 mm behind the centre.
    "turtlebot-waffle": {
        "odometry.platform": "wheeled",
        "dynamics.speed_max_m_s": 0.26,
        "dynamics.turn_rate_max_rad_s": 1.82,
        "dynamics.robot_radius_m": 0.208,
        "lidar.preset": "lds-01",
        "lidar.mount_x_m": -0.064,
    },
    # TWC-SLAM (section IV-A): a MetaCam EDU held in the hand, wheeled and legged robots, each with a Livox Mid-360; a
    # telephone scans for access points. Scans are cut at 10 m, as the engine's maps of rooms take them.
    "twc-handheld": {"preset": "handheld", "lidar.preset": "mid-360", "lidar.range_max_m": 10.0},
    "twc-wheeled": {"preset": "wheeled", "lidar.preset": "mid-360", "lidar.range_max_m": 10.0},
    "twc-legged": {"preset": "legged", "lidar.preset": "mid-360", "lidar.range_max_m": 10.0},
}
"""Settings of one robot, by dotted name, that differ from those of the team; `preset` takes those of another."""
TEAM_PRESETS: dict[str, tuple[str, ...]] = {
    "twc-slam": ("twc-handheld", "twc-wheeled", "twc-legged"),
    "turtlebots": ("turtlebot-burger", "turtlebot-burger", "turtlebot-waffle"),
}
"""Robots of a team, by preset."""
