"""Settings of laser scanners by model, from their data sheets.

Data sheets give a bound of the error more often than its standard deviation; of a precision (repeatability) of +- x, x
is taken as two standard deviations. None of them gives the divergence of all beams or the height of mounting: beams
without a divergence here have the one of the other scanner of their kind (triangulation, time of flight).
"""

from __future__ import annotations

import math

LIDAR_PRESETS: dict[str, dict] = {
    "ideal": {},
    # ROBOTIS e-Manual, TurtleBot3, appendix LDS-01: 120-3,500 mm, 300 rpm, 360 degrees by 1 degree, 1.8 kHz; precision
    # +- 10 mm below 500 mm and +- 3.5 % above, accuracy +- 15 mm and +- 5 %. Its range, of no surface
    # named, is taken as that of ordinary walls (of a white surface: 4.7 m).
    "lds-01": {
        "beam_count": 360,
        "range_min_m": 0.12,
        "range_max_m": 3.5,
        "rate_hz": 5.0,
        "is_rolling": True,
        "range_noise_std_m": 0.005,
        "range_noise_per_m": 0.0175,
        "detection_range_m": 4.7,
        "beam_divergence_rad": 0.006,
    },
    # Slamtec, RPLIDAR A1M8 data sheet, figure 2-1: 0.15-12 m on white objects, 5.5 Hz (1-10 Hz) with 360 samples;
    # resolution < 0.5 mm below 1.5 m, < 1 % of the distance at all ranges. The head turns clockwise.
    "rplidar-a1": {
        "beam_count": 360,
        "range_min_m": 0.15,
        "range_max_m": 12.0,
        "rate_hz": 5.5,
        "is_rolling": True,
        "is_clockwise": True,
        "range_noise_std_m": 0.002,
        "range_noise_per_m": 0.005,
        "detection_range_m": 12.0,
        "beam_divergence_rad": 0.006,
    },
    # Hokuyo, UTM-30LX specification: 0.1-30 m, 270 degrees by 0.25 degrees, 25 ms a scan; repeated accuracy
    # sigma < 10 mm below 10 m and < 30 mm below 30 m.
    "utm-30lx": {
        "beam_count": 1081,
        "field_of_view_rad": math.radians(270.0),
        "range_min_m": 0.1,
        "range_max_m": 30.0,
        "rate_hz": 40.0,
        "is_rolling": True,
        "range_noise_std_m": 0.01,
        "range_noise_per_m": 0.001,
        "detection_range_m": 30.0,
        "beam_divergence_rad": 0.0044,
    },
    # SICK, LMS 200 technical description: 180 degrees by 1 degree in 13.3 ms, 75 Hz; 10 m at 10 % reflectivity;
    # statistical error (1 sigma) 5 mm, systematic error +- 15 mm, resolution 10 mm, together 10 mm. Cone and mixed
    # pixels: Ye and Borenstein, Characterization of a 2-D laser scanner for mobile robot obstacle negotiation, ICRA
    # 2002.
    "lms-200": {
        "beam_count": 181,
        "field_of_view_rad": math.pi,
        "range_max_m": 30.0,
        "rate_hz": 75.0,
        "is_rolling": True,
        "range_noise_std_m": 0.01,
        "detection_range_m": 30.0,
        "beam_divergence_rad": 0.0044,
    },
    # Livox, Mid-360 user manual: 360 degrees, 0.1 m (blind zone) to 40 m at 10 % reflectivity and 70 m at 80 %, 10 Hz;
    # range error 1 sigma 2 cm at 10 m. Of its 200,000 points a second in space, one slice of a beam per degree, swept
    # once in a frame.
    "mid-360": {
        "beam_count": 360,
        "range_min_m": 0.1,
        "range_max_m": 40.0,
        "rate_hz": 10.0,
        "is_rolling": True,
        "range_noise_std_m": 0.02,
        "detection_range_m": 70.0,
        "beam_divergence_rad": 0.0044,
    },
}
"""Differences from the defaults, which are the preset `ideal`."""
