from twc_env.reproduce.twc import matching


def test_candidates_are_verified_with_a_guess_and_without(rows_of):
    table = rows_of(matching, "--buildings", "1", "--pairs", "2", "--points", "180")
    assert [(row["task"], row["method"], row["guess"]) for row in table] == [
        ("match", "point-to-line", "with"),
        ("match", "point-to-line", "without"),
        ("match", "point-to-line", "far"),
        ("match", "point-to-point", "with"),
        ("match", "point-to-point", "far"),
        ("verify", "point-to-line", "with"),
        ("verify", "point-to-line", "without"),
    ]
    assert all(row["pairs"] == 2 and row["time_ms"] > 0 for row in table)
    assert all(row["found"] == 1.0 for row in table if row["method"] == "point-to-line" and row["guess"] != "far")
