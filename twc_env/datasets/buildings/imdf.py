"""Indoor Mapping Data Format (IMDF, OGC): its units and openings as features with the tags of OpenStreetMap."""

from __future__ import annotations

import logging
from pathlib import Path

from twc_env.datasets.buildings.geojson_features import properties_of
from twc_env.errors import MapError
from twc_env.world.building.floorplan_file import load_json

OPENINGS = "opening.geojson"
"""The file of the doors, beside that of the units."""
_KINDS = (
    "address", "amenity", "anchor", "building", "detail", "fixture", "footprint", "geofence", "kiosk", "level",
    "occupant", "opening", "relationship", "section", "unit", "venue",
)  # fmt: skip
"""Types of features."""
_NO_FLOOR = ("opentobelow", "column", "structure")
"""Categories of units that are no floor."""
_LOG = logging.getLogger(__name__)


def is_imdf(features: list[dict]) -> bool:
    """Whether features are those of IMDF."""
    return any(feature.get("feature_type") in _KINDS for feature in features)


def check_units(features: list[dict], where: str) -> None:
    """Raise MapError for files of IMDF that hold no unit, such as that of its openings alone."""
    kinds = sorted({str(kind) for feature in features if (kind := feature.get("feature_type")) in _KINDS})
    if "unit" not in kinds:
        raise MapError(
            f"{where} holds {', '.join(kinds)} of IMDF and no unit, which are its rooms: name unit.geojson; {OPENINGS} "
            "beside it is read too"
        )


def tagged(features: list[dict], path: Path) -> list[dict]:
    """Units as rooms and corridors, openings as doors; those of the file of openings beside `path` are added."""
    kinds = {feature.get("feature_type") for feature in features}
    if "opening" not in kinds:
        features = [*features, *_openings_beside(path)]
    return [_tagged(feature) for feature in features if feature.get("feature_type") in ("unit", "opening")]


def _openings_beside(path: Path) -> list[dict]:
    beside = path.with_name(OPENINGS)
    if not beside.is_file():
        _LOG.warning("%s has no openings, and no %s is beside it: rooms have no doors", path.name, OPENINGS)
        return []
    table = load_json(beside)
    features = table.get("features") if isinstance(table, dict) else None
    if not isinstance(features, list) or not all(isinstance(feature, dict) for feature in features):
        raise MapError(f"{beside.name} is not a GeoJSON FeatureCollection; export it again")
    return features


def _tagged(feature: dict) -> dict:
    own = properties_of(feature)
    tags: dict[str, object] = {"level": own.get("level_id"), "name": _label(own.get("name"))}
    if feature.get("feature_type") == "opening":
        tags["door"] = "yes"
    elif own.get("category") not in _NO_FLOOR:
        tags["indoor"] = "corridor" if own.get("category") == "walkway" else "room"
    return {"geometry": feature.get("geometry"), "properties": tags}


def _label(name: object) -> str:
    """A name in English if it has one, else in its first language."""
    if not isinstance(name, dict):
        return ""
    texts = [text for text in (name.get("en"), *name.values()) if isinstance(text, str)]
    return texts[0] if texts else ""
