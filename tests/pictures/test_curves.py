"""Coverage over time: means, bands and files."""

import numpy as np
import pytest

from twc_env.pictures.curves import SAMPLES, coverage_figure, draw_coverage, sampled


def test_curves_are_sampled_with_what_was_known_at_each_time():
    curve = sampled(np.array([0, 50, 100]), np.array([0.0, 0.5, 0.75]), 200)
    assert len(curve) == SAMPLES
    assert (curve[0], curve[24], curve[25], curve[49], curve[50], curve[-1]) == (0.0, 0.0, 0.5, 0.5, 0.75, 0.75)


def test_a_curve_begins_with_what_was_known_first():
    pytest.importorskip("matplotlib")
    curve = sampled(np.array([10, 50]), np.array([0.2, 0.5]), 500)
    assert curve[:4] == [None, None, 0.2, 0.2]
    (axes,) = coverage_figure({"team": [curve, curve]}, 50.0, "a title").axes
    assert (axes.lines[0].get_xdata()[0], axes.lines[0].get_ydata()[0]) == pytest.approx((1.0, 20.0))
    assert axes.collections[0].get_datalim(axes.transData).x0 == pytest.approx(1.0)


@pytest.mark.parametrize(("counts", "told"), [
    ((1, 1), []), ((2, 1), ["95 % interval of 2 episodes"]), ((5, 7), ["95 % interval of the mean"]),
])  # fmt: skip
def test_the_legend_names_the_band_and_tells_of_few_episodes(counts, told):
    pytest.importorskip("matplotlib")
    curves = {f"team {k}": np.full((count, SAMPLES), 0.5) for k, count in enumerate(counts)}
    (legend,) = coverage_figure(curves, 60.0, "a title").legends
    assert [text.get_text() for text in legend.get_texts()][2:] == told


def test_each_team_has_its_curve_band_and_entry(tmp_path):
    pytest.importorskip("matplotlib")
    values = np.linspace(0, 1, SAMPLES) * np.array([[1.0], [0.8], [0.9]])
    figure = coverage_figure({"first": values, "alone": values[:1]}, 60.0, "a title")
    (axes,) = figure.axes
    assert [line.get_label() for line in axes.lines] == ["first (3 episodes)", "alone (1 episode)"]
    assert len(axes.collections) == 1  # one episode has no interval
    assert axes.lines[0].get_ydata()[-1] == pytest.approx(90.0) and axes.get_xlabel() == "simulated time [s]"
    assert axes.get_ylabel() == "floor in a correctly merged map [%]"
    assert len({line.get_color() for line in axes.lines}) == 2
    path = draw_coverage({"first": values}, 60.0, tmp_path / "new" / "a.pdf", "a title")
    assert path.read_bytes().startswith(b"%PDF")
