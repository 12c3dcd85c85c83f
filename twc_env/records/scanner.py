"""Geometry of a laser scanner: where its beams start and point, when they are measured, and what no return means."""

from __future__ import annotations

import math
from dataclasses import dataclass

WHITE_REFLECTIVITY, WALL_REFLECTIVITY, DARK_REFLECTIVITY = 0.9, 0.5, 0.1
"""Share of light that surfaces reflect diffusely: of white paint, of ordinary walls, and of matt black cardboard (SICK
LMS 200 technical description, table of reflectivities: 10 % to 80 % for cardboard, wood, plastics and paper)."""


@dataclass(frozen=True, slots=True)
class Scanner:
    """How to read the ranges of a `SensorFrame` that names it. There, 0, NaN, infinite ranges, and those of at least
    `range_max_m` or below `range_min_m`, are beams without return; negative ones have no information."""

    first_rad: float = 0.0
    """Direction of beam 0 in the scanner's own frame."""
    step_rad: float = math.radians(1.0)
    """Angle from one beam to the next; negative if beams run clockwise."""
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Pose of the scanner in the robot frame [m, m, rad]."""
    range_min_m: float = 0.0
    range_max_m: float = math.inf
    free_m: float = math.inf
    """Range up to which every surface but the darkest would have given a return: without one, the floor is free up to
    there. Infinite: up to the maximum range; 0: a beam without return tells nothing."""
    sweep_s: float = 0.0
    """Time from the first beam to the last, which is measured at the time of the frame; 0: all at once."""
