"""Pictures and pages of logs, which have no ground truth."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from twc_env.datasets.logs.scan_log import ScanLog
from twc_env.errors import DataError
from twc_env.pictures import log_picture
from twc_env.pictures.log_page import GAP_M, LogPage
from twc_env.pictures.log_picture import _figure, draw_log, one_name_per_sign
from twc_env.pictures.style import style
from twc_env.records.messages import GridMap
from twc_env.replaying.inputs import Asked, input_of
from twc_env.replaying.run import run

pytest.importorskip("matplotlib")


def square_log(x_m: float) -> ScanLog:
    """A robot that drives through a square room of 6 m."""
    steps = 12
    x = x_m + 0.2 * np.arange(steps)
    angles = np.radians(np.arange(-179.0, 180.0, 2.0))
    walls = np.stack([(3.0 - x[:, None]) / np.cos(angles), (-3.0 - x[:, None]) / np.cos(angles)])
    walls = np.concatenate(
        [walls, np.broadcast_to(np.stack([3.0, -3.0] / np.sin(angles)[:, None], 1)[:, None], walls.shape)]
    )
    ranges_m = np.where(walls > 0.0, walls, np.inf).min(axis=0)
    return ScanLog(1000.0 + np.arange(steps), np.column_stack([x, np.zeros(steps), np.zeros(steps)]), ranges_m, angles)


@pytest.fixture(scope="module")
def replayed():
    source = input_of([square_log(-1.5), square_log(-0.5)], [np.zeros(3)] * 2, Asked())
    page = LogPage(2, len(source.steps), 0.2)
    return run(source, source.config, page.note), page


def test_a_map_is_drawn_in_all_formats_and_equal_logs_give_equal_files(replayed, tmp_path):
    done, _ = replayed
    for folder in ("a", "b"):
        for kind in ("png", "pdf", "svg"):
            draw_log(done, tmp_path / folder / f"map.{kind}")
    for kind, begin in (("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")):
        first, second = (tmp_path / folder / f"map.{kind}" for folder in ("a", "b"))
        assert first.read_bytes().startswith(begin)
        if kind != "svg":
            assert first.read_bytes() == second.read_bytes()
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot write the picture"):
        draw_log(done, tmp_path / "file" / "map.png")


@pytest.mark.parametrize(("panels", "told"), [(6, "2 robots in 2 maps, 0 loop"), (1, "2 robots in 2 maps, 1 shown, 0")])
def test_a_picture_says_how_many_maps_it_leaves_out(replayed, monkeypatch, panels, told):
    """The log of a robot that seemed to be carried had 53 maps, of which 6 were drawn."""
    monkeypatch.setattr(log_picture, "PANELS_MAX", panels)
    with style():
        texts = [text.get_text() for text in _figure(replayed[0]).texts]
    assert any(text.startswith(told) for text in texts)


def test_the_legend_names_what_there_is(replayed):
    done, _ = replayed
    with style():
        (legend,) = _figure(done).legends
    shown = [text.get_text() for text in legend.get_texts()]
    assert (
        "mapped walls" in shown
        and {"start", "estimated pose at the end"} <= set(shown)
        and "signs, as read" not in shown
    )


def test_the_page_of_a_log_has_no_truth_and_maps_side_by_side(replayed, tmp_path):
    done, page = replayed
    times_s = np.arange(len(done.source.steps), dtype=float)
    path = page.write(
        tmp_path / "a.html", done.engine, "title", "subtitle", {"steps": 12}, times_s, [("team ATE", "0.010 m")]
    )
    text = path.read_text()
    begin = text.index('type="application/json">') + len('type="application/json">')
    data = json.loads(text[begin : text.index("</script>", begin)])
    assert data["true_poses"] is None
    assert data["figures"] == [["team ATE", "team ATE", "0.010 m"]], "names and units a person reads"
    assert "truth" not in data["layers"]
    assert len(data["estimated_poses"]) == len(times_s)
    assert data["moments"][-1]["step"] == len(times_s) - 1
    boxes = []
    for layer in data["moments"][0]["layers"]:
        left = layer["origin_m"][0] + layer["pose_building_map"][0]
        boxes.append((left, left + layer["shape"][1] * layer["resolution_m"]))
    assert len(boxes) == 2
    assert max(boxes)[0] > min(boxes)[1]


def test_the_table_of_a_replay_has_a_row_with_units_for_each_robot(replayed):
    done, _ = replayed
    rows = done.table()
    assert [row["robot"] for row in rows] == ["0", "1"]
    assert rows[0]["odometry path [m]"] == pytest.approx(2.2, abs=0.01)
    assert rows[0]["path [m]"] == pytest.approx(2.2, abs=0.1)
    assert math.isclose(rows[1]["time [s]"], 11.0)


def test_misread_texts_of_one_sign_are_one_name_and_other_signs_beside_it_keep_theirs():
    readings = [
        ("F1RE HYDRANT", 0.0),
        ("FIRE HYDRANT", 0.1),
        ("FNRE HYDRANT", 0.1),
        ("EXIT", 0.2),
        ("FIRE HYDRANT", 5.0),
    ]
    names = one_name_per_sign([(text, np.array([x, 0.0])) for text, x in readings])
    assert [name for name, _ in names] == ["F1RE HYDRANT (and 2 like it)", "EXIT", "FIRE HYDRANT"]
    assert [place[0] for _, place in names] == [0.0, 0.2, 5.0]


def test_a_robot_stands_in_its_new_map_as_soon_as_maps_are_merged():
    """Moments are ten steps apart, and the merge is between two of them."""
    grid, page = GridMap(np.full((40, 60), -20, np.int16), np.zeros(2), 0.1), LogPage(2, 1600, 0.2)
    team = SimpleNamespace(closures=[], grid_of=lambda group: grid, segments=SimpleNamespace(robots_in=tuple))
    team.keyframe_steps = lambda robot: np.zeros(0)
    engine, poses = SimpleNamespace(team=team), np.array([[1.0, 2.0, 0.0], [3.0, 2.0, 0.5]])
    engine.pose_map_robot = lambda robot: poses[robot]
    for step in range(10):
        is_merged = step >= 5
        team.groups = [SimpleNamespace(robots=own) for own in ([(0, 1)] if is_merged else [(0,), (1,)])]
        team.group_index = lambda robot, merged=is_merged: 0 if merged else robot
        team.regroupings = int(is_merged)
        page.note(step, engine)
    away_m = np.array(page._poses) - poses
    assert away_m[:5, 1, 0] == pytest.approx(6.0 + GAP_M) and away_m[5:] == pytest.approx(0.0)
