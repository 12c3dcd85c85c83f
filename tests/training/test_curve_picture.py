"""The picture of a learning curve, and the scripted teams in it."""

import json

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
