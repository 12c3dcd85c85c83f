"""A result in people's hands: short table, dictionary, files, tables of pandas."""

import csv
import dataclasses
import json

import numpy as np
import pytest

import twc_env
from twc_env.bench.rates import wander
from twc_env.exploration.assessment.result_table import FIGURES, text_of


@pytest.fixture(scope="module")
def result():
    env = twc_env.parallel_env(map="twin-02", robots=2, max_cycles=30, config={"lidar.beam_count": 60})
    env.reset(seed=3)
    for actions in wander(env, 3):
        env.step(actions)
    return env.result()


def test_a_result_prints_a_short_table_with_units(result):
    lines = str(result).splitlines()
    assert lines[0] == "twin-02, seed 3, 2 robots, 30 steps"
    assert len(lines) <= 30 and max(map(len, lines)) <= 100
    assert f"team ATE {result.figures['team_ate_m']:.3f} m" in [" ".join(line.split()) for line in lines]


def test_odometry_is_explained_where_the_team_is_not_merged_and_nowhere_else(result):
    apart = {**result.figures, "merged_robots": 1, "lacked": ["no sign read by both"]}
    told = text_of(apart)
    assert "no sign read by both" in told and "odometry-only figures know the true relative starts" in told
    assert "odometry-only figures know" not in text_of({**result.figures, "merged_robots": 2})


def test_a_result_reads_like_the_dictionary_of_its_figures(result):
    assert dict(result) == result.figures
    assert "team_ate_m" in result and "nothing" not in result and len(result) == len(result.figures)


def test_a_notebook_shows_the_table_and_the_picture(result):
    pytest.importorskip("matplotlib")
    html = dataclasses.replace(result, figures={**result.figures, "map": "<b>"})._repr_html_()
    assert html.count("<tr>") == len([key for _, key, _ in FIGURES if key in result]) and "&lt;b&gt;" in html
    assert result.plot()._repr_png_().startswith(b"\x89PNG")


def test_a_file_given_to_plot_is_an_error_that_says_how_it_is_written(result):
    pytest.importorskip("matplotlib")
    with pytest.raises(twc_env.ConfigError, match=r"dpi must be a number .* got 'map\.png': plot\(\)\.savefig\(FILE\)"):
        result.plot("map.png")


def test_tables_of_pandas_hold_the_figures_and_the_paths_in_the_building_frame(result):
    pandas = pytest.importorskip("pandas")
    figures = result.to_frame()
    assert figures.shape[0] == 1 and figures["team_ate_m"][0] == result.figures["team_ate_m"]
    assert figures["closures.accepted"][0] == result.figures["closures"]["accepted"]
    assert len(pandas.concat([figures, figures])) == 2
    paths = result.to_frame("paths")
    assert len(paths) == 31 * 2
    last = paths[(paths.robot == 1) & (paths.time_s == 3.0)].iloc[0]
    assert last.true_x_m == result.true_poses[30, 1, 0]
    errors_m = np.hypot(paths.estimated_x_m - paths.true_x_m, paths.estimated_y_m - paths.true_y_m)
    assert float(np.sqrt((errors_m**2).mean())) == pytest.approx(result.figures["team_ate_m"], abs=0.003)
    with pytest.raises(twc_env.ConfigError, match="figures and paths"):
        result.to_frame("robots")


def test_without_pandas_the_error_names_the_remedy(result, monkeypatch):
    monkeypatch.setattr("twc_env.exploration.assessment.result_files.find_spec", lambda name: None)
    with pytest.raises(twc_env.ConfigError, match=r"pip install 'twc_env\[viz\]'"):
        result.to_frame()


def test_saving_writes_and_names_every_file(result, tmp_path):
    pytest.importorskip("matplotlib")
    paths = result.save(tmp_path / "deep" / "folder", format="svg")
    assert [path.name for path in paths] == [
        "report.json", "config.json", "figures.csv", "figures.tex", "paths.csv", "map.svg"
    ]  # fmt: skip
    assert sorted(paths) == sorted((tmp_path / "deep" / "folder").iterdir())
    assert json.loads(paths[0].read_text())["team_ate_m"] == result.figures["team_ate_m"]
    (row,) = csv.DictReader(paths[2].read_text().splitlines())
    assert float(row["team_ate_m"]) == result.figures["team_ate_m"]
    rows = list(csv.DictReader(paths[4].read_text().splitlines()))
    assert len(rows) == 62 and float(rows[-1]["true_y_m"]) == result.true_poses[-1, 1, 1]
    tex = paths[3].read_text()
    assert tex.startswith("\\begin{tabular}{lr}") and "\\%" in tex and tex.count("&") == tex.count("\\\\")
    (tmp_path / "file").touch()
    with pytest.raises(twc_env.DataError, match="cannot write"):
        result.save(tmp_path / "file")
    with pytest.raises(twc_env.ConfigError, match="png, pdf, svg"):
        result.save(tmp_path, format="bmp")
