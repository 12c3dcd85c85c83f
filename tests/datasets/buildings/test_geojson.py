import gzip
import json
import lzma
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from tests.real_data import DATA, needs_data
from twc_env.config import EnvConfig
from twc_env.datasets.buildings import osm_level
from twc_env.datasets.buildings.competition_floor import DRAWING_CLASSES
from twc_env.datasets.buildings.geojson import read_geojson
from twc_env.datasets.buildings.osm_level import metres_per_degree
from twc_env.errors import MapError
from twc_env.maps import load_map
from twc_env.world.world import World

EAST_M, NORTH_M = metres_per_degree(47.0)


def lonlat(x: float, y: float) -> list[float]:
    return [19.0 + x / EAST_M, 47.0 + y / NORTH_M]


def polygon(corners, **properties) -> dict:
    ring = [lonlat(*corner) for corner in [*corners, corners[0]]]
    return {"type": "Feature", "properties": properties, "geometry": {"type": "Polygon", "coordinates": [ring]}}


def box(x0, y0, x1, y1) -> list:
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def node(x, y, **tags) -> dict:
    geometry = {"type": "Point", "coordinates": lonlat(x, y)}
    return {"type": "Feature", "properties": {"tags": tags}, "geometry": geometry}


def room(corners, name, floor="0") -> dict:
    relations = [{"role": "buildingpart", "reltags": {"level": floor}}]
    return polygon(corners, tags={"buildingpart": "room", "name": name}, relations=relations)


def collection(*features) -> dict:
    return {"type": "FeatureCollection", "features": list(features)}


@pytest.fixture
def building(tmp_path):
    """Writes a building to `building.geojson`."""

    def write(values: dict) -> Path:
        path = tmp_path / "building.geojson"
        path.write_text(json.dumps(values))
        return path

    return write


@pytest.fixture
def floor(tmp_path):
    """A floor of 20 x 15 m with a shop, stairs, a drawing class, and the shop once more without its name."""
    (tmp_path / "floor_info.json").write_text('{"map_info": {"width": 20.0, "height": 15.0}}')

    def write(**changes) -> Path:
        values = collection(
            polygon(box(0, 0, 20, 15), name="F1"),
            polygon(box(3, 3, 9, 8), name=""),
            polygon(box(3, 3, 9, 8), name="bookshop"),
            polygon(box(12, 3, 17, 12), name="louti"),
            polygon(box(4, 10, 8, 13), name="fuzhumian"),
        )
        path = tmp_path / "geojson_map.json"
        path.write_text(json.dumps({**values, **changes}))
        return path

    return write


def level(door_width="1") -> dict:
    """Two rooms of one level with a wall of 0.2 m between them, one above, a door and a window."""
    return collection(
        room([(0, 0), (8, 0), (8, 4), (4, 4), (0, 4)], "001"),
        room(box(0, 4.2, 8, 7.2), "002"),
        room(box(0, 0, 8, 7), "101", "1"),
        node(4, 4, door="yes", width=door_width),
        node(0, 2, window="glass", width="1"),
        node(0, 0, door="yes"),
    )


def test_the_floor_lies_between_the_places(floor):
    plan = load_map(floor())
    assert plan.bounds_m == pytest.approx([0, 0, 20, 15], abs=1e-6)
    assert plan.cells().is_free(np.array([[1.0, 1.0], [10.5, 5.0], [19.0, 14.0]])).all()
    assert not plan.cells().is_free(np.array([[6.0, 5.0], [14.0, 7.0], [6.0, 11.0]])).any()
    assert plan.floor_area_m2 == pytest.approx(300 - 30 - 45 - 12, rel=0.01)


def test_place_names_become_signs_that_face_the_floor_and_drawing_classes_do_not(floor):
    plan = load_map(floor())
    assert sorted(sign.text for sign in plan.signs) == ["bookshop", "louti"]
    for sign in plan.signs:
        front = sign.position_m + 0.5 * np.array([np.cos(sign.facing_rad), np.sin(sign.facing_rad)])
        assert plan.cells().is_free(front)


def test_coincident_places_are_walls_once(floor):
    plan = load_map(floor())
    counts, losses = plan.wall_index.crossing(np.array([2.0, 5.0]), np.array([[10.0, 5.0]]))
    assert (counts[0], losses[0]) == (2, 5.0)


def test_a_level_is_joined_by_its_doors_and_closed_elsewhere(tmp_path):
    path = tmp_path / "building.geojson.gz"
    path.write_bytes(gzip.compress(json.dumps(level()).encode()))
    plan = load_map(path)
    assert plan.name == "building-0"
    assert sorted(room.name for room in plan.rooms) == ["001", "002"]
    centre = np.mean([plan.bounds_m[:2], plan.bounds_m[2:]], axis=0)
    x0, y0 = centre - np.array([4, 3.6])
    inside = np.array([[x0 + 4, y0 + 2], [x0 + 4, y0 + 4.1], [x0 + 4, y0 + 6]])
    assert plan.cells().is_free(inside).all()
    assert not plan.cells().is_free(np.array([x0 + 2, y0 + 4.1]))
    counts, _ = plan.wall_index.crossing(inside[0], inside[2:])
    assert counts[0] == 0
    assert sorted(sign.text for sign in plan.signs) == ["001", "002"]


@pytest.mark.parametrize(
    "above",
    [
        [(0, 4), (4, 4), (8, 4), (8, 7), (0, 7)],
        [(0, 4.2), (4, 4.2), (8, 4.2), (8, 7.2), (0, 7.2)],
        [(4, 4.2), (4, 4.2), (8, 4.2), (8, 7.2), (0, 7.2), (0, 4.2)],
    ],
)
def test_a_door_may_be_a_corner_of_both_rooms_and_drawn_twice(building, above):
    values = level()
    values["features"][1]["geometry"] = polygon(above)["geometry"]
    plan = load_map(building(values))
    assert sorted(room.name for room in plan.rooms) == ["001", "002"]
    assert sorted(sign.text for sign in plan.signs) == ["001", "002"]
    low, high = (
        np.mean(room.polygon_m, axis=0) * [0, 1] + [plan.rooms[0].polygon_m[:, 0].mean(), 0] for room in plan.rooms
    )
    assert plan.wall_index.crossing(low, high[None])[0].tolist() == [0]


def around_a_core(door: bool) -> dict:
    """A corridor around a store of 7.6 x 3.6 m and a yard, its two holes; beside it the second part of a room."""

    def parts(name, *polygons):
        feature = room(box(0, 0, 1, 1), name)
        rings = [[[lonlat(*corner) for corner in [*ring, ring[0]]] for ring in rings] for rings in polygons]
        feature["geometry"] = {"type": "MultiPolygon", "coordinates": rings}
        return feature

    store = [(4.2, 4.2), (8, 4.2), (11.8, 4.2), (11.8, 7.8), (4.2, 7.8)]
    return collection(
        parts("corridor", [box(0, 0, 16, 12), box(4, 4, 12, 8), box(4, 9, 8, 11)[::-1]]),
        parts("store", [store]),
        parts("annex", [box(30, 0, 31, 1)], [[(16.2, 0), (16.2, 2), (16.2, 4), (20, 4), (20, 0)][::-1]]),
        parts("sliver", [[(1, 1), (2, 1), (1, 1)]], [[(1, 1), (2, 1), (3, 1)]]),
        *[node(8, 4.2, door="yes")] * door,
        node(16.2, 2.0, door="yes"),
    )


@pytest.mark.parametrize("door", [True, False])
def test_rooms_go_around_others_and_have_several_parts(building, door):
    plan = load_map(building(around_a_core(door)))
    corner = np.array(plan.bounds_m[:2])
    places = {"corridor": (2, 2), "store": (6, 6), "yard": (6, 10), "wall": (4.1, 6), "annex": (18, 2)}
    is_free = dict(zip(places, plan.cells().is_free(corner + np.array([*places.values()])), strict=True))
    assert is_free == {"corridor": True, "store": door, "yard": False, "wall": False, "annex": True}
    assert plan.floor_area_m2 == pytest.approx(16 * 12 - 32 - 8 + 3.8 * 4 + door * 7.6 * 3.6, rel=0.02)
    assert sorted(room.name for room in plan.rooms) == ["annex", "corridor", *["store"] * door]


def test_a_ring_that_is_not_closed_keeps_its_last_corner(building):
    closed, values = load_map(building(level())), level()
    for feature in values["features"][:3]:
        del feature["geometry"]["coordinates"][0][-1]
    np.testing.assert_array_equal(load_map(building(values)).walls_m, closed.walls_m)


def test_all_parts_of_a_place_are_closed(floor):
    values = json.loads(floor().read_text())
    shop, stairs = values["features"][2], values["features"][3]
    shop["geometry"] = {"type": "MultiPolygon", "coordinates": [f["geometry"]["coordinates"] for f in (shop, stairs)]}
    plan = load_map(floor(features=[values["features"][0], shop]))
    assert plan.floor_area_m2 == pytest.approx(300 - 30 - 45, rel=0.01)


def test_another_level_is_asked_for_by_its_number(building):
    path = building(level())
    assert [room.name for room in load_map(f"{path}#1").rooms] == ["101"]
    with pytest.raises(MapError, match="has no level '7'; levels are 0, 1: write FILE#LEVEL"):
        load_map(f"{path}#7")


@pytest.mark.parametrize("floor", ["0", 0, "0;1"])
@pytest.mark.parametrize("scheme", ["buildingpart", "indoor"])
def test_tags_may_be_properties_in_either_scheme(building, scheme, floor):
    values = level()
    rooms = [room.name for room in load_map(building(values)).rooms]
    for feature in values["features"]:
        own = feature["properties"]
        is_above = own.get("relations", [{}])[0].get("reltags") == {"level": "1"}
        own |= {scheme if key == "buildingpart" else key: value for key, value in own.pop("tags").items()}
        own["level"] = "1" if is_above else floor
        own.pop("relations", None)
    outline = polygon(box(-1, -1, 9, 9), indoor="wall", level="0")
    flat = building(collection(*values["features"], outline))
    assert [room.name for room in load_map(flat).rooms] == rooms


@pytest.mark.parametrize("tags", [{}, {"tags": None}])
def test_rooms_without_a_level_are_those_of_level_0(building, tags):
    rooms = [polygon(box(8 * k, 0, 8 * k + 8, 6), indoor="room", name=f"R{k}", **tags) for k in range(2)]
    path = building(collection(*rooms))
    assert [room.name for room in load_map(path).rooms] == ["R0"]
    with pytest.raises(MapError, match="has no level '1'; levels are 0: write FILE#LEVEL"):
        load_map(f"{path}#1")


@pytest.mark.parametrize(
    "values",
    [
        {"type": "Polygon", "coordinates": [box(0, 0, 8, 6)]},
        {"type": "LineString", "coordinates": box(0, 0, 8, 6)},
        {"type": "GeometryCollection", "geometries": [{"type": "Polygon", "coordinates": [box(0, 0, 8, 6)]}]},
        {"type": "Topology", "objects": {}},
        {"features": []},
    ],
)
def test_what_is_geojson_but_no_collection_is_not_taken_for_a_plan_of_our_own(building, values):
    with pytest.raises(MapError, match="is not a GeoJSON FeatureCollection with features"):
        load_map(building(values))


def in_metres() -> dict:
    values = level()
    values["features"][0]["geometry"]["coordinates"] = [[[0, 0], [8, 0], [8, 4], [4, 4], [0, 4], [0, 0]]]
    return values


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        (collection(polygon(box(0, 0, 8, 6), tags={"indoor": "wall", "level": "0"})), "tagged indoor=room"),
        (polygon(box(0, 0, 8, 6)), "is not a GeoJSON FeatureCollection with features"),
        (in_metres(), "is wider than 2000 m; cut out one building, or, if its numbers are metres"),
    ],
)
def test_what_is_no_building_in_degrees_is_refused(building, values, expected):
    with pytest.raises(MapError, match=expected):
        load_map(building(values))


@pytest.mark.parametrize("width", ["1.2m", "wide", "", "900"])
def test_door_widths_that_are_no_numbers_become_plain_doors(building, width):
    assert len(load_map(building(level(width))).rooms) == 2


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"features": []}, "not a GeoJSON FeatureCollection with features"),
        ({"features": [1]}, "not a GeoJSON FeatureCollection with features"),
        ({"features": [{"type": "Feature"}]}, "feature 0 must be the polygon of the floor"),
        ({"features": [polygon([(0, 0), (1, 0), (2, 0)])]}, "outline has no area"),
        ({"features": [polygon([(0, 0), (float("nan"), 0), (2, 5)])]}, "must hold closed rings"),
        ({"features": [polygon(box(0, 0, 9, 9)), polygon(box(0, 0, 9, 9))]}, "leaves no floor between its places"),
        ({"crs": {"type": "name", "properties": {"name": "EPSG:3857"}}}, "is drawn in EPSG:3857; export it in long"),
        ({"crs": "here"}, "is drawn in here; export it in longitude and latitude"),
    ],
)
def test_faulty_floors_are_refused(floor, changes, expected):
    with pytest.raises(MapError, match=expected) as caught:
        read_geojson(floor(**changes))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("info", "expected"),
    [
        (None, "has no OpenStreetMap tags .* no floor_info.json beside it"),
        ("{}", "must hold map_info with width and height"),
        ('{"map_info": {"width": 1e9, "height": 5}}', "must be 1 to 2000 m"),
    ],
)
def test_a_floor_without_its_size_is_refused(floor, info, expected):
    path = floor()
    (path.parent / "floor_info.json").unlink()
    if info is not None:
        (path.parent / "floor_info.json").write_text(info)
    with pytest.raises(MapError, match=expected):
        read_geojson(path)


@pytest.mark.parametrize("name", ["urn:ogc:def:crs:OGC:1.3:CRS84", "EPSG:4326", "urn:ogc:def:crs:EPSG::4326"])
def test_a_file_that_says_that_it_is_in_degrees_is_read(floor, name):
    crs = {"type": "name", "properties": {"name": name}}
    assert read_geojson(floor(crs=crs)).floor_area_m2 == pytest.approx(read_geojson(floor()).floor_area_m2)


@pytest.mark.parametrize("place", [[2138456.5, 6024123.25], [19.0, 95.0]])
@pytest.mark.parametrize("what", ["corner", "door"])
def test_a_building_in_metres_of_a_projection_is_refused_with_the_remedy(building, place, what):
    values = level()
    if what == "corner":
        values["features"][0]["geometry"]["coordinates"][0][1] = place
    else:
        values["features"][3]["geometry"]["coordinates"] = place
    with pytest.raises(
        MapError, match=r"is not a longitude and latitude in degrees; export it in .*EPSG:4326"
    ) as caught:
        load_map(building(values))
    assert f"[{place[0]:.9g}, {place[1]:.9g}]" in str(caught.value)


def area_m2(ring: np.ndarray) -> float:
    x, y = ring.T
    return abs(float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())) / 2


@needs_data
@pytest.mark.parametrize(("floor", "signs"), [("site1_B1", 500), ("site2_F6", 60)])
def test_walkers_of_a_real_floor_stay_on_its_free_space(floor, signs):
    plan = load_map(DATA / f"indoor20/{floor}/geojson_map.json.gz")
    texts = Counter(sign.text for sign in plan.signs)
    assert plan.name == floor
    assert len(plan.signs) >= signs
    assert not DRAWING_CLASSES & set(texts)
    points = []
    for path in sorted((DATA / f"indoor20/{floor}/traces").glob("*.xz"))[::4]:
        with lzma.open(path, "rt", encoding="utf-8") as file:
            rows = [line.split("\t") for line in file if "TYPE_WAYPOINT" in line]
        points += [(float(row[2]), float(row[3])) for row in rows]
    assert len(points) > 80
    assert plan.cells().is_free(np.array(points)).mean() > 0.96
    World(EnvConfig(), plan).reset(0)


@needs_data
@pytest.mark.parametrize(("number", "rooms", "names"), [("-1", 20, 0), ("0", 20, 12), ("1", 29, 20), ("2", 18, 10)])
def test_every_level_of_a_real_building_loads(number, rooms, names):
    plan = load_map(f"{DATA}/maps/osm_indoor/budapest.geojson.gz#{number}")
    assert len(plan.rooms) >= rooms
    assert len(plan.signs) >= names
    # Closed in a fine raster too, and rooms and doors are all of the floor.
    assert plan.floor_area_m2 == pytest.approx(sum(area_m2(room.polygon_m) for room in plan.rooms), rel=0.02)
    World(EnvConfig(), plan).reset(0)


@pytest.mark.parametrize(
    ("latitude_deg", "along_km", "across_km"),
    [(0, 110.574, 111.320), (30, 110.852, 96.486), (45, 111.132, 78.847), (60, 111.412, 55.800), (75, 111.618, 28.902)],
)
def test_a_degree_is_as_long_as_on_the_ellipsoid(latitude_deg, along_km, across_km):
    for sign in (-1, 1):
        assert metres_per_degree(sign * latitude_deg) == pytest.approx([1e3 * across_km, 1e3 * along_km], abs=0.6)


def grid_of_rooms(columns: int, rows: int) -> dict:
    """Rooms of 2.9 m, each with a door in its northern wall."""
    rooms, doors = [], []
    for x in range(columns):
        for y in range(rows):
            x0, y0 = 3.0 * x, 3.0 * y
            corners = [(x0, y0), (x0 + 2.9, y0), (x0 + 2.9, y0 + 2.9), (x0 + 1.5, y0 + 2.9), (x0, y0 + 2.9)]
            rooms.append(room(corners, f"{x}-{y}"))
            doors.append(node(x0 + 1.5, y0 + 2.9, door="yes"))
    return collection(*rooms, *doors)


def test_doors_are_only_compared_with_rooms_near_them(building, monkeypatch):
    compared = []
    original = osm_level._nearest
    monkeypatch.setattr(osm_level, "_nearest", lambda sides, place: compared.append(1) or original(sides, place))
    plan = load_map(building(grid_of_rooms(8, 12)))
    assert len(plan.rooms) == 12
    assert len(compared) < 10 * 8 * 12


def test_rooms_and_doors_that_a_file_repeats_count_once(building):
    once = grid_of_rooms(1, 3)
    twice = load_map(building({**once, "features": [*once["features"], *once["features"]]}))
    assert len(twice.rooms) == 3
    plan = load_map(building(once))
    assert (len(twice.walls_m), len(twice.signs)) == (len(plan.walls_m), len(plan.signs))


def test_an_odd_number_as_a_tag_is_no_name(building):
    values = grid_of_rooms(1, 2)
    values["features"][0]["properties"]["tags"]["name"] = 10**400
    assert [r.name for r in load_map(building(values)).rooms] == ["ROOM 1", "0-1"]


def test_a_byte_order_mark_before_the_file_is_skipped(building):
    path = building(grid_of_rooms(1, 2))
    plain = load_map(path).digest
    path.write_text("\ufeff" + path.read_text(), encoding="utf-8")
    assert load_map(path).digest == plain


def test_a_floor_too_large_for_the_raster_is_refused_at_once(floor, tmp_path):
    (tmp_path / "floor_info.json").write_text('{"map_info": {"width": 1999.0, "height": 1999.0}}')
    with pytest.raises(MapError, match=r"a floor of 1999 x 1999 m is too large; check floor_info\.json"):
        load_map(floor())


def test_a_floor_too_narrow_for_the_raster_is_refused(tmp_path):
    (tmp_path / "floor_info.json").write_text('{"map_info": {"width": 20.0, "height": 15.0}}')
    blocks = [polygon(box(0, 0, 9.99, 15)), polygon(box(10.15, 0, 20, 15))]
    (tmp_path / "a.geojson").write_text(json.dumps(collection(polygon(box(0, 0, 20, 15)), *blocks)))
    with pytest.raises(MapError, match="has no free space"):
        load_map(tmp_path / "a.geojson")


def test_the_faulty_feature_of_a_file_is_named(floor, building):
    values = grid_of_rooms(1, 2)
    values["features"][1]["geometry"]["coordinates"] = [[[19.0, 47.0]]]
    with pytest.raises(MapError, match=r"building\.geojson: feature 1: a Polygon must hold closed rings"):
        load_map(building(values))
    broken = polygon([(1.0, 1.0), (2.0, 1.0), (2.0, 2.0)])
    broken["geometry"]["coordinates"][0][1] = [1e5, 5e6]
    with pytest.raises(MapError, match=r"feature 1: \[100000, 5000000\] is not a longitude and latitude"):
        load_map(floor(features=[polygon(box(0, 0, 20, 15)), broken]))


def areas(count, kind="area", step=5.0):
    return [
        polygon(box(x * step, y * step, x * step + 5, y * step + 5), indoor=kind, level="0", name=f"{x}-{y}")
        for x, y in (divmod(k, 20) for k in range(count))
    ]


def test_a_level_of_thousands_of_rooms_is_refused_before_they_are_read(building, monkeypatch):
    monkeypatch.setattr(osm_level, "ROOMS_MAX", 8)
    with pytest.raises(MapError, match="level '0' has 9 rooms, 8 are possible; cut out one building"):
        read_geojson(building(collection(*areas(9, "room"))))
    monkeypatch.setattr(osm_level, "polygons_of", lambda *_: pytest.fail("read"))
    with pytest.raises(MapError, match="cut out one building"):
        read_geojson(building(collection(*areas(9, "room"))))


def test_areas_upon_one_another_are_refused_and_neighbours_are_not(building, monkeypatch):
    monkeypatch.setattr(osm_level, "PAIRS_MAX", 60)
    assert len(read_geojson(building(collection(*areas(20)))).walls_m) > 3
    with pytest.raises(MapError, match="many rooms of level '0' lie upon one another; draw each once"):
        read_geojson(building(collection(*areas(20, step=0.5))))


def test_a_level_of_thousands_of_doors_is_refused(building, monkeypatch):
    monkeypatch.setattr(osm_level, "DOORS_MAX", 3)
    doors = [node(5.0, 1.0 + 0.5 * k, door="yes", level="0") for k in range(4)]
    with pytest.raises(MapError, match="level '0' has more than 3 doors"):
        read_geojson(building(collection(*areas(2, "room"), *doors)))


def test_a_door_between_very_many_outlines_is_refused(building):
    with pytest.raises(MapError, match="lie upon one another"):
        read_geojson(building(collection(*areas(60, "room", step=0.1), node(1.0, 2.5, door="yes", level="0"))))
