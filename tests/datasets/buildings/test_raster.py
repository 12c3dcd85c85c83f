import gzip
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from twc_env.datasets.buildings import raster
from twc_env.datasets.buildings.picture import read_picture
from twc_env.datasets.buildings.raster import deepest_cell, free_edges, largest_part, plan_from_free, read_grey
from twc_env.errors import MapError


def rooms() -> np.ndarray:
    """Two rooms of 4 x 5 m with a door of 1 m between them, at 0.1 m; row 0 is the lowest y."""
    free = np.zeros((60, 100), bool)
    free[5:55, 5:45] = True
    free[5:55, 50:90] = True
    free[20:30, 45:50] = True
    return free


def write_pgm(path: Path, free: np.ndarray, kind: str = "P5", white: int = 255) -> Path:
    pixels = np.where(free[::-1], white, 0)
    head = f"{kind}\n# drawn by a test\n{free.shape[1]} {free.shape[0]}\n{white}\n".encode()
    if kind == "P2":
        body = "\n".join(" ".join(map(str, row)) for row in pixels).encode()
    else:
        body = pixels.astype("u1" if white < 256 else ">u2").tobytes()
    path.write_bytes(gzip.compress(head + body) if path.suffix == ".gz" else head + body)
    return path


def test_edges_of_a_block_are_its_four_sides():
    free = np.zeros((6, 8), bool)
    free[1:4, 2:7] = True
    walls = {tuple(sorted(map(tuple, wall))) for wall in free_edges(free).tolist()}
    assert walls == {((2, 1), (7, 1)), ((2, 4), (7, 4)), ((2, 1), (2, 4)), ((7, 1), (7, 4))}


@given(seed=st.integers(0, 10_000))
def test_edges_have_the_length_of_the_outline(seed):
    free = np.random.default_rng(seed).random((12, 15)) < 0.6
    padded = np.pad(free, 1)
    expected = (padded[1:] != padded[:-1]).sum() + (padded[:, 1:] != padded[:, :-1]).sum()
    walls = free_edges(free)
    assert np.abs(walls[:, 1] - walls[:, 0]).sum() == expected


def test_free_space_up_to_the_border_is_closed():
    plan = plan_from_free(np.ones((30, 40), bool), 0.1, "full")
    assert len(plan.walls_m) == 4
    assert plan.bounds_m == pytest.approx([0, 0, 4, 3])
    assert plan.cells().free.any()


def test_each_face_of_a_wall_carries_half_of_its_loss():
    plan = plan_from_free(rooms(), 0.1, "rooms")
    counts, losses = plan.wall_index.crossing(np.array([3.0, 2.5]), np.array([[6.0, 0.6], [6.0, 2.5], [3.0, 2.0]]))
    assert counts.tolist() == [2, 0, 0]
    assert losses.tolist() == [5.0, 0.0, 0.0]


def test_walls_lie_on_the_edges_of_the_pixels():
    plan = plan_from_free(rooms(), 0.1, "rooms", origin_m=(-2.0, 7.0))
    assert plan.bounds_m == pytest.approx([-1.5, 7.5, 7.0, 12.5])
    xs = np.unique(plan.walls_m[..., 0].round(6))
    assert xs.tolist() == [-1.5, 2.5, 3.0, 7.0]


def test_only_the_largest_part_is_kept():
    free = rooms()
    free[20:30, 45:50] = False
    free[5:55, 80:90] = False
    plan = plan_from_free(free, 0.1, "rooms")
    assert plan.bounds_m == pytest.approx([0.5, 0.5, 4.5, 5.5])


def test_specks_are_dropped_and_obstacles_kept():
    free = rooms()
    free[40, 20] = False
    free[10:14, 20:24] = False
    plan = plan_from_free(free, 0.1, "rooms")
    clean = plan_from_free(rooms(), 0.1, "rooms")
    assert len(plan.walls_m) == len(clean.walls_m) + 4
    assert not plan.cells().is_free(np.array([2.2, 1.2]))
    assert plan.cells().is_free(np.array([2.05, 4.05]))


def test_strips_too_narrow_for_a_robot_are_dropped_and_passages_kept():
    free = rooms()
    free[57, 10:40] = True
    free[55:57, 12] = True
    free[53:60, 60:62] = True
    plan = plan_from_free(free, 0.1, "rooms")
    assert plan.walls_m.tobytes() == plan_from_free(rooms(), 0.1, "rooms").walls_m.tobytes()
    free = rooms()
    free[20:30, 45:50] = False
    free[20:23, 45:50] = True
    assert plan_from_free(free, 0.1, "rooms").bounds_m[2] == pytest.approx(9.0)


@pytest.mark.parametrize("side", range(1, 8))
def test_what_is_left_without_strips_is_a_morphological_opening(side):
    random = np.random.default_rng(side)
    for shape in ((1, 1), (5, 40), (30, 17)):
        free = random.random(shape) < 0.9
        opened = ndimage.binary_opening(free, np.ones((side, side)))
        assert (raster._without_strips(free, raster.STRIP_M / (side - 0.5)) == opened).all()


def test_a_margin_around_a_plan_moves_it_and_changes_nothing_else():
    free = rooms()
    wide = np.pad(free, ((300, 0), (0, 200)))
    plan, moved = plan_from_free(free, 0.1, "a"), plan_from_free(wide, 0.1, "a", (0.0, -30.0))
    assert np.allclose(plan.walls_m, moved.walls_m) and np.allclose(plan.interior_m, moved.interior_m)


def test_the_deepest_cell_is_the_middle_of_the_widest_room():
    free = np.zeros((50, 90), bool)
    free[5:16, 5:20] = True
    free[10, 20:40] = True
    free[10:41, 40:71] = True
    row, column = deepest_cell(free)
    assert abs(row - 25) <= 1
    assert abs(column - 55) <= 1


def test_parts_that_touch_at_a_corner_only_are_not_connected():
    free = np.zeros((4, 4), bool)
    free[:2, :2] = True
    free[2, 2] = True
    assert largest_part(free).sum() == 4


@pytest.mark.parametrize(
    ("name", "kind", "white"),
    [("m.pgm", "P5", 255), ("m.pgm", "P2", 255), ("m.pgm.gz", "P5", 255), ("m.pgm", "P5", 1000), ("m.pgm", "P2", 1)],
)
def test_each_kind_of_pgm_is_read(tmp_path, name, kind, white):
    path = write_pgm(tmp_path / name, rooms(), kind, white)
    assert np.array_equal(read_grey(path)[::-1] > 250, rooms())
    plan = read_picture(path, seed=3, resolution_m=0.1)
    assert plan.name == "m"
    assert plan.cells().free.sum() * 0.01 == pytest.approx(40.5, abs=3)
    assert plan.cells().is_free(np.array([[4.75, 2.5], [4.75, 3.5]])).tolist() == [True, False]


@pytest.mark.parametrize(
    "content", [b"", b"P5\n10 10\n255\nshort", b"P6\n1 1\n255\n...", b"P5\n# only a comment", b"GIF"]
)
def test_broken_pgm_pictures_are_refused(tmp_path, content):
    path = tmp_path / "broken.pgm"
    path.write_bytes(content)
    with pytest.raises(MapError, match=r"broken\.pgm is not a complete PGM image"):
        read_picture(path)


@pytest.mark.parametrize(
    ("name", "raw"),
    [
        ("none.pgm", None), ("none.png", None), ("not-compressed.pgm.gz", b"P5\n1 1\n255\n0"), ("a.png", b""),
        ("a.png", b"\x89PNG\r\n\x1a\n"), ("a.png", b"no picture"), ("a.png", b"\x89PNG\r\n\x1a\n" + bytes(200)),
    ],
)  # fmt: skip
def test_what_is_no_picture_is_refused(tmp_path, name, raw):
    if raw is not None:
        pytest.importorskip("PIL", reason="Pillow is an optional dependency")
        (tmp_path / name).write_bytes(raw)
    with pytest.raises(MapError, match="cannot read the picture"):
        read_picture(tmp_path / name)


@pytest.mark.parametrize("mode", ["L", "LA", "P", "RGBA", "RGB", "1"])
def test_png_pictures_of_each_mode_are_read(tmp_path, mode):
    image = pytest.importorskip("PIL.Image", reason="Pillow is an optional dependency")
    grey = image.fromarray(np.where(rooms()[::-1], 255, 0).astype(np.uint8))
    grey.convert("RGBA" if mode == "LA" else "RGB").convert(mode).save(tmp_path / "m.png")
    assert np.array_equal(read_grey(tmp_path / "m.png")[::-1] > 250, rooms())


def test_greys_of_16_bits_are_scaled_and_not_cut_off(tmp_path):
    image = pytest.importorskip("PIL.Image")
    grey = np.array([[0, 255, 30_000, 65_535]], np.uint16)
    image.fromarray(grey).save(tmp_path / "a.png")
    assert read_grey(tmp_path / "a.png").tolist() == [[0, 1, 117, 255]]


@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_a_colour_that_stands_for_transparency_is_not_free(tmp_path, mode):
    image = pytest.importorskip("PIL.Image")
    white = 255 if mode == "L" else (255, 255, 255)
    image.new(mode, (2, 1), white).save(tmp_path / "a.png", transparency=white)
    assert read_grey(tmp_path / "a.png").tolist() == [[0, 0]]


def test_transparent_pixels_are_not_free(tmp_path):
    image = pytest.importorskip("PIL.Image", reason="Pillow is an optional dependency")
    pixels = np.full((4, 4, 4), 255, np.uint8)
    pixels[:2, :, 3] = 0
    image.fromarray(pixels).save(tmp_path / "m.png")
    assert (read_grey(tmp_path / "m.png")[:, 0] > 250).tolist() == [False, False, True, True]


def test_a_black_picture_is_refused(tmp_path):
    with pytest.raises(MapError, match="shows no free space"):
        read_picture(write_pgm(tmp_path / "black.pgm", np.zeros((9, 9), bool)))


def test_a_picture_of_too_many_pixels_is_refused_before_it_is_unpacked(tmp_path):
    (tmp_path / "a.pgm").write_bytes(b"P5\n100000 100000\n255\n")
    with pytest.raises(MapError, match="100000 x 100000 pixels, more than"):
        read_picture(tmp_path / "a.pgm")
