import dataclasses

import numpy as np
import pytest

from tests.real_data import DATA, needs_data
from twc_env.config import EnvConfig
from twc_env.datasets.buildings.ros_map import read_ros_cells, read_ros_map, write_ros_map
from twc_env.errors import MapError
from twc_env.maps import load_map
from twc_env.records.messages import GridMap
from twc_env.world.world import World


def grid() -> GridMap:
    log_odds = np.zeros((40, 60), np.int16)
    log_odds[5:35, 5:55] = -40
    log_odds[4, 5:55] = 90
    log_odds[20:35, 30:32] = 55
    return GridMap(log_odds, np.array([-3.0, 1.5]), 0.1)


@pytest.fixture
def rewritten(tmp_path):
    """The map of `grid`, written with one text in its file replaced by another."""

    def write(old: str, new: str):
        path = write_ros_map(grid(), tmp_path, "mine")
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))
        return path

    return write


def test_a_written_grid_reads_back_cell_by_cell(tmp_path):
    ros_map = read_ros_cells(write_ros_map(grid(), tmp_path / "out", "mine"))
    assert np.array_equal(ros_map.free, grid().log_odds < 0)
    assert np.array_equal(ros_map.occupied, grid().log_odds > 0)
    assert ros_map.resolution_m == 0.1
    assert ros_map.origin.tolist() == [-3.0, 1.5, 0.0]


def test_the_first_row_of_the_picture_is_the_top(tmp_path):
    write_ros_map(grid(), tmp_path, "mine")
    raw = (tmp_path / "mine.pgm").read_bytes()
    pixels = np.frombuffer(raw[-40 * 60 :], np.uint8).reshape(40, 60)
    assert raw.startswith(b"P5\n60 40\n255\n")
    assert pixels[35, 10] == 0
    assert pixels[34, 10] == 254
    assert pixels[0, 0] == 205


def test_a_map_becomes_a_floor_plan_at_its_origin(tmp_path):
    plan = read_ros_map(write_ros_map(grid(), tmp_path, "mine"))
    assert plan.name == "mine"
    assert plan.bounds_m == pytest.approx([-2.5, 2.0, 2.5, 5.0])
    assert len(plan.access_points) == 6
    assert plan.cells().is_free(np.array([0.0, 3.0]))
    assert not plan.cells().is_free(np.array([0.1, 4.5]))


def test_the_yaw_of_the_origin_turns_the_building(rewritten, tmp_path):
    straight = read_ros_map(write_ros_map(grid(), tmp_path, "mine"))
    turned = read_ros_map(rewritten("[-3.0, 1.5, 0.0]", "[0, 0, 1.5707963267948966]"))
    assert turned.bounds_m == pytest.approx([-3.5, 0.5, -0.5, 5.5])
    assert len(turned.walls_m) == len(straight.walls_m)
    assert turned.digest == straight.digest


@pytest.mark.parametrize("negate", ["1", "true", "True"])
def test_negate_swaps_black_and_white(rewritten, negate):
    ros_map = read_ros_cells(rewritten("negate: 0", f"negate: {negate}"))
    assert np.array_equal(ros_map.occupied, grid().log_odds <= 0)
    assert np.array_equal(ros_map.free, grid().log_odds > 0)


@pytest.mark.parametrize(
    ("stem", "line"),
    [
        ("mine", "image: /home/robot/maps/mine.pgm"),  # said to lie on another machine, found beside the map
        ("mine", "image: C:\\maps\\mine.pgm"),
        ("mine", '# a map\nmode: trinary\nimage: "mine.pgm"  # the picture'),
        ("hall #2", 'image: "hall #2.pgm"  # 2nd "hall"'),
        ("hall #2", "image: 'hall #2.pgm'"),
        ("it's", "image: 'it''s.pgm' # a: b"),
        ("a#b", "image: a#b.pgm # b"),
        ("Büro", 'image: "B\\u00fcro.pgm"'),
    ],
)
def test_the_picture_of_a_map_is_found_however_it_is_named(rewritten, tmp_path, stem, line):
    path = rewritten("image: mine.pgm", line)
    (tmp_path / "mine.pgm").rename(tmp_path / f"{stem}.pgm")
    assert np.array_equal(read_ros_cells(path).free, grid().log_odds < 0)


@pytest.mark.parametrize(
    "stem",
    ["hall #2", "a: b", "- a", "'a'", '"a"', "[a]", "#a", "a\nb", "%a", "{a}", "*a", "a\\b", "Büro 階", "true", "~"],
)
def test_every_name_of_a_map_is_read_back_by_us_and_by_yaml(tmp_path, stem):
    path = write_ros_map(dataclasses.replace(grid(), origin_m=np.array([1e-17, -2.5])), tmp_path, stem)
    assert read_ros_cells(path).free.sum() == (grid().log_odds < 0).sum()
    yaml = pytest.importorskip("yaml", reason="another reader of YAML is not here")
    values = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert values["image"] == f"{stem}.pgm"
    assert values["origin"] == [1e-17, -2.5, 0.0]


def test_raw_pictures_hold_percents_and_what_is_above_is_unknown(rewritten, tmp_path):
    path = rewritten("negate: 0", "negate: 1\nmode: raw")  # which knows no negation
    percents = np.select([grid().log_odds < 0, grid().log_odds > 0], [0, 100], 255).astype(np.uint8)
    (tmp_path / "mine.pgm").write_bytes(b"P5\n60 40\n255\n" + percents[::-1].tobytes())
    ros_map = read_ros_cells(path)
    assert np.array_equal(ros_map.free, grid().log_odds < 0)
    assert np.array_equal(ros_map.occupied, grid().log_odds > 0)


@pytest.mark.parametrize("negate", [0, 1])
def test_what_is_transparent_is_never_free(tmp_path, negate):
    image_module = pytest.importorskip("PIL.Image", reason="png needs the viz extra")
    path = write_ros_map(grid(), tmp_path, "mine")
    is_free = (grid().log_odds < 0)[::-1]
    free, wall = (0, 255) if negate else (254, 0)
    pixels = np.dstack([np.where(is_free, free, wall), np.where(grid().log_odds[::-1] == 0, 0, 255)]).astype(np.uint8)
    image_module.fromarray(pixels, "LA").save(tmp_path / "mine.png")
    path.write_text(path.read_text().replace("mine.pgm", "mine.png").replace("negate: 0", f"negate: {negate}"))
    assert np.array_equal(read_ros_cells(path).free, is_free[::-1])


@pytest.mark.parametrize(
    "origin",
    ["\n- -3.0\n- 1.5\n- 0.0", "\n  - -3.0\n  - 1.5  # y\n  - 0.0", "[-3.0,\n 1.5, 0.0]", "[-3.0\n , 1.5\n , 0.0]"],
)
def test_lists_of_several_lines_a_byte_order_mark_and_ends_of_documents_are_read(tmp_path, origin):
    path = write_ros_map(grid(), tmp_path, "mine")
    text = "---\n" + path.read_text().replace("[-3.0, 1.5, 0.0]", origin) + "...\n"
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    assert read_ros_cells(path).origin.tolist() == [-3.0, 1.5, 0.0]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("negate: 0", "negate: 0\nmode: tri", "mode must be trinary, scale or raw; got 'tri'"),
        ("resolution: 0.1\n", "", "lacks the key 'resolution'"),
        ("resolution: 0.1", "resolution: fine", "resolution must be a number; got 'fine'"),
        ("resolution: 0.1", "resolution: -0.1", "resolution must be metres per pixel, 0.005 to 10; got -0.1"),
        ("free_thresh: 0.196", "free_thresh: nan", "free_thresh must be finite; got 'nan'"),
        ("free_thresh: 0.196", "free_thresh: 0.7", "the first not above the second; got 0.7 and 0.65"),
        ("occupied_thresh: 0.65", "occupied_thresh: 65", "must be shares from 0 to 1, .* got 0.196 and 65"),
        ("1.5, 0.0]", "1.5, 90]", "yaw, the last of origin, is in radians, at most a turn; got 90"),
        ("[-3.0, 1.5, 0.0]", "[-3.0, 1.5]", r"origin must be \[x, y, yaw\]"),
        ("image: mine.pgm", "image: other.pgm", "names the picture 'other.pgm', which is not there; put it beside it"),
        ("free_thresh: 0.196", "free_thresh: 0.0", "shows no free space"),
    ],
)
def test_faulty_map_files_are_refused(rewritten, old, new, expected):
    path = rewritten(old, new)
    with pytest.raises(MapError, match=expected) as caught:
        read_ros_map(path)
    assert "\n" not in str(caught.value)


@needs_data
def test_willow_garage_loads_from_its_compressed_picture_and_runs():
    plan = load_map(DATA / "maps/ros/willow-2010-02-18-0.10.yaml")
    assert np.ptp(plan.bounds_m[[0, 2]]) == pytest.approx(56, abs=2)
    assert 800 < plan.cells().free.sum() * 0.01 < 1200
    world = World(EnvConfig(), plan)
    world.reset(0)
    for _ in range(20):
        world.step(np.full((3, 2), 0.5))
        frames = world.sense()
    assert all(frame.ranges_m.min() > 0.15 for frame in frames)


@needs_data
@pytest.mark.parametrize(("stem", "area_m2"), [("lse_arena", 10), ("intel", 1760)])
def test_other_real_ros_maps_load(stem, area_m2):
    plan = load_map(DATA / f"maps/ros/{stem}.yaml")
    assert plan.cells().free.sum() * 0.01 == pytest.approx(area_m2, rel=0.1)


def test_a_key_that_stands_twice_is_refused_by_name(rewritten):
    with pytest.raises(MapError, match=r"mine\.yaml gives 'resolution' twice; keep one of its values"):
        read_ros_cells(rewritten("negate: 0", "negate: 0\nresolution: 0.2"))
