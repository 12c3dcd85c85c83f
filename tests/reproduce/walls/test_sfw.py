import numpy as np
import pytest

from tests.real_data import DATA, needs_data
from twc_env.config import radio_preset
from twc_env.errors import DataError
from twc_env.maps import load_map
from twc_env.metrics import path_length_m
from twc_env.metrics.k_visibility import score_structure
from twc_env.reproduce.runner import Runner, table_module
from twc_env.reproduce.walls import sfw_authors, sfw_ble, sfw_routers, sfw_table1
from twc_env.reproduce.walls.sfw_flats import flat
from twc_env.reproduce.walls.sfw_registration import register
from twc_env.reproduce.walls.sfw_scoring import Counted, Mapped, at_coverage, counted_walls, shuffled
from twc_env.reproduce.walls.sfw_slam import slam_walk
from twc_env.reproduce.walls.sfw_walks import STANDOFF_M, WalkReadings, wall_following_route
from twc_env.world.building.floor_cells import Cells


@pytest.mark.parametrize("name", ["sfw-e1", "sfw-e4"])
def test_the_route_follows_every_wall_at_its_distance(name):
    plan = load_map(name)
    way = wall_following_route(plan)
    assert plan.wall_index.distance_m(way, 1.0).min() > STANDOFF_M - 0.1
    middles = plan.walls_m.mean(axis=1)
    gaps = np.linalg.norm(middles[:, None] - way[None], axis=2).min(axis=1)
    assert gaps.max() < STANDOFF_M + 0.3
    assert path_length_m(way) > 0.8 * np.linalg.norm(plan.walls_m[:, 0] - plan.walls_m[:, 1], axis=1).sum()


def test_the_table_has_a_row_per_experiment_and_method_and_ours_beats_the_paper(rows_of, tmp_path, monkeypatch):
    monkeypatch.setitem(sfw_table1.POINTS, 1, 600)
    rows = rows_of(sfw_table1, "--seeds", "0", "--experiments", "1", "--out", str(tmp_path))
    methods = [row["method"] for row in rows]
    assert methods[:4] == ["paper", "paper, distance", "ours", "ours, SLAM"]
    assert methods[4:] == list(sfw_table1.METHODS[4:]) and len(methods) == 13
    assert rows[4]["k_accuracy"] <= rows[0]["k_accuracy"] == rows[5]["k_accuracy"]  # chosen in hindsight
    assert rows[6]["iou_wall"] > 0.9 > rows[5]["iou_free"] > 0.5
    assert rows[3]["iou_free"] > 0.9
    assert list(rows[0]) == [
        "experiment", "routers", "points", "method", "k_accuracy", "k_cells", "k_trivial", "iou_free", "iou_trivial",
        "iou_wall", "coverage", "mse", "brier", "path_error_m", "paper_k_accuracy", "paper_iou", "seeds", "sd",
    ]  # fmt: skip
    row = {each["method"]: each for each in rows}
    literal, mixture = row["paper, probability by Eq. 4"], row["paper, probability by Gaussians"]
    assert len({literal["brier"], mixture["brier"], row["paper"]["brier"]}) == 3
    assert literal["iou_free"] == mixture["iou_free"] == row["paper"]["iou_free"]
    null = row["ours, strengths shuffled"]
    assert null["k_accuracy"] <= row["ours"]["k_trivial"] < row["ours"]["k_accuracy"]
    assert null["iou_wall"] < row["ours"]["iou_wall"]
    assert row["ours, SLAM"]["path_error_m"] < 0.1 < row["ours, radio SLAM"]["path_error_m"]
    assert rows[2]["k_accuracy"] > 0.95 > rows[0]["k_accuracy"]
    assert rows[2]["iou_free"] > 0.97
    assert rows[2]["coverage"] > 0.8
    assert sfw_table1.update_time_ms() < 0.1


def test_the_surest_cells_are_told_first_up_to_a_coverage():
    truth = np.full((4, 5), 255, np.uint8)
    probability = np.tile([0.02, 0.1, 0.2, 0.6, np.nan], (4, 1))
    classes = np.select([probability < 0.25, probability > 0.4], [255, 0], 127).astype(np.uint8)
    made = Mapped(
        Counted(1.0, 1.0, 0.5), score_structure(classes, truth, probability), 0.0, classes, truth, probability
    )
    rays = np.arange(20).reshape(4, 5)
    told = at_coverage(made, rays, 0.5)
    assert told.score.coverage == 0.5
    assert (told.classes != 127).sum(axis=0).tolist() == [4, 2, 0, 4, 0]
    assert np.flatnonzero(told.classes[:, 1] != 127).tolist() == [2, 3]
    assert told.score.iou_free < 1.0


def test_walls_are_counted_by_reading_and_by_cell_beside_the_trivial_answer():
    cells = load_map("sfw-e1").cells(0.1)
    at = cells.centre_of(np.argwhere(cells.free)[[0, 0, 0, 50]])
    walk = WalkReadings(at, np.full((4, 1), -50.0), np.zeros((1, 2)), np.array([[1], [1], [1], [0]]))
    counted = counted_walls(walk, cells, np.array([1, 1, 0, 1]))
    assert (counted.accuracy, counted.by_cell, counted.trivial) == (0.5, 0.5, 0.75)


def test_shuffled_strengths_are_the_same_strengths_elsewhere():
    rssi = np.arange(40.0).reshape(20, 2)
    walk = WalkReadings(np.zeros((20, 2)), rssi, np.zeros((2, 2)), np.zeros((20, 2), int))
    null = shuffled(walk, 3).rssi_dbm
    assert not np.array_equal(null, rssi) and sorted(null.tolist()) == rssi.tolist()
    assert np.array_equal(null, shuffled(walk, 3).rssi_dbm) and not np.array_equal(null, shuffled(walk, 4).rssi_dbm)


def test_flats_are_measured_in_the_same_columns(rows_of, tmp_path, monkeypatch):
    monkeypatch.setattr(sfw_table1, "_READINGS_PER_M", 10.0)
    rows = rows_of(sfw_table1, "--flats", "1", "--out", str(tmp_path))
    wanted = [("1 flats", routers) for routers in (1, 2) for _ in sfw_table1.METHODS]
    assert [(row["experiment"], row["routers"]) for row in rows] == wanted
    assert rows[2]["k_accuracy"] > 0.9
    assert rows[0]["paper_iou"] is None
    assert not any("printed" in text for text in sfw_table1.remarks(rows))


def test_a_picture_is_laid_back_on_a_path_drawn_to_another_scale():
    free = np.zeros((300, 400), bool)
    free[50:250, 60:340] = True
    free[50:150, 200:340] = False
    corners = np.array([(75, 65), (185, 65), (185, 165), (325, 165), (325, 235), (75, 235), (75, 65)], float)
    travel = np.linspace(0, len(corners) - 1, 300)
    path = np.column_stack([np.interp(travel, np.arange(len(corners)), corners[:, k]) for k in (0, 1)])
    fit = register((path - [20.0, 10.0]) / 0.8, free)
    assert fit.scale == pytest.approx(0.8, abs=0.03)
    assert np.linalg.norm(fit.apply((path - [20.0, 10.0]) / 0.8) - path, axis=1).mean() < 6.0


def test_routers_placed_for_line_of_sight_see_more_floor_than_those_of_the_experiments(rows_of, monkeypatch):
    monkeypatch.setattr(sfw_routers, "POINTS", {4: 300, 6: 200})
    rows = rows_of(sfw_routers, "--seeds", "0")
    assert [row["experiment"] for row in rows] == [4, 6, "all"]
    assert all(row["floor_in_sight"] <= row["floor_in_sight_if_placed"] <= 1.0 for row in rows)


def test_flats_are_drawn_by_seed_and_all_their_rooms_can_be_walked():
    for seed in range(4):
        plan = flat(seed, routers=2)
        assert np.array_equal(plan.walls_m, flat(seed, routers=2).walls_m)
        walls = np.linalg.norm(plan.walls_m[:, 0] - plan.walls_m[:, 1], axis=1).sum()
        assert path_length_m(wall_following_route(plan)) > 0.75 * walls


def test_the_engine_drives_the_route_and_believes_it_was_there():
    plan = load_map("sfw-e1")
    way = wall_following_route(plan)
    drive = slam_walk(plan, way, 200, radio_preset("sfw"), seed=0)
    assert np.linalg.norm(drive.true_m[:, None] - way, axis=2).min(axis=1).max() < 0.1
    assert 0.001 < drive.error_m(drive.slam_m) < 0.1 < drive.error_m(drive.odometry_m)
    assert drive.error_m(drive.radio_m) <= drive.error_m(drive.odometry_m) + 0.5


def test_a_drive_that_ends_before_its_path_is_no_drive():
    plan = load_map("sfw-e1")
    way = wall_following_route(plan)[:40]
    into_the_wall = way[:1] + np.linspace(0.0, 30.0, 40)[:, None] * [1.0, 0.0]
    with pytest.raises(DataError, match=r"does not reach the end of the path through 'sfw-e1'"):
        slam_walk(plan, into_the_wall, 20, radio_preset("sfw"), seed=0)


@pytest.mark.parametrize(
    "words", ["sfw-authors", "sfw-ble", "sfw-houseexpo", "sfw-table1 --seeds 0-1", "sfw-table1 --flats 1"]
)
def test_pictures_asked_for_in_another_folder_are_drawn_again(words, parsed, tmp_path, monkeypatch):
    def label_first(runner, parts, work, label=str):
        labels.add(label(parts[0]))
        raise StopIteration

    (tmp_path / "houseexpo").mkdir()
    (tmp_path / "houseexpo" / "plan.json").write_text("{}", encoding="utf-8")
    monkeypatch.setenv("TWC_DATA", str(tmp_path))
    monkeypatch.setattr(Runner, "each", label_first)
    name, *words = words.split()
    table, labels = table_module(name), set()
    for folder in ("a", "b"):
        with pytest.raises(StopIteration):
            table.rows(parsed(table, *words, "--out", folder), Runner(name, tmp_path, {}))
    assert len(labels) == 2


def test_walls_that_a_reading_stands_in_are_none_whichever_way_the_map_is_turned():
    wall = np.zeros((30, 30), bool)
    wall[10:13, 10:13] = wall[14:16, 20:23] = wall[:, 26] = True
    positions = np.array([[1.15, 1.15], [2.05, 1.45], [2.85, 1.45]])  # in the middle of a wall, at another's edge
    router = np.array([0.25, 1.15])
    found = []
    for turns in range(4):
        walls = np.rot90(wall, turns)
        c, s = np.round(np.cos(turns * np.pi / 2)), np.round(np.sin(turns * np.pi / 2))
        turned = (np.vstack([router, positions]) - 1.5) @ np.array([[c, -s], [s, c]]) + 1.5
        cells = Cells(~walls, walls, np.zeros(2), 0.1)
        found.append(sfw_authors._walls_between(cells, turned[0], turned[1:]).tolist())
    assert found == [[0, 0, 1]] * 4


@needs_data
def test_walls_of_the_real_flat_are_told_on_drives_that_chose_nothing():
    found = sfw_ble.measure(sfw_ble.TEST, DATA / "wifi" / "ble_lidar", None)
    true = np.minimum(found["true"], 2)
    ours, means = (np.mean(found[f"{method} 2"] == true) for method in ("ours", "k-means"))
    assert ours > 0.74 and means < 0.65
    assert len(true) == 16_696  # of the 22,277 readings of all four drives
