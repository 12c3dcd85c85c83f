import pytest

from twc_env.config import EnvConfig, override
from twc_env.maps import load_map
from twc_env.reproduce.twc import stress

BUILDING = "test/0005"


def test_every_name_hangs_twice_and_every_sign_where_it_was():
    plan = load_map(BUILDING)
    repeated = stress.with_repeated_names(plan)
    texts = [sign.text for sign in repeated.signs]
    assert min(texts.count(text) for text in texts) >= 2
    assert [tuple(s.position_m) for s in repeated.signs] == [tuple(s.position_m) for s in plan.signs]


def test_each_condition_breaks_something_that_exists():
    as_usual = {c for c in stress.CONDITIONS if override(EnvConfig(), stress.settings(c, 900)) == EnvConfig()}
    assert as_usual == {"normal", "repeated names"}


def test_a_lost_robot_is_reported_and_merges_nothing_wrongly(rows_of, monkeypatch):
    monkeypatch.setattr(stress, "load_map", lambda name: load_map(BUILDING))
    normal, lost = rows_of(stress, "--buildings", "1", "--conditions", "robot lost")
    assert (normal["condition"], lost["condition"]) == ("normal", "robot lost")
    assert normal["d_ate"] == normal["d_merged"] == 0.0 and normal["merged_share"] == 1.0
    for row in (normal, lost):
        assert row["pose_std_m"] / 4 < row["pose_error_m"] < 4 * row["pose_std_m"]
        assert row["heading_std_deg"] / 8 < row["heading_error_deg"] < 4 * row["heading_std_deg"]
    assert lost["wrong_merges"] == 0 and "not heard since" in lost["lacked"]
    assert lost["d_ate"] == pytest.approx(lost["ate_m"] - normal["ate_m"], abs=1e-3)
