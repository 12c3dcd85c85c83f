import numpy as np
import pytest

from twc_env.records.geometry import compose, inverse
from twc_env.records.json_values import plain
from twc_env.records.messages import LoopCandidate, LoopClosure
from twc_env.reproduce.runner import Runner
from twc_env.reproduce.twc import twc_table2
from twc_env.reproduce.twc.offline_mapping import common_frames, wall_thickness_m


@pytest.fixture(scope="module")
def options(parsed):
    return parsed(twc_table2, "--seeds", "50-50", "--scenes", "#01")


@pytest.fixture(scope="module")
def table(options, tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        methods = {method: twc_table2.METHODS[method] for method in ("text", "twc", "odometry")}
        patch.setattr(twc_table2, "METHODS", methods | {"fused": {}})
        rows = twc_table2.rows(options, Runner("table", tmp_path_factory.mktemp("cache"), {}))
    return {(row["method"], row["backend"]): row for row in plain(rows)}


def test_believing_every_closure_ruins_the_map_of_text_alone_and_ours_repairs_it(table):
    ruined, repaired = table["text", "plain"], table["text", "ours"]
    assert ruined["ate_m"] > 1.0 and ruined["closure_precision"] < 0.6
    assert repaired["ate_m"] < 0.1 and repaired["closure_precision"] == 1.0
    assert ruined["wall_thickness_m"] > 2 * repaired["wall_thickness_m"]


def test_one_false_closure_of_text_in_a_hundred_folds_the_map_that_the_right_ones_make(table):
    rows = [table["text", f"literal {share:g}"] for share in twc_table2.SHARES_RIGHT]
    assert [row["closure_precision"] for row in rows] == pytest.approx(twc_table2.SHARES_RIGHT, abs=0.02)
    assert rows[0]["ate_m"] < 0.1 < 1.0 < rows[1]["ate_m"]
    assert len({round(row["closures"] * row["closure_precision"]) for row in rows}) == 1


def test_remarks_say_how_right_text_must_be_for_the_order_of_the_print():
    row = {"scene": "#01", "ate_m": 1.0}
    table = [
        row | {"method": method, "backend": backend, "epe_m": epe_m, "closure_precision": 0.5}
        for backend in (*twc_table2.BACKENDS, twc_table2.LITERAL)
        for method, epe_m in twc_table2.PRINT["#01"].items()
    ]
    for share, epe_m in zip(twc_table2.SHARES_RIGHT, (0.1, 0.3, 1.0, 1.8, 2.0, 4.0), strict=True):
        few = {"method": "text", "backend": f"literal {share:g}", "epe_m": epe_m, "closure_precision": share}
        table.append(row | few)
    both_scenes = [*table, *({**row, "scene": "#02"} for row in table)]  # the paper's claim is about both
    told = [line for line in twc_table2.remarks(both_scenes) if line.startswith("#01 text as printed, by")]
    assert len(told) == 1 and told[0].endswith("rank as in the paper with 99, 98 %")


def test_the_whole_system_reaches_its_goal_on_a_walk(table):
    for backend in ("ours", "live"):
        row = table["fused", backend]
        assert row["epe_m"] <= 0.08 and row["ate_m"] <= 0.10 and row["merged"] == 1


def test_without_closures_every_back_end_says_the_same_and_nothing_is_merged(table):
    alone = [{**table["odometry", backend], "backend": ""} for backend in ("plain", "robust", "pcm", "ours")]
    assert all(row == alone[0] for row in alone) and alone[0]["merged"] == 0


def test_printed_errors_stand_beside_ours(table):
    assert table["text", "plain"]["paper_epe_m"] == 0.35 and table["fused", "ours"]["paper_epe_m"] is None


def test_the_papers_percentages_are_those_of_its_own_errors():
    found = {
        method: twc_table2.reductions(*([scene[m] for scene in twc_table2.PRINT.values()] for m in (method, "twc")))
        for method in ("lidar", "text", "wifi")
    }
    assert [round(100 * of_means, 2) for of_means, _ in found.values()] == [88.06, 81.68, 92.16]
    assert [round(100 * per_scene, 1) for _, per_scene in found.values()] == [88.1, 65.2, 91.5]


def test_pictures_are_drawn(options, tmp_path, monkeypatch):
    monkeypatch.setattr(twc_table2, "METHODS", {"twc": {}, "fused": {}})
    paths = twc_table2.draw(options, Runner("table", tmp_path, {}), tmp_path)
    assert [path.name for path in paths] == ["twc-01-trajectories.png", "twc-01-maps.png", "twc-01-closures.png"]
    assert all(path.stat().st_size > 5000 for path in paths)


def test_robots_are_tied_by_the_frame_that_most_closures_agree_on():
    pose = np.array([4.0, -2.0, 1.0])
    path = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.5], [6.0, 2.0, 1.0]])

    def closure(index, put):
        measured = compose(inverse(path[index]), compose(put, path[index]))
        return LoopClosure(LoopCandidate((0, index), (1, index), measured, "twc"), measured, np.eye(3), 1.0, "accepted")

    false = np.array([-9.0, 5.0, -2.0])
    closures = [closure(0, pose), closure(1, false), closure(2, pose)]
    frames = common_frames([path, path, path], closures)
    assert frames[1] == pytest.approx(pose) and frames[2] == pytest.approx(np.zeros(3))


def test_ghost_points_thicken_the_walls_of_a_cloud():
    along = np.repeat(np.arange(0.05, 4.0, 0.05), 2)
    wall = np.array([[[0.0, 0.0], [4.0, 0.0]]])
    sharp = np.stack([along, np.full(len(along), 0.05)], axis=1)
    ghost = np.concatenate([sharp, sharp + [0.0, 0.7]])
    assert wall_thickness_m(ghost, wall) == pytest.approx(2 * wall_thickness_m(sharp, wall), rel=0.05)
