"""Content, geometry and run time of pictures."""

import time

import numpy as np
import pytest
from scipy import ndimage

from twc_env.exploration.drawing import palette
from twc_env.exploration.drawing.rendering import COLOURS, HEIGHT_MAX_PX, WIDTH_MAX_PX, Scene, render
from twc_env.maps import load_map
from twc_env.records.geometry import compose, inverse, transform_points
from twc_env.records.messages import GridMap

FLOOR, WALL, TRUE_WALL, UNKNOWN = (
    tuple(map(int, palette.rgb(colour))) for colour in (palette.FLOOR, palette.WALL, palette.TRUE_WALL, palette.UNKNOWN)
)


def hall(rows=100, columns=200):
    walls = np.zeros((rows, columns), bool)
    walls[[0, -1]] = True
    walls[:, [0, -1]] = True
    return walls


def estimate(walls, origin_m=(0.0, 0.0)):
    return GridMap(np.where(walls, 30, -8).astype(np.int16), np.array(origin_m), 0.1)


def pixel(image, x_m, y_m, size_m=(20.0, 10.0), margin_m=0.8):
    """The colour at a point of a building whose raster starts at (0, 0)."""
    height, width, _ = image.shape
    u = int((x_m + margin_m) / (size_m[0] + 2 * margin_m) * width)
    v = int((size_m[1] + margin_m - y_m) / (size_m[1] + 2 * margin_m) * height)
    return tuple(int(c) for c in image[v, u])


def test_ground_truth_is_grey():
    image = render(Scene(hall(), np.zeros(2), 0.1))
    assert pixel(image, 10, 5) == UNKNOWN
    assert pixel(image, 10, 0.05) == TRUE_WALL


def test_north_is_up_and_east_is_right():
    walls = np.zeros((100, 200), bool)
    walls[80:90, 20:30] = True
    image = render(Scene(walls, np.zeros(2), 0.1))
    v, u = np.argwhere((image == TRUE_WALL).all(axis=2)).mean(axis=0) / image.shape[:2]
    assert v < 0.3
    assert u < 0.3


def test_the_estimated_map_is_drawn_over_the_ground_truth():
    walls = hall()
    scene = Scene(walls, np.zeros(2), 0.1, (estimate(walls),), np.zeros((1, 3)))
    image = render(scene)
    assert pixel(image, 10, 5) == FLOOR
    assert pixel(image, 10, 0.05) == WALL
    assert pixel(image, -0.4, 5) == UNKNOWN


def test_a_map_in_another_frame_is_drawn_aligned_with_the_building():
    walls = hall()
    pose_building_map = np.array([20.0, 10.0, np.pi])
    image = render(Scene(walls, np.zeros(2), 0.1, (estimate(walls),), pose_building_map[None]))
    assert pixel(image, 10, 5) == FLOOR
    half_known = np.where(np.arange(200) < 100, -8, 0).astype(np.int16) * np.ones((100, 1), np.int16)
    image = render(Scene(walls, np.zeros(2), 0.1, (GridMap(half_known, np.zeros(2), 0.1),), pose_building_map[None]))
    assert pixel(image, 15, 5) == FLOOR
    assert pixel(image, 5, 5) == UNKNOWN


def test_groups_are_tinted_and_the_largest_is_on_top():
    walls = hall()
    grids = (estimate(walls), estimate(walls, (-30.0, 0.0)), estimate(np.zeros((10, 10), bool), (10.0, 5.0)))
    scene = Scene(walls, np.zeros(2), 0.1, grids, np.zeros((3, 3)), groups=((1, 2), (0,), (3,)))
    red, green, blue = pixel(render(scene), 10.5, 5.5)
    assert (red, green, blue) != FLOOR
    assert red > blue  # tinted like robot 1, which is orange


@pytest.mark.parametrize("robot", [0, 1, 2])
def test_a_robot_is_drawn_in_its_colour_at_its_pose(robot):
    poses = np.array([[4.0, 3.0, 0.0], [10.0, 6.0, 2.0], [16.0, 3.0, -1.0]])
    image = render(Scene(hall(), np.zeros(2), 0.1, true_poses=poses, estimated_poses=poses))
    behind = compose(poses[robot], [-0.1, 0.0, 0.0])
    assert np.abs(np.array(pixel(image, *behind[:2])) - COLOURS[robot]).max() <= 8


def test_a_trail_fades_toward_its_beginning():
    trail = np.column_stack([np.linspace(2, 18, 160), np.full(160, 5.0)])
    image = render(Scene(hall(), np.zeros(2), 0.1, trails_m=(trail,)))
    old, new = (np.abs(np.array(pixel(image, x, 5.0)) - UNKNOWN).sum() for x in (3.0, 17.0))
    assert 0 < old < new


@pytest.mark.parametrize("shape", [(100, 200), (2000, 60), (3, 3)])
def test_pictures_keep_the_aspect_ratio_and_the_size_limits(shape):
    image = render(Scene(np.zeros(shape, bool), np.array([-3.0, 7.0]), 0.1))
    assert image.dtype == np.uint8
    assert image.shape[0] <= HEIGHT_MAX_PX
    assert image.shape[1] <= WIDTH_MAX_PX
    expected = (shape[1] * 0.1 + 1.6) / (shape[0] * 0.1 + 1.6)
    assert image.shape[1] / image.shape[0] == pytest.approx(expected, rel=0.03)


def test_objects_outside_the_picture_are_clipped():
    far = np.array([[500.0, 500.0, 0.0], [-500.0, 0.0, 0.0]])
    trail = np.array([[-100.0, -100.0], [100.0, 100.0]])
    image = render(Scene(hall(), np.zeros(2), 0.1, true_poses=far, estimated_poses=inverse(far), trails_m=(trail,)))
    assert image.shape[2] == 3


@pytest.mark.timed
def test_a_picture_of_a_large_hall_takes_less_than_50_ms(slowdown):
    walls = hall(200, 400)
    scene = Scene(walls, np.zeros(2), 0.1, (estimate(walls),), np.zeros((1, 3)))
    render(scene)
    start = time.process_time()
    for _ in range(10):
        render(scene)
    assert (time.process_time() - start) / 10 < 0.05 * slowdown


@pytest.mark.parametrize("turn_rad", [0.0, 0.3, 0.7])
def test_walls_of_a_turned_map_cover_the_true_walls_and_little_else(turn_rad):
    """The map is the building, sampled into cells that are turned; intersection over union of the drawn walls with the
    true ones, which are a cell wide."""
    plan = load_map("twin-02")
    cells = plan.cells()
    pose_building_map = np.array([*(cells.origin_m + 15.0), turn_rad])
    size = 500
    centres = np.stack(np.meshgrid(np.arange(size), np.arange(size)), axis=-1).reshape(-1, 2) * 0.1 + 0.05 - 20.0
    places = transform_points(pose_building_map, centres)
    column, row = np.floor((places - cells.origin_m) / cells.resolution_m).astype(int).T
    inside = (row >= 0) & (column >= 0) & (row < cells.wall.shape[0]) & (column < cells.wall.shape[1])
    log_odds = np.zeros(size * size, np.int16)
    log_odds[inside] = np.where(cells.wall[row[inside], column[inside]], 20, -20)
    grid = GridMap(log_odds.reshape(size, size), np.full(2, -20.0), 0.1)
    scene = Scene(cells.wall, cells.origin_m, cells.resolution_m, (grid,), pose_building_map[None])
    drawn = render(scene)[..., 0] < 138  # also pixels that a wall covers by half
    empty = Scene(cells.wall, cells.origin_m, cells.resolution_m)
    true = (render(empty) == TRUE_WALL).all(axis=2)
    assert np.count_nonzero(drawn & true) / np.count_nonzero(drawn | true) > 0.76
    near = ndimage.binary_dilation(true, iterations=3)  # a cell of 0.1 m has 3 pixels
    assert np.count_nonzero(drawn & ~near) < 0.01 * np.count_nonzero(drawn)
    assert np.count_nonzero(true & ~ndimage.binary_dilation(drawn, iterations=3)) < 0.02 * np.count_nonzero(true)


@pytest.mark.parametrize("turn_rad", [0.1, 0.4, np.pi / 4])
def test_a_straight_wall_in_turned_cells_is_drawn_straight_and_without_gaps(turn_rad):
    """The edge of the wall in the picture strays from a line by less than a third of a cell."""
    rows, columns = np.mgrid[0:200, 0:200] * 0.1 + 0.05 - 10.0
    along, across = (
        np.cos(turn_rad) * columns + np.sin(turn_rad) * rows,
        np.cos(turn_rad) * rows - np.sin(turn_rad) * columns,
    )
    is_wall = (np.abs(across) <= 0.06) & (np.abs(along) < 7)
    grid = GridMap(np.where(is_wall, 20, -20).astype(np.int16), np.full(2, -10.0), 0.1)
    scene = Scene(np.zeros((60, 180), bool), np.array([-9.0, -3.0]), 0.1, (grid,), np.array([[0.0, 0.0, -turn_rad]]))
    dark = render(scene)[..., 0] < 128
    columns_px = np.flatnonzero(dark.any(axis=0))
    middle = columns_px[len(columns_px) // 8 : -len(columns_px) // 8]
    upper = dark[:, middle].argmax(axis=0)
    assert dark[:, middle].any(axis=0).all()
    pixels_per_cell = 0.1 * 960 / (18 + 1.6)
    assert np.std(upper) < pixels_per_cell / 3


def test_single_wall_cells_are_drawn_and_unknown_cells_are_not():
    log_odds = np.full((40, 40), -5, np.int16)
    log_odds[10, 10], log_odds[25:, 25:] = 9, 0
    image = render(
        Scene(np.zeros((40, 40), bool), np.zeros(2), 0.1, (GridMap(log_odds, np.zeros(2), 0.1),), np.zeros((1, 3)))
    )
    assert pixel(image, 1.05, 1.05, (4.0, 4.0)) == WALL
    assert pixel(image, 3.5, 3.5, (4.0, 4.0)) == UNKNOWN
    assert pixel(image, 2.0, 2.0, (4.0, 4.0)) == FLOOR
