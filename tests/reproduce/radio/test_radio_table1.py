import re

import numpy as np
import pytest

from twc_env.__main__ import main
from twc_env.maps import load_map
from twc_env.records.json_values import plain
from twc_env.records.messages import GridMap
from twc_env.reproduce.radio import radio_figures, radio_sweep, radio_table1, radio_walks
from twc_env.reproduce.radio.radio_methods import Outcome, odometry
from twc_env.reproduce.radio.radio_twins import PLACES, true_path

KEYS = ["environment", "method", "error_mean_m", "error_std_m", "ate_m", "paper_mean_m", "paper_std_m", "seeds"]


def test_the_command_writes_its_rows(written, capsys):
    words = ["--seeds=0", "--places=semi-indoor", "--share=0.4", "--methods=odometry,wifi", "--jobs=1"]
    rows = written("radio-table1", *words)
    assert [list(row) for row in rows] == [KEYS] * 2
    assert rows[0]["error_mean_m"] == pytest.approx(0.4 * 51.98, rel=0.02)
    assert rows[1]["error_mean_m"] < rows[0]["error_mean_m"]
    assert (rows[1]["paper_mean_m"], rows[1]["paper_std_m"]) == (4.48, 2.98)
    told = capsys.readouterr().out
    assert "worse than its odometry in 0 of 1" in told
    nearest_m, process_m = (float(m) for m in re.findall(r"located to ([\d.]+) m by its map, [nG]", told))
    assert max(nearest_m, process_m) < rows[1]["error_mean_m"] + 5.0


def test_the_sweep_walks_any_share_of_each_case(written, monkeypatch):
    fewer = {"AP_SHARES": (0.5,), "ODOMETRY_ERRORS_M": (52.0,), "LENGTHS_M": (300.0,)}
    for name, value in {**fewer, "METHODS": {"odometry": odometry}}.items():
        monkeypatch.setattr(radio_sweep, name, value)
    rows = written("radio-table1", "--sweep", "--seeds=0-3", "--share=0.1", "--jobs=1")
    assert [list(row) for row in rows] == [KEYS] * 3
    errors_m = 51.98, 52.0, 51.98 * 300.0 / PLACES["semi-indoor"].length_m
    assert [row["error_mean_m"] for row in rows] == pytest.approx(0.1 * np.array(errors_m), rel=0.02)


def test_pictures_are_drawn_of_what_an_earlier_run_found(tmp_path, monkeypatch, capsys):
    command = ["reproduce", "radio-table1", "--seeds=1-1", "--places=semi-indoor", "--share=0.2", "--jobs=1"]
    command += ["--methods=odometry,wifi,wifi+lidar", "--cache", str(tmp_path / "cache")]
    main(command)
    monkeypatch.setattr(radio_table1, "outcomes", lambda *_: pytest.fail("worked out again"))
    main([*command, "--out", str(tmp_path / "pictures"), "--json", str(tmp_path / "alone" / "rows.json")])
    main([*command, "--json", str(tmp_path / "rows" / "rows.json"), "--format", "pdf"])
    names = [f"semi-indoor-{what}.png" for what in ("map", "models", "trajectories")]
    assert [path.name for path in sorted((tmp_path / "pictures").iterdir())] == names
    names = [name.replace(".png", ".pdf") for name in names]
    assert [path.name for path in sorted((tmp_path / "rows").iterdir())] == ["rows.json", *names]
    assert (tmp_path / "rows" / names[0]).read_bytes().startswith(b"%PDF")
    assert [path.name for path in (tmp_path / "alone").iterdir()] == ["rows.json"]
    assert str(tmp_path / "rows" / names[0]) in capsys.readouterr().out


def test_a_map_is_drawn_from_its_start_with_the_true_walls_over_it(tmp_path, monkeypatch):
    start = np.array([[40.0, 30.0, np.pi / 2], [40.0, 31.0, np.pi / 2]])
    grid = GridMap(np.zeros((200, 100), np.int16), np.array([-20.0, -50.0]), 0.5)
    walk = plain(radio_figures.content_of({"wifi+lidar": Outcome(start, start, grid=grid)}))
    figures = []
    new_figure = radio_figures.new_figure
    monkeypatch.setattr(radio_figures, "new_figure", lambda *a, **k: figures.append(new_figure(*a, **k)) or figures[-1])
    assert radio_figures.draw(tmp_path, "there", "radio-ntu", walk) == [tmp_path / "there-map.png"]
    (axes,) = figures[0].axes
    assert (axes.get_xlim(), axes.get_ylim()) == ((-20.0, 30.0), (-50.0, 50.0))
    drawn, true = axes.lines[0].get_xydata(), load_map("radio-ntu").walls_m[0]
    assert drawn[0] == pytest.approx([true[0, 1] - 30.0, 40.0 - true[0, 0]])  # the map's x points to the twin's y


def test_a_walk_has_the_printed_length_and_speed_and_turns_no_faster_than_the_robot_can():
    place = PLACES["semi-indoor"]
    poses = true_path(place, 3)
    steps = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1)
    assert steps.sum() == pytest.approx(place.length_m, rel=0.01)
    assert steps.max() <= place.speed_m_s * radio_walks.ODOMETRY_STEP_S * 1.01
    turns = np.abs((np.diff(poses[:, 2]) + np.pi) % (2 * np.pi) - np.pi)
    assert turns.max() <= radio_walks.TURN_RATE_RAD_S * radio_walks.ODOMETRY_STEP_S + 1e-9
