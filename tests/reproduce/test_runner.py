import numpy as np
import pytest

from twc_env.errors import ConfigError, DataError
from twc_env.reproduce.runner import Runner, data_folder, parse_seeds, print_rows


def test_finished_parts_are_read_back_after_an_interruption(tmp_path):
    done = []

    def work(part):
        if part == 2 and len(done) == 2:
            raise KeyboardInterrupt
        done.append(part)
        return {"value": np.float64(part)}

    with pytest.raises(KeyboardInterrupt):
        Runner("table", tmp_path, {"a": 1}).each(range(4), work)
    rows = Runner("table", tmp_path, {"a": 1}).each(range(4), lambda part: work(part) if part != 2 else {"value": 2.0})
    assert rows == [{"value": 0.0}, {"value": 1.0}, {"value": 2.0}, {"value": 3.0}]
    assert done == [0, 1, 3]


def test_other_settings_start_anew(tmp_path):
    Runner("table", tmp_path, {"a": 1}).each([0], lambda _: 1)
    assert Runner("table", tmp_path, {"a": 2}).each([0], lambda _: 2) == [2]


def test_rows_are_printed_in_aligned_columns(capsys):
    print_rows([{"method": "twc", "recall": 0.987654}, {"method": "a longer name", "recall": None}])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].index("recall") == lines[1].index("0.9877") == lines[2].index("-")


def test_seeds_are_a_count_or_a_range():
    assert parse_seeds("3") == [0, 1, 2] and parse_seeds("4-6") == [4, 5, 6]
    with pytest.raises(ConfigError, match="got 'many'"):
        parse_seeds("many")


def test_a_missing_data_folder_is_named(monkeypatch):
    monkeypatch.delenv("TWC_DATA", raising=False)
    with pytest.raises(DataError, match="set TWC_DATA"):
        data_folder()


def square(part):
    return part * part


def test_several_processes_give_the_same_rows_in_the_same_order(tmp_path):
    alone, together = (
        Runner("squares", tmp_path / str(count), {}).each([3, 1, 2], square, processes=count) for count in (1, 2)
    )
    assert alone == together == [9, 1, 4]


def test_parts_of_another_code_are_not_taken(tmp_path, monkeypatch, capsys):
    Runner("table", tmp_path, {}).each([0], lambda _: 1)
    monkeypatch.setattr("twc_env.finished_parts.code_digest", lambda: "other")
    capsys.readouterr()
    assert Runner("table", tmp_path, {}).each([0], lambda _: 2) == [2]
    assert "1 finished parts were computed by other code" in capsys.readouterr().err
