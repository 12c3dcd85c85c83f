"""Coverage over time: means, bands and files."""

import numpy as np
import pytest

from twc_env.pictures.curves import SAMPLES, coverage_figure, draw_coverage, sampled


def test_curves_are_sampled_with_what_was_known_at_each_time():
    curve = sampled(np.array([0, 50, 100]), np.array([0.0, 0.5, 0.75]), 200)
    assert len(curve) == SAMPLES
    assert (curve[0], curve[24], curve[25], curve[49], curve[50], curve[-1]) == (0.0, 0.0, 0.5, 0.5, 0.75, 0.75)


def test_each_team_has_its_curve_band_and_entry(tmp_path):
    pytest.importorskip("matplotlib")
    values = np.linspace(0, 1, SAMPLES) * np.array([[1.0], [0.8], [0.9]])
    figure = coverage_figure({"first": values, "alone": values[:1]}, 60.0, "a title")
    (axes,) = figure.axes
    assert [line.get_label() for line in axes.lines] == ["first (3)", "alone (1)"]
    assert len(axes.collections) == 1  # one episode has no interval
    assert axes.lines[0].get_ydata()[-1] == pytest.approx(90.0) and axes.get_xlabel() == "simulated time [s]"
    assert len({line.get_color() for line in axes.lines}) == 2
    path = draw_coverage({"first": values}, 60.0, tmp_path / "new" / "a.pdf", "a title")
    assert path.read_bytes().startswith(b"%PDF")
