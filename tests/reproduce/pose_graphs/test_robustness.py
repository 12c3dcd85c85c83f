import numpy as np
import pytest

from tests.real_data import DATA, needs_data
from twc_env.records.geometry import between, compose, inverse
from twc_env.reproduce.pose_graphs import robustness


@pytest.fixture(scope="module")
def clean():
    """The graph of MIT, and its optimum."""
    return robustness.clean_graph(DATA / "posegraph", "MIT")[1:]


@needs_data
@pytest.mark.parametrize("kind", robustness.KINDS)
def test_false_closures_are_their_share_and_all_wrong(clean, kind):
    graph, is_true = robustness.corrupt(*clean, kind, 0.8, seed=3)
    false = ~is_true
    assert false.sum() == 80
    assert graph.is_closure[false].all()
    error = between(between(*clean[1][graph.edges[false]].transpose(1, 0, 2)), graph.measured[false])
    assert np.all((np.hypot(error[:, 0], error[:, 1]) > 0.5) | (np.abs(error[:, 2]) > np.radians(10)))


@needs_data
def test_grouped_false_closures_agree_with_each_other(clean):
    (_, best), (graph, is_true) = clean, robustness.corrupt(*clean, "grouped", 0.5, seed=0)
    edges, measured = graph.edges[~is_true], graph.measured[~is_true]
    assert np.array_equal(edges - edges[0], np.arange(20)[:, None] * [1, 1])
    claim = compose(compose(best[edges[:, 0]], measured), inverse(best[edges[:, 1]]))
    where = compose(claim, best[edges[0, 1]])
    assert np.abs(between(where[0], where)[:, 2]).max() < 0.15


@needs_data
def test_seeds_draw_different_false_closures(clean):
    first, again, other = (robustness.corrupt(*clean, "random", 0.5, seed)[0].measured for seed in (0, 0, 1))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@needs_data
def test_the_clean_optimum_of_mit_is_better_than_odometry_leads_to(clean):
    graph, best = clean
    assert graph.squared_errors(best).sum() < 45.0


@needs_data
def test_ours_survives_where_plain_least_squares_does_not(rows_of):
    words = "--datasets MIT --shares 0,0.5 --methods plain,ours --seeds 1-2 --other-seeds 1-2 --jobs 1"
    rows = rows_of(robustness, *words.split())
    assert list(rows[0])[:4] == ["dataset", "false_kind", "false_share", "method"]
    assert len(rows) == 6
    for row in rows:
        if row["method"] == "ours":
            assert row["ate_m"] < 0.15
            assert row["precision"] >= 0.995
        elif row["false_share"]:
            assert row["ate_m"] > 1.0
            assert row["precision"] == pytest.approx(0.5)
    assert {row["seeds"] for row in rows if row["false_share"]} == {2}
