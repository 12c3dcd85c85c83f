"""The picture of a learning curve, and the scripted teams in it."""

import json

import numpy as np
import pytest

pytestmark = pytest.mark.usefixtures("torch")


def test_references_are_played_once_and_kept_in_the_run_folder(task, tmp_path, monkeypatch):
    from twc_env.suite import references

    played = []

    def scripted(task, team, number, split):
        played.append((team, number, split))
        return type("Episode", (), {"mean_coverage": 0.1 * len(played)})

    monkeypatch.setattr(references, "scripted", scripted)
    means = references.references(task, tmp_path, 2, show_progress=False)
    assert {team for team, _, _ in played} == {"random", "information-gain", "informed"}
    assert {split for _, _, split in played} == {"validation"} and len(played) == 6
    assert means["random"] == pytest.approx(0.15)
    assert references.references(task, tmp_path, 2, show_progress=False) == means and len(played) == 6
    (tmp_path / "references.json").write_text("{")
    references.references(task, tmp_path, 1, show_progress=False)
    assert len(played) == 9 and json.loads((tmp_path / "references.json").read_text())["of"]["buildings"] == 1


def test_the_curve_is_drawn_with_its_references(run):
    pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
    from twc_env.suite.curve_picture import draw_curve

    path = draw_curve(run, {"random": 0.1, "informed": 0.9}, "ppo")
    assert path == run / "curve.png" and path.read_bytes().startswith(b"\x89PNG")
    path.unlink()


def test_a_curve_of_one_point_is_seen_and_its_legend_counts_the_episodes(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
    from twc_env.pictures import style
    from twc_env.suite.curve_picture import draw_curve

    figures = []
    monkeypatch.setattr(style, "save_figure", lambda figure, path: figures.append(figure) or path)
    (tmp_path / "metrics.csv").write_text("decisions,episodes,mean_coverage\n1488,0,nan\n2001,1,0.8684\n")
    draw_curve(tmp_path, {}, "mappo")
    (line,) = figures[0].axes[0].lines
    assert line.get_marker() == "o" and list(line.get_ydata()) == pytest.approx([86.84])
    assert line.get_label() == "in training, last 1 episodes"


def test_after_a_wrong_merge_the_coverage_shown_is_the_end_of_that_whose_mean_is_shown():
    from twc_env.training.episode_totals import EpisodeTotals
    from twc_env.training.learning_curve import SHOWN

    totals, ended = EpisodeTotals(1), {}
    for gain in (0.4, -0.4):  # the map that is lost was paid for
        info = {"reward_terms": {"coverage": gain}, "time_steps": 10, "coverage_correct": 0.8, "merged_robots": 2}
        info |= {"wrong_merges": 1, "team_ate_m": 9.0}
        ended = totals.add(0, np.array([gain / 2]), np.array([gain]), [info], gain < 0)
    assert (ended[SHOWN["coverage"]], ended[SHOWN["mean_coverage"]]) == (0.0, 0.0)
