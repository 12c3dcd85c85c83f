"""Content, geometry and run time of pictures."""

import time

import numpy as np
import pytest

from twc_env.exploration.drawing.rendering import COLOURS, HEIGHT_MAX_PX, WIDTH_MAX_PX, Scene, render
from twc_env.records.geometry import compose, inverse
from twc_env.records.messages import GridMap

FLOOR, WALL, TRUE_WALL, UNKNOWN = (255, 255, 255), (38, 44, 56), (158, 164, 173), (219, 222, 227)


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


def test_a_picture_of_a_large_hall_takes_less_than_50_ms():
    walls = hall(200, 400)
    scene = Scene(walls, np.zeros(2), 0.1, (estimate(walls),), np.zeros((1, 3)))
    render(scene)
    start = time.process_time()
    for _ in range(10):
        render(scene)
    assert (time.process_time() - start) / 10 < 0.05
