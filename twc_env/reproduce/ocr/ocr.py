"""Validation of the fast misreading model against the real OCR, by distance, on signs not used for its table.

Held-out texts (of the bundled twins and the test split) are seen from distances within half a metre of each band, from
all directions in the camera's reading range, by a robot that often turns. The real OCR reads a rendered image of each;
the fast model samples from the measured table for the same views. Reported are the share of texts read exactly and the
mean Levenshtein similarity (papers.md T4) to the true text, ignoring case; a text not read at all has similarity 0.
"""

from __future__ import annotations

import argparse
import json
import zlib
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import SignsConfig
from twc_env.errors import DataError
from twc_env.maps import load_map
from twc_env.records.random_streams import random_stream
from twc_env.reproduce.runner import Runner, data_folder
from twc_env.running.options import count, natural, number
from twc_env.slam.places.text_similarity import normalise, text_similarity
from twc_env.world.sensors.misreading import TableReader, codes_of, draw_count
from twc_env.world.sensors.ocr import read_signs, require
from twc_env.world.sensors.ocr_table import SHIPPED, load_table
from twc_env.world.sensors.sign_picture import View, draw_plate
from twc_env.world.sensors.sign_readers import hidden_part

DISTANCES_M = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
TURN_RATE_STD_RAD_S = 0.4
DRAWS = 10
"""Number of readings of the fast model per reading of the real OCR."""
MAPS = ("twin-01", "twin-02", *(f"test/{k:04d}" for k in range(12)))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this table."""
    parser.add_argument("--signs", type=count, default=1000, help="signs per distance")
    parser.add_argument("--hidden", type=number(0.0, 0.95), default=0.0, help="occluded share of each text")
    parser.add_argument("--seed", type=natural, default=0, help="seed of signs and views")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """A row per distance: {distance_m, exact_real, exact_fast, similarity_real, similarity_fast}."""
    require()
    texts = held_out_texts()
    return runner.each(
        DISTANCES_M,
        lambda d: compare(texts, d, options.signs, options.seed, options.hidden),
        lambda d: f"signs {d:g} m away, table {zlib.crc32(SHIPPED.read_bytes()):08x}",
    )


def remarks(rows: list[dict]) -> list[str]:
    """The largest difference of both, and published rates on real signboards."""
    gaps = [abs(row[f"{key}_real"] - row[f"{key}_fast"]) for row in rows for key in ("exact", "similarity")]
    return [f"largest difference: {max(gaps):.3f}", *_published()]


@lru_cache(maxsize=1)
def held_out_texts() -> list[str]:
    """All distinct texts of the held-out maps; `ocr_measure` uses other words."""
    return sorted({sign.text.upper() for name in MAPS for sign in load_map(name).signs})


def compare(texts: list[str], distance_m: float, count: int, seed: int, hidden_share: float = 0.0) -> dict:
    """Rates of the real OCR and of the fast model for random signs near a distance."""
    random = random_stream(seed, "ocr held out", round(10 * distance_m + 1000 * hidden_share))
    config = SignsConfig()
    chosen = [texts[int(i)] for i in random.integers(0, len(texts), count)]
    plates = [draw_plate(random) for _ in chosen]
    hidden = [_hidden(text, hidden_share, random) for text in chosen]
    views = [_view(config, distance_m, part, random) for part in hidden]
    real = read_signs(chosen, plates, views, random)
    reader = TableReader(load_table())
    exact_real, similarity_real = rates(chosen, real)
    drawn = [
        reader.read(codes_of(t), part, v.height_px, v.incidence_rad, v.blur_px, random.standard_normal(draw_count(t)))
        for _ in range(DRAWS)
        for t, v, part in zip(chosen, views, hidden, strict=True)
    ]
    exact_fast, similarity_fast = rates(chosen * DRAWS, drawn)
    return {
        "distance_m": distance_m,
        "exact_real": exact_real,
        "exact_fast": exact_fast,
        "similarity_real": similarity_real,
        "similarity_fast": similarity_fast,
    }


def _hidden(text: str, share: float, random: np.random.Generator) -> Array:
    """(characters,) bool: a share of the text hidden from the left or the right."""
    hidden = np.zeros(len(text), np.bool_)
    count = round(share * len(text))
    if count:
        hidden[slice(0, count) if random.random() < 0.5 else slice(-count, None)] = True
    return hidden


def _view(config: SignsConfig, distance_m: float, hidden: Array, random: np.random.Generator) -> View:
    distance_m += random.uniform(-0.5, 0.5)
    angle = config.incidence_max_rad * random.uniform(-1.0, 1.0)
    blur_px = abs(random.normal(0.0, TURN_RATE_STD_RAD_S)) * config.exposure_s * config.focal_length_px
    height_px = config.focal_length_px * config.character_height_m / distance_m
    return View(height_px, angle, blur_px, hidden_part(hidden), config.focal_length_px)


def rates(texts: list[str], readings: list[str]) -> tuple[float, float]:
    """Share of exact readings, and mean similarity to the texts, ignoring case."""
    normal = [normalise(reading) for reading in readings]
    exact = np.mean([reading == text for reading, text in zip(normal, texts, strict=True)])
    similarity = np.mean([text_similarity(reading, text) for reading, text in zip(normal, texts, strict=True)])
    return round(float(exact), 4), round(float(similarity), 4)


def _published() -> list[str]:
    try:
        summary = json.loads((data_folder() / "ocr" / "signboard_ocr_summary.json").read_text())
    except (DataError, OSError):
        return ["published rates on real signboards: set TWC_DATA to print them here"]
    lines = [f"published, {summary['data']}, case aside:"]
    for name, found in summary["recognition_on_given_boxes"].items():
        exact = found["exact_case_insensitive"] / found["words"]
        lines.append(
            f"  {name}, boxes given: exact {exact:.2f}, similarity {found['normalized_edit_similarity_ci']:.2f}"
        )
    for name, found in summary["end_to_end_word_spotting"].items():
        lines.append(f"  {name}, detector too: precision {found['precision']:.2f}, recall {found['recall']:.2f}")
    lines.append(
        "Those are street photographs of shop fronts with curved and ornamental lettering, read word by word by "
        "older models; the plates here are plain and flat, so the figures above are what tidy indoor signs allow."
    )
    return lines
