"""Effects of reality by type of place, composed of the settings of the world; counts fit about 800 m2."""

from __future__ import annotations

WORLD_PRESETS: dict[str, dict[str, object]] = {
    "clean": {},
    "office": {
        "people.count": 12,
        "people.walking_share": 0.4,
        "people.sitting_share": 0.45,
        "lidar.range_noise_std_m": 0.02,
        "lidar.dropout_probability": 0.02,
        "lidar.glass_return_probability": 0.6,
        "building.sign_duplication": 0.2,
        "clutter.door_share": 0.5,
        "clutter.furniture": 20,
        "clutter.hidden_share": 0.1,
        "odometry.threshold_slip_m": 0.01,
    },
    "mall": {
        "people.count": 30,
        "people.walking_share": 0.8,
        "people.sitting_share": 0.1,
        "lidar.range_noise_std_m": 0.02,
        "lidar.dropout_probability": 0.05,
        "lidar.glass_return_probability": 0.3,
        "radio.preset": "radio-mall",
        "slam.place_recognition.recogniser": "fused",
        "clutter.furniture": 15,
        "clutter.moves_per_min": 0.1,
    },
    "ward": {
        "people.count": 20,
        "people.walking_share": 0.5,
        "people.sitting_share": 0.4,
        "lidar.range_noise_std_m": 0.02,
        "lidar.dropout_probability": 0.05,
        "failure.kidnaps_per_min": 0.05,
        "clutter.door_share": 0.8,
        "clutter.furniture": 20,
        "clutter.moves_per_min": 0.2,
        "odometry.threshold_slip_m": 0.01,
    },
    "warehouse": {
        "people.count": 4,
        "people.walking_share": 1.0,
        "lidar.range_noise_std_m": 0.02,
        "lidar.dropout_probability": 0.02,
        "building.sign_duplication": 0.5,
        "odometry.platform": "skid-steer",
        "odometry.bumps_per_m": 0.1,
        "clutter.furniture": 15,
        "clutter.hidden_share": 0.3,
        "clutter.moves_per_min": 0.1,
    },
}
"""Settings, by dotted name, that differ from the defaults."""
WORLD_PLACES = {
    "clean": "ideal scanners, and nothing moves but the robots",
    "office": "many sit, some walk; door plates repeat; partitions of glass, where a plan has them; every second "
    "doorway has a door that moves",
    "mall": "a crowd that walks, shop windows, where a plan has them, stands that are moved, and radio as measured in "
    "a mall: receivers differ by more than the fixed similarities of TWC-SLAM's Algorithm 1 allow; `fused` learns by "
    "how much",
    "ward": "people who walk and lie or sit in equal parts, doors that they open, beds and trolleys that they push; "
    "staff lift a robot out of their way every twenty minutes",
    "warehouse": "few people, rows of shelves with repeated labels, pallets that scanners do not see, and robots that "
    "slip in turns and drive over rubbish",
}
"""What each is like."""
