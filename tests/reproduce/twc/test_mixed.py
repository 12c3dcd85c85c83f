"""The table of mixed teams."""

from twc_env.reproduce.twc import mixed


def test_a_row_has_the_means_over_the_seeds_of_a_building(rows_of):
    words = ["--buildings", "twin-01", "--seeds", "0-1", "--steps", "40", "--team", "handheld,wheeled"]
    (row,) = rows_of(mixed, *words)
    robots = 2
    settings = {"map": "twin-01", "team": "handheld,wheeled", "max_cycles": 40}
    runs = [mixed._episode(settings, seed, robots) for seed in (0, 1)]
    assert (row["building"], row["seeds"], row["wrong"]) == ("twin-01", 2, 0)
    assert row["merged_share"] == sum(run["merged"] == robots for run in runs) / 2
    assert row["ate_max_m"] == round(max(run["ate_m"] for run in runs), 4) >= row["ate_m"] > 0.0
    assert row["coverage_correct"] == round(sum(run["coverage_correct"] for run in runs) / 2, 4) > 0.05
