import dataclasses
import json

import numpy as np
import pytest
from scipy import integrate

from twc_env.errors import DataError
from twc_env.world.sensors.misreading import TableReader, codes_of, draw_count
from twc_env.world.sensors.ocr_table import SHIPPED, load_table

TEXT = "A301 OPTICS LAB"


def readings(table=None, text=TEXT, count=2000, height_px=12.0, incidence=0.0, blur_px=0.0, hidden=(), seed=0):
    reader, random = TableReader(table or load_table()), np.random.default_rng(seed)
    is_hidden = np.isin(np.arange(len(text)), hidden)
    draws = random.standard_normal((count, draw_count(text)))
    return [reader.read(codes_of(text), is_hidden, height_px, incidence, blur_px, z) for z in draws]


def flat(**values):
    """The shipped table with some rates replaced by constants."""
    table = load_table()
    if "miss" in values:
        table = dataclasses.replace(table, miss_length_exponent=0.0)
    changed = {key: np.full_like(getattr(table, key), value) for key, value in values.items()}
    return dataclasses.replace(table, **changed)


def at_level(rate: float, **values):
    """A table with one character error rate for all lines."""
    table = flat(miss=0.0, fragment=0.0, space_loss=0.0, proneness=1.0, **values)
    return dataclasses.replace(
        table, level_rate=np.array([rate]), level_cdf=np.ones((*table.miss.shape, 1)), edit_cdf=table.edit_cdf[:1]
    )


def test_the_shipped_table_is_small_says_how_it_was_made_and_holds_probabilities():
    assert SHIPPED.stat().st_size < 300_000
    made = json.loads(SHIPPED.read_text())["made"]
    assert made["command"].startswith("twc-env ocr measure")
    assert made["signs_read"] > 5000
    table = load_table()
    for rates in (table.miss, table.fragment, table.space_loss, table.level_cdf, table.confusion_cdf):
        assert rates.min() >= 0.0
        assert rates.max() <= 1.0 + 1e-9
    assert np.allclose(table.level_cdf[..., -1], 1.0)
    assert 0.0 <= table.line_share <= 1.0
    assert 0.0 <= table.letter_share <= 1.0


def test_a_file_that_is_no_table_is_rejected_with_the_remedy(tmp_path):
    path = tmp_path / "table.json"
    path.write_text("{}")
    with pytest.raises(DataError, match="ocr measure"):
        load_table(path)
    with pytest.raises(DataError, match="cannot read"):
        load_table(tmp_path / "none.json")


def test_without_errors_in_the_table_every_text_is_read_right():
    assert set(readings(at_level(0.0), count=50)) == {TEXT}


def test_lines_are_missed_at_the_rate_of_the_table():
    seen = readings(flat(miss=0.3))
    assert np.mean([not text for text in seen]) == pytest.approx(0.3, abs=0.03)


def test_characters_are_wrong_at_the_rate_of_their_level():
    table = dataclasses.replace(at_level(0.2), edit_cdf=np.array([[1.0, 1.0]]))  # substitutions only
    seen = readings(table, "X" * 20)
    assert np.mean([20 - text.count("X") for text in seen]) / 20 == pytest.approx(0.2, abs=0.01)


def test_deletions_shorten_and_insertions_lengthen_a_text():
    lost = readings(dataclasses.replace(at_level(0.2), edit_cdf=np.array([[0.0, 1.0]])), "X" * 20)
    more = readings(dataclasses.replace(at_level(0.2), edit_cdf=np.array([[0.0, 0.0]])), "X" * 20)
    assert np.mean([len(text) for text in lost]) == pytest.approx(16.0, abs=0.2)
    assert np.mean([len(text) for text in more]) == pytest.approx(24.0, abs=0.2)


def test_rates_between_grid_points_are_interpolated():
    table = flat(miss=0.0)
    table.miss[3], table.miss[4] = 0.8, 0.2
    middle = float(table.height_px[3:5].mean())
    seen = readings(table, height_px=middle)
    assert np.mean([not text for text in seen]) == pytest.approx(0.5, abs=0.04)


def test_a_fragment_is_the_beginning_or_the_end_of_the_text():
    table = dataclasses.replace(at_level(0.0), fragment=np.ones_like(load_table().fragment))
    seen = readings(table)
    assert all(TEXT.startswith(text) or TEXT.endswith(text) for text in seen)
    shares = [len(text) / len(TEXT) for text in seen]
    assert np.mean(shares) == pytest.approx(integrate.trapezoid(load_table().kept, dx=0.1), abs=0.07)


def test_spaces_are_deleted_independently():
    table = dataclasses.replace(at_level(0.0), space_loss=np.full_like(load_table().space_loss, 9.0))
    assert set(readings(table, count=50)) == {"A301OPTICSLAB"}


def test_hidden_characters_are_not_read():
    assert set(readings(at_level(0.0), hidden=range(5), count=50)) == {"OPTICS LAB"}
    assert set(readings(at_level(0.0), hidden=range(len(TEXT)), count=50)) == {""}


def test_any_text_of_any_script_can_be_read():
    for text in ("Кафе 东 9", "a", "é" * 60):
        assert all(isinstance(seen, str) for seen in readings(text=text, count=200, height_px=7.0))


def test_the_same_draws_give_the_same_reading():
    assert readings(count=50, height_px=7.0) == readings(count=50, height_px=7.0)
    assert readings(count=50, height_px=7.0) != readings(count=50, height_px=7.0, seed=1)


def test_readings_get_worse_with_smaller_letters_steeper_views_and_blur():
    def right(**view):
        return np.mean([seen == TEXT for seen in readings(**view)])

    assert right(height_px=20.0) > right(height_px=8.0) > right(height_px=5.0)
    assert right(height_px=9.0) > right(height_px=9.0, incidence=0.96) > right(height_px=9.0, incidence=1.13)
    assert right(height_px=20.0) > right(height_px=20.0, blur_px=8.0) + 0.3


def test_confusions_are_of_the_characters_own_kind():
    table = dataclasses.replace(at_level(0.2), edit_cdf=np.array([[1.0, 1.0]]))
    seen = [c for text in readings(table, "0000") for c in text if c != "0"]
    assert (seen.count("O") + seen.count("8")) / len(seen) > 0.3


def test_short_texts_are_missed_more_often_than_long_ones():
    shares = [np.mean([not seen for seen in readings(text="X" * n, height_px=6.0)]) for n in (4, 10, 18)]
    assert shares[0] > shares[1] + 0.05 > shares[2] + 0.1


def test_a_space_beside_a_digit_is_deleted_more_often():
    kept = [np.mean([" " in seen for seen in readings(text=t, height_px=12.0)]) for t in ("LX XL", "L1 1L")]
    assert kept[0] > kept[1] + 0.1
