from twc_env.reproduce.logs import odometry_noise


def test_a_row_is_the_mean_over_the_draws_of_one_log_and_size(rows_of, monkeypatch):
    def drive(name, size, seed):
        return {"ate_m": size + 0.1 * seed + (name == "intel"), "odometry_ate_m": 10.0 * size}

    monkeypatch.setattr(odometry_noise, "drive_again", drive)
    table = rows_of(odometry_noise, "--logs", "intel,aces", "--sizes", "0", "2", "--seeds", "0-2")
    assert [(row["log"], row["size"], row["draws"]) for row in table] == [
        ("intel", 0.0, 3), ("intel", 2.0, 3), ("aces", 0.0, 3), ("aces", 2.0, 3),
    ]  # fmt: skip
    assert [round(row["ate_m"], 6) for row in table] == [1.1, 3.1, 0.1, 2.1]
    assert [round(row["ate_max_m"], 6) for row in table] == [1.2, 3.2, 0.2, 2.2]
    assert all(round(row["ate_std_m"], 4) == 0.0816 for row in table) and table[1]["odometry_ate_m"] == 20.0
