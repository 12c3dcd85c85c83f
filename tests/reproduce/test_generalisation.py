"""The table of claims on sets that no setting was chosen on."""

from pathlib import Path

import numpy as np
import pytest

from tests.real_data import DATA, needs_data
from twc_env.reproduce.elsewhere import generalisation
from twc_env.reproduce.pose_graphs.robustness import DATASETS
from twc_env.world.building.splits import SPLITS

RESULTS = Path(__file__).parents[2] / "docs" / "results.md"


def test_every_claim_has_parts_and_fresh_buildings_are_of_no_other_split():
    assert generalisation.CLAIMS.keys() == generalisation.PARTS.keys()
    assert generalisation.PARTS["exploration"](3) == ["fresh/0000", "fresh/0001", "fresh/0002"]
    assert SPLITS["fresh"] == 100


def test_a_share_that_is_worse_than_its_trivial_answer_does_not_hold():
    runs = [{"merged": 3, "robots": 3, "wrong_pairs": 0, "ate_m": 0.02, "odometry_ate_m": 1.0}] * 9
    wrong = [{"merged": 3, "robots": 3, "wrong_pairs": 2, "ate_m": 1.4, "odometry_ate_m": 1.0}]
    good, bad = (generalisation.CLAIMS["exploration"][1](["fresh/0009"], found) for found in (runs, runs + 90 * wrong))
    assert [row["holds"] for row in good] == [True, True, True]
    assert [row["holds"] for row in bad] == [True, False, False]
    assert good[1]["at_most"] == pytest.approx(1 - 0.05 ** (1 / 9), abs=1e-4)
    assert generalisation.remarks(good) == ["no row is worse than its trivial answer"]
    assert len(generalisation.remarks(bad)) == 2


def test_recognised_places_stand_beside_equal_texts_as_means_over_buildings():
    runs = [
        {"fused_precision": p, "fused_recall_at_full_precision": 0.9, "text_precision": 0.5,
         "text_recall_at_full_precision": text}
        for p, text in ((1.0, 0.0), (0.9, 1.0))
    ]  # fmt: skip
    recall, precision = generalisation.CLAIMS["places"][1](["fresh/0094", "fresh/0095"], runs)
    assert (recall["elsewhere"], recall["trivial"], recall["cases"], recall["holds"]) == (0.9, 0.5, 2, True)
    assert (precision["elsewhere"], precision["trivial"], precision["set"]) == (0.95, 0.5, "fresh/0094 to fresh/0095")


def test_the_sets_are_none_that_the_results_show():
    text = RESULTS.read_text()
    assert all(plan in text for plan in generalisation.SHOWN_PLANS)
    assert not set(generalisation.GRAPHS) & set(DATASETS.values())


@needs_data
def test_plans_of_every_size_are_played_and_none_of_the_shown():
    chosen = generalisation.PARTS["houseexpo"](1)
    assert len(chosen) == len(set(chosen)) == 12
    assert not set(chosen) & {*generalisation.SHOWN_PLANS, *generalisation.UNSOUND}


@needs_data
def test_resampled_odometry_errs_as_the_intel_robot_does():
    from twc_env.datasets.logs.carmen_log import read_carmen_log
    from twc_env.records.geometry import between, wrap_angle
    from twc_env.reproduce.logs.resampled_odometry import intel_errors, resampled

    poses = read_carmen_log(DATA / "lidar/carmen/aces-corrected.log.gz").poses
    assert resampled(poses, 0.0, 0) == pytest.approx(poses[:1] * 0 + resampled(poses, 0.0, 1))
    own = between(poses[:-1], poses[1:])
    for size in (1.0, 2.0):
        read = between(*(resampled(poses, size, 0)[part] for part in (slice(None, -1), slice(1, None))))
        turned = wrap_angle(read[:, 2] - own[:, 2])
        wanted = size * np.sqrt(np.mean(intel_errors()[1][:, 2] ** 2))
        assert np.sqrt(np.mean(turned**2)) == pytest.approx(wanted, rel=0.35)
