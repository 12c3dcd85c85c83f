"""Names of generated buildings, and their fixed splits for training, validation, testing, and for claims (`fresh`).

`gen:office:800:7` is one building. `train/0007` is of the standard splits, whose kinds and areas vary. A family,
`gen:KIND+KIND:AREA`, has splits of its own: `gen:office+ward:2000:test/0007` is one of its buildings (its kinds take
turns), and `gen:office+ward:2000:test` the set of them.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from twc_env.errors import MapError
from twc_env.records.random_streams import random_stream
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.generate import generate
from twc_env.world.building.layouts import KINDS

SPLITS = {"train": 1000, "validation": 100, "test": 100, "fresh": 100}
"""Number of buildings per split; names are `train/0000` and so on. `fresh` replaces buildings of `test` that were
looked at; docs/results.md says which numbers of it were used."""
SPLIT_AREA_M2 = (100.0, 2000.0)
"""Areas in the splits are sampled log-uniformly from this range."""
_SPLIT_SEEDS = {"train": 0, "validation": 1_000_000, "test": 2_000_000, "fresh": 6_000_000}
FAMILY_SPLITS = {"train": 500, "validation": 100, "test": 100, "fresh": 100}
"""Number of buildings per split of a family."""
_FAMILY_SEEDS = {"train": 3_000_000, "validation": 4_000_000, "test": 5_000_000, "fresh": 7_000_000}


def generate_by_name(name: str) -> Floorplan | None:
    """The building of a name such as `gen:office:800:7` or `train/0007`; None for names of other forms.

    Raises MapError for invalid parts of such a name.
    """
    head, _, rest = name.partition(":")
    if head == "gen":
        return _cached(*_parts(name, rest), name)
    split, _, number = name.partition("/")
    if split not in SPLITS or not number.isdecimal() or len(number) != 4:
        return None
    if int(number) >= SPLITS[split]:
        raise MapError(f"no building {name!r}: {split} holds {SPLITS[split]}, {split}/0000 to {split_names(split)[-1]}")
    return _cached(*split_recipe(split, int(number)), name)


def split_names(split: str, family: str = "") -> tuple[str, ...]:
    """Names of all buildings of a split, of a family (`gen:office:2000`) or the standard one. Raises MapError for an
    unknown split."""
    if not isinstance(split, str) or split not in SPLITS:
        raise MapError(f"no split {split!r}; splits are {', '.join(SPLITS)}")
    counts, head = (FAMILY_SPLITS, f"{family}:{split}") if family else (SPLITS, split)
    return tuple(f"{head}/{number:04d}" for number in range(counts[split]))


def is_of_split(name: str) -> bool:
    """Whether `name` is that of a building of a split, such as `train/0007` or `gen:office:2000:train/0007`."""
    place, _, number = name.partition("/")
    family, _, split = place.rpartition(":")
    counts = FAMILY_SPLITS if family else SPLITS
    return split in counts and number.isdecimal() and len(number) == 4 and int(number) < counts[split]


def family_of(name: str) -> str:
    """The family of a set of buildings or of a building of its splits; "" for other names (the standard splits)."""
    family, _, split = name.partition("/")[0].rpartition(":")
    return family if split in FAMILY_SPLITS else ""


def is_set(name: str) -> bool:
    """Whether a name is that of a set of buildings, such as `gen:office:2000:train`."""
    return name.startswith("gen:") and name.rpartition(":")[2] in FAMILY_SPLITS


def one_of(name: str, seed: int) -> str:
    """A building of a set, drawn by the seed; any other name itself."""
    return drawn_from(name.rpartition(":")[2], family_of(name), seed) if is_set(name) else name


def drawn_from(split: str, family: str, seed: int) -> str:
    """A building of a split, drawn by the seed."""
    names = split_names(split, family)
    return names[int(random_stream(seed, "building").integers(len(names)))]


def split_recipe(split: str, number: int) -> tuple[str, float, int]:
    """Kind, area [m2] and seed of one building of a split; kinds alternate, areas are random."""
    seed = _SPLIT_SEEDS[split] + number
    low, high = (math.log(area) for area in SPLIT_AREA_M2)
    area_m2 = round(math.exp(random_stream(seed, "split-area").uniform(low, high)))
    return KINDS[number % len(KINDS)], float(area_m2), seed


def layout_digest(plan: Floorplan) -> str:
    """Twelve hex digits (SHA-256) of the walls, invariant to translation, quarter turns and mirroring."""
    walls = np.round(plan.home.walls_m * 100).astype(np.int64)
    copies = []
    for mirror in (1, -1):
        for turn in ([[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]]):
            copy = walls * np.array([mirror, 1]) @ np.array(turn)
            copy -= copy.reshape(-1, 2).min(axis=0)
            # Canonical order of the ends of each wall, and of the walls.
            is_swapped = (copy[:, 0, 0] > copy[:, 1, 0]) | (
                (copy[:, 0, 0] == copy[:, 1, 0]) & (copy[:, 0, 1] > copy[:, 1, 1])
            )
            copy[is_swapped] = copy[is_swapped][:, ::-1]
            rows = copy.reshape(-1, 4)
            copies.append(rows[np.lexsort(rows.T)].tobytes())
    return hashlib.sha256(min(copies)).hexdigest()[:12]


def digest_of_layouts(layouts: Iterable[str]) -> str:
    """One digest over a sequence of layout digests."""
    return hashlib.sha256("\n".join(layouts).encode()).hexdigest()[:12]


def split_layouts(split: str) -> list[str]:
    """Layout digest of every building of a split."""
    return [layout_digest(generate(*split_recipe(split, k), check=False)) for k in range(SPLITS[split])]


@lru_cache(maxsize=32)
def _cached(kind: str, area_m2: float, seed: int, name: str) -> Floorplan:
    plan = generate(kind, area_m2, seed)
    object.__setattr__(plan, "name", name)  # frozen, but not shared yet; a copy would lose its cache
    return plan


def _parts(name: str, rest: str) -> tuple[str, float, int]:
    parts = rest.split(":")
    if is_set(name):
        raise MapError(f"{name!r} is a set of buildings; name one of them, for example {name}/0000")
    place = name.partition("/")[0]
    if is_set(place) and not is_of_split(name):
        names = split_names(place.rpartition(":")[2], family_of(name))
        raise MapError(f"no building {name!r}: {place} holds {len(names)}, {names[0]} to {names[-1]}")
    try:
        kinds, area_m2, split = parts[0].split("+"), float(parts[1]), parts[2].partition("/")[0]
        if len(parts) != 3 or not math.isfinite(area_m2):
            raise ValueError
        number = int(parts[2].partition("/")[2] if is_of_split(name) else parts[2])
    except (IndexError, ValueError):
        raise MapError(
            f"{name!r} names no building; write gen:KIND:AREA:SEED, for example gen:office:800:7 "
            f"(kinds: {', '.join(KINDS)}), or one of a family, for example gen:office+ward:800:test/0007"
        ) from None
    return kinds[number % len(kinds)], area_m2, _FAMILY_SEEDS.get(split, 0) + number
