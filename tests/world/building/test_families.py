"""Families of generated buildings with splits of their own."""

import pytest

from twc_env.errors import MapError
from twc_env.maps import load_map
from twc_env.world.building.splits import (
    FAMILY_SPLITS,
    KINDS,
    SPLITS,
    family_of,
    is_of_split,
    is_set,
    layout_digest,
    one_of,
    split_names,
    split_recipe,
)

FAMILY = "gen:office+ward:200"


def seeds_of(family: str) -> dict[str, set[int]]:
    from twc_env.world.building.splits import _parts

    return {split: {_parts(n, n.partition(":")[2])[2] for n in split_names(split, family)} for split in FAMILY_SPLITS}


def test_the_splits_of_a_family_have_seeds_of_their_own():
    own = seeds_of(FAMILY)
    assert {split: len(seeds) for split, seeds in own.items()} == {
        "train": 500,
        "validation": 100,
        "test": 100,
        "fresh": 100,
    }
    standard = {split_recipe(split, number)[2] for split in SPLITS for number in range(SPLITS[split])}
    everything = [*own.values(), standard]
    assert len(set().union(*everything)) == sum(map(len, everything))


def test_a_building_of_a_family_is_the_generated_one_of_its_seed_and_kinds_take_turns():
    for number, kind in ((6, "office"), (7, "ward")):
        plan = load_map(f"{FAMILY}:test/{number:04d}")
        assert plan.name == f"{FAMILY}:test/{number:04d}"
        assert layout_digest(plan) == layout_digest(load_map(f"gen:{kind}:200:{5_000_000 + number}"))
    for of_split, alone in (("validation/0000", "office:200:4000000"), ("train/0001", "ward:200:3000001")):
        assert layout_digest(load_map(f"{FAMILY}:{of_split}")) == layout_digest(load_map(f"gen:{alone}"))


def test_names_of_families_sets_and_buildings_are_told_apart():
    assert is_set(f"{FAMILY}:train") and not is_set(f"{FAMILY}:train/0000") and not is_set("train")
    assert is_of_split(f"{FAMILY}:train/0499") and not is_of_split(f"{FAMILY}:train/0500")
    assert family_of(f"{FAMILY}:train") == family_of(f"{FAMILY}:test/0001") == FAMILY
    assert [family_of(name) for name in ("test/0001", "train", "twin-01", "gen:office:200:7")] == [""] * 4
    assert one_of("twin-01", 3) == "twin-01"
    assert one_of(f"{FAMILY}:test", 3) == one_of(f"{FAMILY}:test", 3) != one_of(f"{FAMILY}:test", 4)
    assert is_of_split(one_of(f"{FAMILY}:test", 3))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (f"{FAMILY}:test", "is a set of buildings; name one of them, for example gen:office.ward:200:test/0000"),
        (f"{FAMILY}:test/0100", "no building 'gen:office.ward:200:test/0100': .*:test holds 100, .*/0000 to .*/0099"),
        (f"{FAMILY}:test/7", "holds 100, .*/0000 to .*/0099"),
        (f"{FAMILY}:tset/0001", "names no building"),
        ("gen:office+palace:200:test/0001", f"no buildings of kind 'palace'; kinds are {KINDS[0]}"),
    ],
)
def test_names_that_are_no_building_are_refused_in_one_line(name, message):
    with pytest.raises(MapError, match=message) as caught:
        load_map(name)
    assert "\n" not in str(caught.value)
