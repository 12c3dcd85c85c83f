KEYS = [
    "travel_km", "places", "memory_kib", "scan_ms", "scan_ms_max", "error_mean_m", "odometry_mean_m", "error_sd_m",
    "seeds",
]  # fmt: skip


def test_the_command_writes_a_row_for_each_stretch_and_says_how_fast_similarity_is(written, capsys):
    rows = written("radio-scale", "--seeds", "0", "--length", "200", "--stored", "100")
    assert [list(row) for row in rows] == [KEYS] * 10
    assert rows[-1]["travel_km"] == 0.2 and rows[-1]["places"] > rows[0]["places"]
    assert "one against 100 stored" in capsys.readouterr().out
