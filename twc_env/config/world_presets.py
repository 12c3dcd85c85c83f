"""Effects of reality by type of place, composed of the settings of the world; counts fit about 800 m2."""

from __future__ import annotations

WORLD_PRESETS: dict[str, dict[str, object]] = {
    "clean": {},
    # Many sit, some walk; door plates repeat; partitions of glass.
    "office": {
        "people.count": 12,
        "people.walking_share": 0.4,
        "people.sitting_share": 0.45,
        "lidar.range_noise_std_m": 0.02,
        "lidar.dropout_probability": 0.02,
        "lidar.glass_return_probability": 0.6,
        "building.sign_duplication": 0.2,
    },
    # A crowd that walks, shop windows, and radio as measured in a mall.
    "mall": {
        "people.count": 30,
        "people.walking_share": 0.8,
        "people.sitting_share": 0.1,
        "lidar.range_noise_std_m": 0.02,
        "lidar.dropout_probability": 0.05,
        "lidar.glass_return_probability": 0.3,
        "radio.preset": "radio-mall",
    },
    # People who walk and lie or sit in equal parts; staff lift a robot out of their way every twenty minutes.
    "ward": {
        "people.count": 20,
        "people.walking_share": 0.5,
        "people.sitting_share": 0.4,
        "lidar.range_noise_std_m": 0.02,
        "lidar.dropout_probability": 0.05,
        "failure.kidnaps_per_min": 0.05,
    },
    # Few people, rows of shelves with repeated labels, and robots that slip in turns.
    "warehouse": {
        "people.count": 4,
        "people.walking_share": 1.0,
        "lidar.range_noise_std_m": 0.02,
        "lidar.dropout_probability": 0.02,
        "building.sign_duplication": 0.5,
        "odometry.platform": "skid-steer",
    },
}
"""Settings, by dotted name, that differ from the defaults."""
