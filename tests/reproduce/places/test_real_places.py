import numpy as np
import pytest

from tests.real_data import DATA, needs_data
from twc_env.records.messages import Fingerprint
from twc_env.reproduce.places import place_cues, real_places, surveyed_places
from twc_env.slam.places.radio_fingerprint import mac_similarity, rssi_distance_db
from twc_env.slam.places.radio_statistics import radio_difference_db


def test_comparing_all_places_at_once_gives_what_pairs_give():
    random = np.random.default_rng(0)
    rssi = np.where(random.random((5, 30)) < 0.6, random.uniform(-89, -40, (5, 30)), np.nan)
    prints = [Fingerprint(np.flatnonzero(np.isfinite(row)), row[np.isfinite(row)]) for row in rssi]
    shared, rms, difference, counts = place_cues._compare_radio(rssi)
    for i, a in enumerate(prints):
        for j, b in enumerate(prints):
            distance, common = rssi_distance_db(a, b)
            assert common == shared[i, j]
            assert rms[i, j] == pytest.approx(distance / np.sqrt(common), abs=1e-5)
            assert difference[i, j] == pytest.approx(radio_difference_db(a, b), abs=1e-5)
            assert shared[i, j] / max(counts[i], counts[j]) == pytest.approx(mac_similarity(a, b))


def test_the_regression_finds_the_weights_that_made_the_data():
    random = np.random.default_rng(1)
    features = np.column_stack([random.normal(size=(20000, 2)), np.ones(20000)])
    share = 1 / (1 + np.exp(-features @ [2.0, -1.0, -0.5]))
    weights = real_places.logistic(features, random.random(20000) < share)
    assert weights == pytest.approx([2.0, -1.0, -0.5], abs=0.1)


def test_neighbours_along_a_trace_may_be_passed_in_either_direction():
    cue = np.zeros((6, 6))
    cue[0, 5] = cue[2, 3] = 4.0  # trace 1 (places 3 to 5) was walked against trace 0 (places 0 to 2)
    assert place_cues._along(cue, np.array([0, 0, 0, 1, 1, 1]))[1, 4] == 4.0


@needs_data
def test_fused_learns_on_one_real_floor_what_beats_the_others_on_the_other():
    floors = {name: surveyed_places.read_floor(DATA / "indoor20" / part) for name, part in real_places.FLOORS.items()}
    figures = real_places.evaluate_draw(floors, seed=100)
    for floor in floors:
        assert figures[floor].pop("fused") > max(figures[floor].values())


def test_the_margin_of_fused_is_told_against_the_best_other_method_and_the_larger_spread():
    def row(floor, method, precision, sd):
        return {"floor": floor, "method": method, "average_precision": precision, "sd": sd}

    table = [row("F6", "text", 0.2, 0.01), row("F6", "twc", 0.4, 0.03), row("F6", "fused", 0.6, 0.02)]
    table += [row("B1", "twc", 0.3, 0.04), row("B1", "fused", 0.33, 0.01)]
    first, second = real_places.remarks(table)
    assert first.startswith("F6: fused is +0.200 in average precision against twc") and " more than" in first
    assert "not more than the larger spread of the two, 0.040" in second
