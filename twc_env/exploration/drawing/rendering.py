"""Draw the state of an episode as an RGB image: ground truth, estimated maps, robots and loop closures.

Ground truth is grey. Estimated maps lie over it: floor white (tinted per group while the team has several maps), walls
dark. A disc is a robot's true pose, a ring its estimated pose; people are yellow discs with a dark rim. Violet lines
are accepted closures, dashed ones rejected; new ones are bold, and rejected ones fade out. The signal overlay shows the
RSSI of the strongest access point, from dark violet (weak) to yellow (strong).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.exploration.drawing import palette
from twc_env.exploration.drawing.primitives import (
    OUTSIDE,
    draw_line,
    draw_path,
    draw_ring,
    paint_field,
    raise_to_strokes,
)
from twc_env.exploration.drawing.smooth_map import BORDER, KNOWN_LEVEL, known_field, wall_strokes
from twc_env.kernels.compiled import kernel
from twc_env.records.geometry import inverse, transform_points
from twc_env.records.messages import GridMap

WIDTH_MAX_PX, HEIGHT_MAX_PX = 960, 820
PIXELS_PER_METRE_MAX = 36.0
MARGIN_M = 0.8
COLOURS = np.array([palette.rgb(colour) for colour in palette.ROBOTS], np.uint8)
"""(colours, 3) of robots 0, 1, ... and of groups, by their first robot."""
_UNKNOWN, _TRUE_WALL, _FLOOR, _WALL = map(
    palette.rgb, (palette.UNKNOWN, palette.TRUE_WALL, palette.FLOOR, palette.WALL)
)
CLOSURE = palette.rgb(palette.CLOSURE)
PERSON, PERSON_RADIUS_M = palette.rgb(palette.PERSON), 0.2
_ROBOT_RADIUS_M = 0.2
FRESH_S = 5.0
"""Time for which a closure is drawn as new."""
_OLD_ACCEPTED = 0.3
_DASH_PX = 5.0
_SIGNAL = np.array([palette.rgb(colour) for colour in palette.SIGNAL])
SIGNAL_OPACITY = 0.45


@dataclass(frozen=True, slots=True, eq=False)
class ClosureLine:
    """A loop closure to draw."""

    ends_m: Array
    """(2, 2) estimated positions of its two keyframes, in the building frame."""
    is_accepted: bool
    age_s: float
    """Time since it was accepted or rejected."""


@dataclass(frozen=True, slots=True, eq=False)
class SignalLayer:
    """RSSI of the strongest access point."""

    share: Array
    """(rows, columns) RSSI scaled to [0, 1], NaN off the floor; row 0 is the lowest y."""
    origin_m: Array
    """(2,) lower left corner of share[0, 0]."""
    cell_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Contents of a picture; all poses and points are in the building frame."""

    walls: Array
    """(rows, columns) bool, the true walls; row 0 is the lowest y."""
    origin_m: Array
    """(2,) lower left corner of walls[0, 0]."""
    resolution_m: float
    grids: tuple[GridMap, ...] = ()
    """One estimated map per group, the largest group first."""
    pose_building_map: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(groups, 3) alignment of each group's map with the building."""
    true_poses: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(robots, 3)."""
    estimated_poses: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(robots, 3); NaN for a robot that uses none of these maps."""
    groups: tuple[tuple[int, ...], ...] = ()
    """Robots of each group; a group's floor is tinted like its first robot. Empty: one map, no tint."""
    trails_m: tuple[Array, ...] = ()
    """Per robot (k, 2) its latest true positions, oldest first."""
    robot_radii_m: tuple[float, ...] = ()
    """Of each robot; empty: 0.2 m."""
    closures: tuple[ClosureLine, ...] = ()
    signal: SignalLayer | None = None
    people_m: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """(people, 2) true positions."""
    things_m: Array = field(default_factory=lambda: np.zeros((0, 4)))
    """(k, 4) true ends of door leaves and of the sides and legs of furniture."""
    shown_m: Array | None = None
    """(2, 2) lower left and upper right corner of what is shown at least; None: the building and a margin."""


@kernel
def _paint_floor(image, left, top, metres, walls, wall_x, wall_y, wall_cell):
    """Fill the image with ground truth; its upper left corner is at (left, top) [m], a pixel is `metres` wide."""
    height, width, _ = image.shape
    rows, columns = walls.shape
    for v in range(height):
        row = int(math.floor((top - (v + 0.5) * metres - wall_y) / wall_cell))
        for u in range(width):
            column = int(math.floor((left + (u + 0.5) * metres - wall_x) / wall_cell))
            is_wall = 0 <= row < rows and 0 <= column < columns and walls[row, column]
            for k in range(3):
                image[v, u, k] = _TRUE_WALL[k] if is_wall else _UNKNOWN[k]


@kernel
def _paint_known(image, left, top, metres, known, grid_x, grid_y, cell, pose_map_building, floor):
    """Paint known space, the field `known` interpolated linearly, over the image; its edge is as wide as a pixel."""
    height, width, _ = image.shape
    rows, columns = known.shape
    c, s = math.cos(pose_map_building[2]), math.sin(pose_map_building[2])
    sharpness = 1.5 * cell / metres
    for v in range(height):
        y = top - (v + 0.5) * metres
        for u in range(width):
            x = left + (u + 0.5) * metres
            across = (pose_map_building[0] + c * x - s * y - grid_x) / cell + BORDER - 0.5
            up = (pose_map_building[1] + s * x + c * y - grid_y) / cell + BORDER - 0.5
            column, row = int(math.floor(across)), int(math.floor(up))
            if row < 0 or column < 0 or row + 1 >= rows or column + 1 >= columns:
                continue
            f, g = across - column, up - row
            below = known[row, column] + f * (known[row, column + 1] - known[row, column])
            above = known[row + 1, column] + f * (known[row + 1, column + 1] - known[row + 1, column])
            cover = min(1.0, max(0.0, 0.5 + sharpness * (below + g * (above - below) - KNOWN_LEVEL)))
            for k in range(3):
                image[v, u, k] += cover * (floor[k] - image[v, u, k])


@kernel
def _paint_signal(image, left, top, metres, share, layer_x, layer_y, cell):
    """Tint the floor by signal strength; dark pixels (estimated walls) are left as they are."""
    height, width, _ = image.shape
    rows, columns = share.shape
    steps = _SIGNAL.shape[0] - 1
    for v in range(height):
        row = int(math.floor((top - (v + 0.5) * metres - layer_y) / cell))
        for u in range(width):
            column = int(math.floor((left + (u + 0.5) * metres - layer_x) / cell))
            if row < 0 or column < 0 or row >= rows or column >= columns or math.isnan(share[row, column]):
                continue
            if image[v, u, 0] < 100.0:
                continue
            at = share[row, column] * steps
            k0 = min(int(at), steps - 1)
            for k in range(3):
                colour = _SIGNAL[k0, k] + (at - k0) * (_SIGNAL[k0 + 1, k] - _SIGNAL[k0, k])
                image[v, u, k] += SIGNAL_OPACITY * (colour - image[v, u, k])


def building_box_m(origin_m: Array, walls: Array, resolution_m: float) -> Array:
    """(2, 2) lower left and upper right corner of a building of these walls, and of a margin around it."""
    size_m = np.array(walls.shape[::-1]) * resolution_m
    return np.array([origin_m - MARGIN_M, origin_m + size_m + MARGIN_M])


def view_of(scene: Scene) -> tuple[tuple[int, int], tuple[float, float, float]]:
    """(height, width) of the picture in pixels; x and y [m] of its upper left corner, and the width of a pixel [m].

    What is shown besides the building changes the scale, but not the size of the picture.
    """
    box_m = building_box_m(scene.origin_m, scene.walls, scene.resolution_m)
    size_m = np.ptp(box_m, axis=0)
    scale = float(min(WIDTH_MAX_PX / size_m[0], HEIGHT_MAX_PX / size_m[1], PIXELS_PER_METRE_MAX))
    width, height = (max(1, round(v * scale)) for v in size_m)
    if scene.shown_m is None:
        return (height, width), (float(box_m[0, 0]), float(box_m[1, 1]), 1.0 / scale)
    metres = float(np.max(np.ptp(scene.shown_m, axis=0) / (width, height)))
    left, top = scene.shown_m.mean(axis=0) + 0.5 * metres * np.array([-width, height])
    return (height, width), (float(left), float(top), metres)


def render(scene: Scene) -> Array:
    """The picture (height, width, 3) uint8 with +y up, at most `WIDTH_MAX_PX` wide and `HEIGHT_MAX_PX` high."""
    (height, width), view = view_of(scene)
    image = np.empty((height, width, 3))
    walls = np.ascontiguousarray(scene.walls, dtype=bool)
    _paint_floor(image, *view, walls, float(scene.origin_m[0]), float(scene.origin_m[1]), float(scene.resolution_m))
    for k in range(len(scene.grids) - 1, -1, -1):  # the largest group is painted last, on top
        _paint_estimate(image, view, scene, k)
    if scene.signal is not None:
        x, y = float(scene.signal.origin_m[0]), float(scene.signal.origin_m[1])
        _paint_signal(image, *view, scene.signal.share, x, y, float(scene.signal.cell_m))
    _paint_closures(image, view, scene)
    _paint_things(image, view, scene)
    _paint_people(image, view, scene)
    _paint_robots(image, view, scene)
    return image.astype(np.uint8)


def _paint_estimate(image: Array, view: tuple, scene: Scene, group: int) -> None:
    grid = scene.grids[group]
    floor = palette.tinted_floor(scene.groups[group][0]) if len(scene.groups) > 1 else _FLOOR
    pose_building_map = np.asarray(scene.pose_building_map, float)[group]
    x, y = float(grid.origin_m[0]), float(grid.origin_m[1])
    known, cell = known_field(grid.log_odds), float(grid.resolution_m)
    _paint_known(image, *view, known, x, y, cell, inverse(pose_building_map), floor)
    strokes = wall_strokes(grid.log_odds)
    for first in (0, 2):
        ends_m = strokes[:, first : first + 2] * cell + np.asarray(grid.origin_m)
        strokes[:, first : first + 2] = to_pixels(transform_points(pose_building_map, ends_m), view)
    strokes[:, 4] *= cell / view[2]
    field = np.full(image.shape[:2], OUTSIDE)
    raise_to_strokes(field, strokes)
    paint_field(image, field, _WALL)


def _paint_closures(image: Array, view: tuple, scene: Scene) -> None:
    """Draw closures, oldest first, so that new ones are on top."""
    for line in sorted(scene.closures, key=lambda line: -line.age_s):
        freshness = max(0.0, 1.0 - line.age_s / FRESH_S)
        first, last = to_pixels(line.ends_m, view)
        half_width = 0.8 + 1.0 * freshness
        if line.is_accepted:
            opacity = _OLD_ACCEPTED + (1.0 - _OLD_ACCEPTED) * freshness
            draw_line(image, *first, *last, half_width, CLOSURE, opacity)
            continue
        dashes = 1 + 2 * int(math.hypot(*(last - first)) / (2 * _DASH_PX))
        for k in range(0, dashes, 2):
            begin, end = first + (last - first) * k / dashes, first + (last - first) * (k + 1) / dashes
            draw_line(image, *begin, *end, half_width, CLOSURE, freshness)


def to_pixels(points_m: Array, view: tuple) -> Array:
    """(k, 2) points in the building frame -> (k, 2) pixels, u to the right, v down."""
    left, top, metres = view
    points_m = np.asarray(points_m, float)
    return np.column_stack([(points_m[:, 0] - left) / metres - 0.5, (top - points_m[:, 1]) / metres - 0.5])


def _paint_things(image: Array, view: tuple, scene: Scene) -> None:
    for ends in to_pixels(np.asarray(scene.things_m, float).reshape(-1, 2), view).reshape(-1, 4).tolist():
        draw_line(image, *ends, 0.7, _TRUE_WALL, 1.0)


def _paint_people(image: Array, view: tuple, scene: Scene) -> None:
    radius = max(PERSON_RADIUS_M / view[2], 3.0)
    for u, v in to_pixels(np.asarray(scene.people_m, float).reshape(-1, 2), view):
        draw_line(image, u, v, u, v, radius, PERSON, 0.9)
        draw_ring(image, u, v, radius, 0.6, _WALL)


def sizes_of(scene: Scene) -> tuple[float, ...]:
    """Radius of each robot [m]."""
    shown = scene.true_poses, scene.estimated_poses, scene.trails_m
    return scene.robot_radii_m or (_ROBOT_RADIUS_M,) * max(len(each) for each in shown)


def _paint_robots(image: Array, view: tuple, scene: Scene) -> None:
    radii = [max(size_m / view[2], 3.5) for size_m in sizes_of(scene)]
    for robot, trail in enumerate(scene.trails_m):
        if len(trail) > 1:
            draw_path(image, to_pixels(trail, view), max(0.9, 0.28 * radii[robot]), _colour(robot), 0.15)
    for robot, pose in enumerate(np.asarray(scene.estimated_poses, float).reshape(-1, 3)):
        if np.isnan(pose[0]):
            continue
        radius = radii[robot]
        (u, v), ahead = to_pixels(pose[None, :2], view)[0], 1.9 * radius
        tip_u, tip_v = u + ahead * math.cos(pose[2]), v - ahead * math.sin(pose[2])
        draw_ring(image, u, v, 1.25 * radius, 0.8, _colour(robot))
        draw_line(image, u, v, tip_u, tip_v, 0.8, _colour(robot), 1.0)
    for robot, pose in enumerate(np.asarray(scene.true_poses, float).reshape(-1, 3)):
        radius, (u, v) = radii[robot], to_pixels(pose[None, :2], view)[0]
        draw_line(image, u, v, u, v, radius, _colour(robot), 1.0)
        tip_u, tip_v = u + 0.75 * radius * math.cos(pose[2]), v - 0.75 * radius * math.sin(pose[2])
        draw_line(image, u, v, tip_u, tip_v, max(0.6, 0.16 * radius), _FLOOR, 1.0)


def _colour(robot: int) -> Array:
    return palette.rgb(palette.robot_colour(robot))
