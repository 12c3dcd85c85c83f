"""Indoor GeoJSON: floors of the indoor-location-competition-20 and OpenStreetMap buildings, with real place names.

Both are longitudes and latitudes (WGS 84), as the format's standard asks (RFC 7946).
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

from twc_env.datasets.buildings.competition_floor import competition_floor
from twc_env.datasets.buildings.furnish import place_access_points
from twc_env.datasets.buildings.geojson_features import check_reference, part_of, properties_of
from twc_env.datasets.buildings.imdf import check_units, is_imdf, tagged
from twc_env.datasets.buildings.osm_level import osm_level
from twc_env.errors import MapError
from twc_env.records.random_streams import random_stream
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.floorplan_check import validate
from twc_env.world.building.floorplan_file import load_json

ACCESS_POINT_AREA_M2 = 150.0


def read_geojson(path: str | Path, seed: int = 0) -> Floorplan:
    """One floor of a GeoJSON file (.geojson or .json, also .gz), see `geojson_plan`."""
    path = Path(path)
    return geojson_plan(load_json(path), path, seed)


def geojson_plan(values: object, path: Path, seed: int = 0, level: str | None = None) -> Floorplan:
    """Build a plan from the values of a GeoJSON file at `path`; a competition floor needs floor_info.json beside it.

    Place names become signs. `level` picks the floor of an OpenStreetMap or IMDF building, by default "0" or the only
    one. Access points are placed by seed. Raises MapError for values of no such kind, for unknown levels and for floors
    without free space.
    """
    table = values if isinstance(values, dict) else {}
    features = table.get("features")
    if not isinstance(features, list) or not all(isinstance(f, dict) for f in features) or not features:
        raise MapError(f"{path.name} is not a GeoJSON FeatureCollection with features; export the floor again")
    check_reference(table, path.name)
    name = _plan_name(path)
    if is_imdf(features):
        check_units(features, path.name)
        plan = osm_level(tagged(features, path), path.name, name, level)
    elif any("tags" in properties_of(feature) or part_of(feature) for feature in features):
        plan = osm_level(features, path.name, name, level)
    else:
        plan = competition_floor(features, path, name)
    random = random_stream(seed, "furnish")
    area_m2 = plan.cells().free.sum() * plan.cells().resolution_m ** 2
    count = int(max(6, area_m2 / ACCESS_POINT_AREA_M2))
    return validate(dataclasses.replace(plan, access_points=place_access_points(plan, random, count)))


def _plan_name(path: Path) -> str:
    stem = path.name.split(".")[0]
    return path.parent.name if stem == "geojson_map" and path.parent.name else stem
