"""Measures the table of OCR errors: signs are rendered as camera images, read by a real OCR, and errors are counted.

Signs are rendered over a grid of capital height x incidence x blur; fonts, colours, light, reflections, sharpness and
noise vary between signs. Readings are aligned with the truth by edit distance, ignoring case. The texts use other words
than the maps, so that `reproduce ocr` evaluates the table on unseen signs.
"""

from __future__ import annotations

import json
import math
import platform
from collections import Counter
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array
from scipy.optimize import brentq
from scipy.special import expit

from twc_env.records.random_streams import random_stream
from twc_env.reproduce.ocr.ocr_alignment import Aligned
from twc_env.reproduce.ocr.ocr_repeats import fit_correlation
from twc_env.reproduce.runner import Runner
from twc_env.world.sensors.ocr import read_signs, require
from twc_env.world.sensors.ocr_table import FORMAT, GARBLED_RATE, MISS_LENGTH
from twc_env.world.sensors.sign_picture import View, draw_plate

HEIGHT_PX = (4.5, 5.2, 6.0, 7.0, 8.5, 10.5, 14.0, 20.0, 36.0)
INCIDENCE_DEG = (0.0, 35.0, 50.0, 63.0)
BLUR_WIDTHS = (0.0, 0.12, 0.24, 0.36, 0.48, 0.65)
"""Motion blur in capital heights, multiplied by the cosine of the incidence."""
LEVEL_RATE = (0.9, 0.65, 0.45, 0.3, 0.2, 0.12, 0.07, 0.03, 0.0)
"""Character error rates of the error levels of lines, in descending order."""
SMALL_PX = 12.0
"""Below this capital height rates change fast, so twice as many signs are read."""
AGAIN_HEIGHT_PX = (6.5, 8.0, 10.0, 14.0)
_COMMON_SHARE_MIN = 0.004
_PRIOR_LINES = 2.0
"""Weight, in lines, of the prior from all angles of a height and blur."""
WORDS = (
    "RECEPTION", "CONFERENCE", "LOUNGE", "STORAGE", "TOILETS", "STAIRS", "ELEVATOR", "CASHIER", "OFFICE", "MEETING",
    "BOARD", "CAFE", "LAUNDRY", "PARKING", "EMERGENCY", "DIRECTOR", "FINANCE", "PHYSICS", "CHEMISTRY", "BIOLOGY",
    "MUSIC", "DRAWING", "THEATRE", "DANGER", "HIGH VOLTAGE", "PUSH", "PULL", "PRIVATE", "NO ENTRY", "WAITING AREA",
    "RADIOLOGY", "DENTIST", "ACCOUNTS", "PURCHASING", "LEGAL", "HUMAN RESOURCES", "PLANT", "BOILER", "GARAGE", "DEPOT",
    "GYM", "CHAPEL", "CLASS", "LECTURE", "COMPUTER", "JANITOR", "WARDROBE", "TICKETS", "INFORMATION", "BAGGAGE",
    "BREWERY", "VEHICLES", "WELDING", "PAINT", "CHECKOUT", "DELIVERY", "MUSEUM", "KIOSK", "QUARANTINE", "AXLES",
)  # fmt: skip


def sign_text(random: np.random.Generator) -> str:
    """A random text of a door plate, notice, shop or room number, with words that no map uses."""
    words = [WORDS[int(i)] for i in random.permutation(len(WORDS))[:2]]
    letter, number = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"[int(random.integers(26))], int(random.integers(1, 400))
    invented = "".join(chr(65 + int(i)) for i in random.integers(0, 26, int(random.integers(4, 9))))
    kind = int(random.choice(6, p=(0.34, 0.2, 0.12, 0.12, 0.12, 0.1)))
    return (
        f"{letter}{number} {words[0]}",
        words[0],
        f"{words[0]} {words[1]}",
        f"{letter}{number}",
        invented,
        f"{words[0]} {number // 12}-{number}",
    )[kind]


def measure(path: Path, seed: int, signs_per_bin: int, cache: Path, processes: int = 1) -> dict:
    """Measure and write the table; returns its content. Parts that an earlier run finished are reused."""
    require()
    bins = list(np.ndindex(len(HEIGHT_PX), len(INCIDENCE_DEG), len(BLUR_WIDTHS)))
    runner = Runner("ocr-measure", cache, {"seed": seed, "signs": signs_per_bin})
    read_bin, read_again = (partial(f, seed=seed, count=signs_per_bin) for f in (_read_bin, _read_again))
    read = runner.each(bins, read_bin, lambda b: "bin {}/{}/{}".format(*b), processes)
    triples = runner.each(AGAIN_HEIGHT_PX, read_again, lambda h: f"again at {h} px", processes)
    table = fit([[tuple(line) for line in lines] for lines in read])
    table |= fit_correlation(table, [line for part in triples for line in part], seed)
    lines = sum(len(part) for part in read) + 3 * sum(len(part) for part in triples)
    table["made"] = {
        "command": f"twc-env ocr measure --seed {seed} --signs {signs_per_bin}",
        "signs_read": lines,
        "ocr": "PP-OCRv4 detection and recognition (mobile) as shipped in rapidocr-onnxruntime",
        "versions": {
            name: version(name) for name in ("rapidocr-onnxruntime", "onnxruntime", "opencv-python", "matplotlib")
        } | {"python": platform.python_version()},
    }  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(table, separators=(",", ":"), ensure_ascii=True) + "\n")
    return table


def _read_bin(which: tuple[int, int, int], seed: int, count: int) -> list[tuple[str, str]]:
    """(truth, reading) of signs at one grid point."""
    h, a, b = which
    random = random_stream(seed, "ocr measure", (h * len(INCIDENCE_DEG) + a) * len(BLUR_WIDTHS) + b)
    texts = [sign_text(random) for _ in range(2 * count if HEIGHT_PX[h] < SMALL_PX else count)]
    angle = math.radians(INCIDENCE_DEG[a])
    blur_px = BLUR_WIDTHS[b] * HEIGHT_PX[h] * math.cos(angle)
    views = [View(HEIGHT_PX[h], float(random.choice((-1, 1))) * angle, blur_px) for _ in texts]
    return list(zip(texts, read_signs(texts, [draw_plate(random) for _ in texts], views, random), strict=True))


def _read_again(height_px: float, seed: int, count: int) -> list[tuple]:
    """(truth, height, angle, reading, reading nearby, reading from elsewhere) of 4 `count` signs, each read three
    times."""
    random = random_stream(seed, "ocr again", round(10 * height_px))
    count *= 4
    texts, plates = [sign_text(random) for _ in range(count)], [draw_plate(random) for _ in range(count)]
    angles = random.uniform(-0.9, 0.9, count)
    nearby = [View(height_px * random.uniform(0.9, 1.1), a + random.uniform(-0.12, 0.12)) for a in angles]
    views = (
        [View(height_px, a) for a in angles],
        nearby,
        [View(height_px, a) for a in random.uniform(-0.9, 0.9, count)],
    )
    readings = [read_signs(texts, plates, v, random) for v in views]
    return list(zip(texts, [height_px] * count, angles.tolist(), *readings, strict=True))


# --- counting ---


def fit(read: list[list[tuple[str, str]]]) -> dict:
    """The content of the table, except correlations, from the (truth, reading) lines of each bin."""
    shape = (len(HEIGHT_PX), len(INCIDENCE_DEG), len(BLUR_WIDTHS))
    bins = [[Aligned(*line) for line in lines] for lines in read]
    level, posteriors = _levels(bins, shape)
    exponent = _length_exponent(bins)
    space_loss = _rates(bins, shape, lambda a: (len(a.spaces_lost), len(a.spaces)), 10.0)
    fragments = [a for lines in bins for a in lines if a.is_fragment]
    table = {
        "format": FORMAT,
        "height_px": HEIGHT_PX,
        "incidence_deg": INCIDENCE_DEG,
        "blur_widths": BLUR_WIDTHS,
        "lines_per_bin": [len(lines) for lines in read[:: shape[1] * shape[2]]],
        "miss": _at_reference_length(_rates(bins, shape, lambda a: (a.is_missed, 1)), bins, exponent),
        "miss_length_exponent": exponent,
        "fragment": _rates(bins, shape, lambda a: (a.is_fragment, not a.is_missed)).tolist(),
        "space_loss": space_loss.tolist(),
        "space_proneness": _space_proneness(bins, space_loss),
        "level_share": np.round(level, 4).reshape(*shape, -1).tolist(),
        "level_rate": LEVEL_RATE,
        "kept": np.round(np.quantile([a.kept_share for a in fragments] or [0.5], np.linspace(0, 1, 11)), 3).tolist(),
        "kept_begin": round(float(np.mean([float(a.keeps_begin) for a in fragments] or [0.5])), 3),
    }
    return table | _letters([a for lines in bins for a in lines], posteriors)


def _rates(bins: list[list[Aligned]], shape: tuple[int, ...], count, prior_cases: float = 2.0) -> Array:
    """(H, A, B) shares, with the share over all angles as prior for bins with few cases."""
    counts = np.array([np.sum([count(a) for a in lines], axis=0) for lines in bins], float).reshape(*shape, 2)
    pooled = counts.sum(axis=1, keepdims=True)
    prior = pooled[..., 0] / np.maximum(pooled[..., 1], 1.0)
    rates = (counts[..., 0] + prior_cases * prior) / (counts[..., 1] + prior_cases)
    return np.round(rates, 4)


def _length_exponent(bins: list[list[Aligned]]) -> float:
    """Exponent of the length by which the odds of a miss decrease, because longer texts are detected more easily.

    Fitted to bins with missed and read lines: slope of the log-odds over the log length, by repeated steps of logistic
    regression.
    """
    some = [lines for lines in bins if 0.05 < np.mean([a.is_missed for a in lines]) < 0.95]
    exponent = 0.0
    for _ in range(20 if some else 0):
        slope = weight = 0.0
        for lines in some:
            missed = np.array([a.is_missed for a in lines], float)
            length = np.log([len(a.truth) / MISS_LENGTH for a in lines])
            chance = expit(_log_odds_of(missed.mean(), length, exponent) - exponent * length)
            spread = chance * (1.0 - chance)
            offset = length - (spread * length).sum() / spread.sum()
            slope += (offset * (missed - chance)).sum()
            weight += (spread * offset**2).sum()
        exponent -= slope / weight
    return round(float(exponent), 3)


def _log_odds_of(rate: float, log_length: Array, exponent: float) -> float:
    """Log-odds of a miss at the reference length for which lines of these lengths have this mean rate."""
    rate = float(np.clip(rate, 1e-6, 1.0 - 1e-6))
    return brentq(lambda odds: expit(odds - exponent * log_length).mean() - rate, -40.0, 40.0)


def _at_reference_length(rates: Array, bins: list[list[Aligned]], exponent: float) -> list:
    """(H, A, B) miss rates of a text of length `MISS_LENGTH`, from those of the measured texts."""
    length = [np.log([len(a.truth) / MISS_LENGTH for a in lines]) for lines in bins]
    odds = [_log_odds_of(rate, x, exponent) for rate, x in zip(rates.ravel(), length, strict=True)]
    return np.round(expit(odds), 4).reshape(rates.shape).tolist()


def _space_proneness(bins: list[list[Aligned]], space_loss: Array) -> list[float]:
    """Ratio of lost spaces to the average: between letters, and beside a digit."""
    lost, expected = np.zeros(2), np.full(2, 1e-9)
    for lines, rate in zip(bins, space_loss.ravel(), strict=True):
        for a in lines:
            for k in a.spaces:
                kind = int(any(c.isdigit() for c in a.truth[k - 1 : k + 2]))
                lost[kind] += k in a.spaces_lost
                expected[kind] += rate
    return [round(float(share), 3) for share in lost / expected]


def _levels(bins: list[list[Aligned]], shape: tuple[int, ...]) -> tuple[Array, list[Array]]:
    """Shares (bins, levels) of the error levels by expectation maximisation, and each line's posterior (levels,).

    Within a level the number of wrong characters of a line is binomial. Fitted first over all angles, then per bin with
    that prior.
    """
    rate = np.clip(LEVEL_RATE, 1e-3, 0.999)

    def likelihood(lines: list[Aligned]) -> Array:
        counts = np.array([(len(a.wrong), len(a.letters)) for a in lines], float).reshape(-1, 2, 1)
        wrong, total = counts[:, 0], counts[:, 1]
        return np.exp(wrong * np.log(rate) + (total - wrong) * np.log1p(-rate))

    read = [[a for a in lines if not a.is_missed] for lines in bins]
    pooled = {}
    for h, b in np.ndindex(shape[0], shape[2]):
        group = np.arange(len(bins)).reshape(shape)[h, :, b]
        pooled[h, b] = _mixture(likelihood([a for k in group for a in read[k]]), np.full(len(rate), 1e-3))
    shares, posteriors = [], []
    for lines, (h, _, b) in zip(read, np.ndindex(shape), strict=True):
        chance = likelihood(lines)
        share = _mixture(chance, _PRIOR_LINES * pooled[h, b])
        shares.append(share)
        posteriors.append(chance * share / np.maximum((chance * share).sum(axis=1, keepdims=True), 1e-300))
    return np.array(shares), posteriors


def _mixture(chance: Array, prior: Array) -> Array:
    """(levels,) maximum-likelihood shares for lines with likelihoods (lines, levels), with a prior in lines."""
    share = (prior + 1e-6) / (prior + 1e-6).sum()
    for _ in range(200 if len(chance) else 0):
        weight = chance * share
        weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
        share = weight.sum(axis=0) + prior
        share /= share.sum()
    return share


def _letters(lines: list[Aligned], posteriors: list[Array]) -> dict:
    """Statistics of wrong characters and of their replacements."""
    read = [a for a in lines if not a.is_missed]
    posterior = np.concatenate(posteriors)  # (lines read, levels)
    rate = posterior @ np.array(LEVEL_RATE)
    expected: tuple[Counter[str], Counter[str]] = Counter(), Counter()
    happened: tuple[Counter[str], Counter[str]] = Counter(), Counter()
    confusions: tuple[dict, dict] = ({}, {})
    added: Counter[str] = Counter()
    edits = np.full((len(LEVEL_RATE), 3), 0.5)
    for a, line_rate, line in zip(read, rate, posterior, strict=True):
        garbled = int(line_rate >= GARBLED_RATE)
        for k in a.letters:
            expected[garbled][a.truth[k]] += line_rate
        for k in a.wrong:
            c, became = a.truth[k], a.became[k]
            happened[garbled][c] += 1
            edits[:, 0 if became not in (None, c) else 1 if became is None else 2] += line
            if became is None:
                continue
            if became == c:
                added[a.added[k][0]] += 1
            else:
                kind = confusions[garbled]
                for row in (c, ""):
                    kind.setdefault(row, Counter())[became] += 1
    return {
        "edit_share": np.round(edits / edits.sum(axis=1, keepdims=True), 4).tolist(),
        "proneness": _proneness(happened[0], expected[0]),
        "proneness_garbled": _proneness(happened[1], expected[1]),
        "confusions": {c: _shares(n) for c, n in sorted(confusions[0].items())},
        "confusions_garbled": {c: _shares(n) for c, n in sorted(confusions[1].items())},
        "added": _shares(added),
    }


def _proneness(happened: Counter[str], expected: Counter[str]) -> dict[str, float]:
    """Ratio of errors of each character to those expected from the levels of its lines; near 1 for rare ones."""
    total = sum(happened.values()) / max(sum(expected.values()), 1e-9)
    return {c: round((happened[c] + 3.0) / (expected[c] * total + 3.0), 3) for c in sorted(expected)} | {"": 1.0}


def _shares(counts: Counter[str]) -> dict[str, float]:
    total = sum(counts.values())
    return {c: round(n / total, 4) for c, n in counts.most_common(12) if n / total >= _COMMON_SHARE_MIN}
