"""The picture of a learning curve, and the scripted teams in it."""

import json

import pytest

pytestmark = pytest.mark.usefixtures("torch")


def test_references_are_played_once_and_kept_in_the_run_folder(task, tmp_path, monkeypatch):
    from twc_env.training import references

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
    from twc_env.training.curve_picture import draw_curve

    path = draw_curve(run, {"random": 0.1, "informed": 0.9}, "ppo")
    assert path == run / "curve.png" and path.read_bytes().startswith(b"\x89PNG")
    path.unlink()
