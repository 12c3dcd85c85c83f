import numpy as np
import pytest

from twc_env.reproduce.ocr import ocr, ocr_measure
from twc_env.reproduce.ocr.ocr_alignment import Aligned
from twc_env.world.sensors.misreading import TableReader, codes_of, draw_count
from twc_env.world.sensors.ocr_table import load_table, table_of


def test_the_texts_that_evaluate_the_table_share_no_word_with_those_that_made_it():
    made_of = {word for text in ocr_measure.WORDS for word in text.split() if len(word) > 2}
    held_out = {word for text in ocr.held_out_texts() for word in text.split()}
    assert not made_of & held_out
    assert len(held_out) > 60


@pytest.mark.parametrize(
    ("truth", "reading", "expected"),
    [
        ("FIRE CABINET", "FIRECABINET", {"spaces_lost": [4], "wrong": [], "is_fragment": False}),
        ("FIRE CABINET", "fire cabinet", {"spaces_lost": [], "wrong": []}),
        ("FIRE CABINET", "F1RE CABINE", {"wrong": [1, 11], "is_fragment": False}),
        ("FIRE CABINET", "CABINET", {"is_fragment": True, "keeps_begin": False, "wrong": [], "kept_share": 7 / 12}),
        ("FIRE CABINET", "FIRE", {"is_fragment": True, "keeps_begin": True, "wrong": []}),
        ("EXIT", "EXXIT", {"wrong": [1]}),
        ("EXIT", "", {"is_missed": True, "letters": [], "is_fragment": False}),
    ],
)
def test_a_reading_is_laid_along_its_truth(truth, reading, expected):
    aligned = Aligned(truth, reading)
    assert {key: getattr(aligned, key) for key in expected} == expected


def test_a_table_fitted_to_drawn_readings_gives_back_their_rates():
    reader, random = TableReader(load_table()), np.random.default_rng(0)
    read, places = [], []
    for height_px in ocr_measure.HEIGHT_PX:
        for degrees in ocr_measure.INCIDENCE_DEG:
            for blur in ocr_measure.BLUR_WIDTHS:
                angle = np.radians(degrees)
                lines = []
                for _ in range(40):
                    text = ocr_measure.sign_text(random)
                    draws, hidden = random.standard_normal(draw_count(text)), np.zeros(len(text), np.bool_)
                    blur_px = blur * height_px * np.cos(angle)
                    lines.append((text, reader.read(codes_of(text), hidden, height_px, angle, blur_px, draws)))
                read.append(lines)
                places.append(np.mean([text == reading for text, reading in lines]))
    fitted = table_of(ocr_measure.fit(read) | {"line_share": 0.0, "letter_share": 0.0})
    truth = load_table()
    assert np.abs(fitted.miss - truth.miss).mean() < 0.06
    assert np.abs(fitted.miss - truth.miss).max() < 0.35
    assert np.abs(fitted.space_loss - truth.space_loss)[4:, :3, 0].mean() < 0.13
    rate = [np.diff(t.level_cdf, axis=-1, prepend=0.0) @ t.level_rate for t in (fitted, truth)]
    assert np.abs(rate[0] - rate[1])[4:, :3, 0].mean() < 0.02


@pytest.mark.usefixtures("real_ocr")
def test_an_interrupted_measurement_goes_on_where_it_stopped(tmp_path, monkeypatch):
    read = []

    def read_some(texts, plates, views, random):
        read.append(len(texts))
        return [text[:-1] + "8" if view.height_px < 8.0 else text for text, view in zip(texts, views, strict=True)]

    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(ocr_measure, "HEIGHT_PX", (6.0, 20.0))
    monkeypatch.setattr(ocr_measure, "INCIDENCE_DEG", (0.0, 60.0))
    monkeypatch.setattr(ocr_measure, "BLUR_WIDTHS", (0.0, 0.5))
    monkeypatch.setattr(ocr_measure, "read_signs", read_some)
    ocr_measure.measure(tmp_path / "a.json", 0, 8, tmp_path / "cache")
    assert sum(read) == 8 * 2 * 2 * (2 + 1) + 3 * 4 * 32  # low lettering is read twice as often
    monkeypatch.setattr(ocr_measure, "read_signs", stop)
    ocr_measure.measure(tmp_path / "b.json", 0, 8, tmp_path / "cache")
    assert (tmp_path / "a.json").read_text() == (tmp_path / "b.json").read_text()
    with pytest.raises(KeyboardInterrupt):
        ocr_measure.measure(tmp_path / "c.json", 1, 8, tmp_path / "cache")
    table = load_table(tmp_path / "a.json")
    assert table.level_cdf[0, 0, 0, :-2].max() > table.level_cdf[1, 0, 0, :-2].max()
    assert table.letter_share > 0.5


@pytest.mark.usefixtures("real_ocr")
def test_the_table_of_comparisons_has_the_promised_rows(rows_of, monkeypatch):
    monkeypatch.setattr(ocr, "DISTANCES_M", (1.0, 6.0))
    monkeypatch.setattr(ocr, "held_out_texts", lambda: ["EXIT", "A301 OPTICS LAB"])
    near, far = rows_of(ocr, "--signs", "8")
    assert list(near) == ["distance_m", "exact_real", "exact_fast", "similarity_real", "similarity_fast"]
    assert near["similarity_real"] > far["similarity_real"]
    assert near["similarity_fast"] > far["similarity_fast"]
    assert any("largest difference" in line for line in ocr.remarks([near, far]))
