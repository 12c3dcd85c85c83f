import sys

import numpy as np
import pytest
from rapidfuzz.distance import Levenshtein

from twc_env.config import EnvConfig, override
from twc_env.errors import ConfigError
from twc_env.maps import load_map
from twc_env.world.sensors import ocr
from twc_env.world.world import World


def world(reader: str) -> World:
    return World(override(EnvConfig(), {"signs.reader": reader, "robots": 1}), load_map("twin-01"))


def test_the_real_ocr_without_the_extra_is_rejected_with_the_remedy(monkeypatch):
    ocr._engine.cache_clear()
    monkeypatch.setitem(sys.modules, "rapidocr_onnxruntime", None)
    with pytest.raises(ConfigError, match=r"pip install 'twc_env\[ocr\]'"):
        world("paddle").reset(seed=0)
    ocr._engine.cache_clear()


@pytest.mark.usefixtures("real_ocr")
def test_tall_letters_are_read_by_the_real_ocr_and_tiny_ones_are_not():
    from twc_env.world.sensors.sign_picture import FONTS, PAINTS, Plate, View

    plate = Plate(FONTS[0], *PAINTS[0], margin=0.8, fading=0.0)
    texts = ["EXIT", "A301", "LIBRARY"]
    views = [View(30.0, 0.2), View(20.0, -0.3), View(2.5, 0.0)]
    assert ocr.read_signs(texts, [plate] * 3, views, np.random.default_rng(0)) == ["EXIT", "A301", ""]


@pytest.mark.usefixtures("real_ocr")
def test_the_visible_part_of_an_occluded_sign_is_read():
    from twc_env.world.sensors.sign_picture import FONTS, PAINTS, Plate, View

    plate = Plate(FONTS[0], *PAINTS[0], margin=0.8, fading=0.0)
    (text,) = ocr.read_signs(["FIRE CABINET"], [plate], [View(30.0, 0.0, 0.0, (0.0, 0.42))], np.random.default_rng(0))
    assert "CABINET"[1:] in text
    assert "FIRE" not in text


@pytest.mark.usefixtures("real_ocr")
def test_the_real_ocr_reads_signs_in_an_episode_reproducibly():
    sign = load_map("twin-01").home.signs[0]
    normal = np.array([np.cos(sign.facing_rad), np.sin(sign.facing_rad)])
    start = [*(sign.position_m + 1.2 * normal), sign.facing_rad + np.pi]

    def read() -> list[str]:
        live = world("paddle")
        live.reset(seed=3, starts=np.array([start]))
        return [reading.text for reading in live.sense()[0].signs]

    texts = read()
    assert max(Levenshtein.normalized_similarity(text, sign.text) for text in texts) > 0.8
    assert texts == read()
