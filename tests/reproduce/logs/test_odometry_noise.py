from twc_env.reproduce.logs import odometry_noise


def test_a_row_is_the_mean_over_the_draws_of_one_log_size_and_noise(rows_of, monkeypatch, tmp_path):
    def drive(name, size, seed, is_noise_told):
        return {
            "ate_m": size + 0.1 * seed + (name == "intel") + 10.0 * is_noise_told,
            "odometry_ate_m": 10.0 * size,
        }

    monkeypatch.setattr(odometry_noise, "drive_again", drive)
    monkeypatch.setenv("TWC_DATA", str(tmp_path))  # of which nothing is read
    table = rows_of(odometry_noise, "--logs", "intel,aces", "--sizes", "0", "2", "--seeds", "0-2")
    assert [(row["log"], row["size"], row["noise"], row["draws"]) for row in table] == [
        (log, size, noise, 3) for log in ("intel", "aces") for size in (0.0, 2.0) for noise in ("assumed", "from log")
    ]
    assert [round(row["ate_m"], 6) for row in table] == [1.1, 11.1, 3.1, 13.1, 0.1, 10.1, 2.1, 12.1]
    assert [round(row["ate_max_m"], 6) for row in table] == [1.2, 11.2, 3.2, 13.2, 0.2, 10.2, 2.2, 12.2]
    assert all(round(row["ate_std_m"], 4) == 0.0816 for row in table) and table[2]["odometry_ate_m"] == 20.0
