"""The map figure by its content: where texts are, what the legend says, which pixels are walls."""

import dataclasses
import itertools
from importlib.resources import files

import numpy as np
import pytest

import twc_env
from twc_env.bench.rates import wander
from twc_env.exploration.drawing import frame, palette
from twc_env.exploration.drawing.labels import building_name
from twc_env.exploration.drawing.rendering import Scene
from twc_env.records.messages import GridMap

to_hex = pytest.importorskip("matplotlib.colors", reason="needs the extra 'viz'").to_hex


def played(**settings):
    env = twc_env.parallel_env(**settings)
    env.reset(seed=1)
    for actions in wander(env, 1):
        env.step(actions)
    return env.result()


@pytest.fixture(scope="module")
def unmerged():
    """Eight robots, none of which share a map."""
    config = {"slam.merging.enabled": False, "lidar.beam_count": 60}
    return played(map="gen:office:500:3", robots=8, max_cycles=25, config=config)


@pytest.fixture(scope="module")
def small():
    return played(map="twin-02", robots=2, max_cycles=40, config={"lidar.beam_count": 90})


def box_of(text):
    return text.get_window_extent(text.figure.canvas.get_renderer())


@pytest.mark.parametrize("result", ["unmerged", "small"])
def test_names_stay_inside_the_axes_and_do_not_overlap(result, request):
    result = request.getfixturevalue(result)
    figure = result.plot()
    (axes,) = figure.axes
    frame, boxes = axes.get_window_extent(), [box_of(text) for text in axes.texts]
    assert len(boxes) >= result.true_poses.shape[1]
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))
    assert all(frame.x0 <= box.x0 and box.x1 <= frame.x1 and frame.y0 <= box.y0 and box.y1 <= frame.y1 for box in boxes)


@pytest.mark.parametrize("result", ["unmerged", "small"])
def test_names_touch_no_mark(result, request):
    result = request.getfixturevalue(result)
    (axes,) = result.plot().axes
    things = (*result.floorplan.signs, *result.floorplan.access_points)
    places = [thing.position_m for thing in things] + list(result.true_poses[[0, -1], :, :2].reshape(-1, 2))
    names = {sign.text for sign in result.floorplan.signs}
    boxes = [box_of(text).padded(4) for text in axes.texts if text.get_text() in names]
    assert len(boxes) > 5
    assert not any(box.count_contains(axes.transData.transform(places)) for box in boxes)


@pytest.mark.parametrize("result", ["unmerged", "small"])
def test_names_stand_before_the_walls_on_which_their_signs_hang(result, request):
    result = request.getfixturevalue(result)
    (axes,) = result.plot().axes
    aheads = []
    for text in axes.texts:
        own = [sign for sign in result.floorplan.signs if sign.text == text.get_text()]
        middle = axes.transData.inverted().transform(box_of(text).get_points().mean(axis=0))
        if own:
            sign = min(own, key=lambda sign: np.hypot(*(middle - sign.position_m)))
            aheads.append((middle - sign.position_m) @ [np.cos(sign.facing_rad), np.sin(sign.facing_rad)])
    assert len(aheads) > 5 and np.mean(np.array(aheads) > 0.05) >= 0.9


@pytest.mark.parametrize("name", ["unmerged", "small"])
def test_title_and_legend_are_whole_and_apart_from_the_axes(name, request):
    result = request.getfixturevalue(name)
    figure = result.plot()
    (axes,), title, (legend,) = figure.axes, figure._suptitle, figure.legends
    whole, tight = figure.bbox, axes.get_tightbbox()
    for box in (box_of(title), legend.get_window_extent(), tight):
        assert whole.x0 <= box.x0 and box.x1 <= whole.x1 and whole.y0 <= box.y0 and box.y1 <= whole.y1
    assert not box_of(title).overlaps(tight) and not legend.get_window_extent().overlaps(tight)
    for part in (f"seed {result.seed}", f"of {result.figures['robots']} robots in one map", "odometry"):
        assert part in " ".join(title.get_text().split())


def test_a_title_that_is_wider_than_the_picture_is_broken_not_cut_off(small):
    figures = {**small.figures, "map": "a-building-with-a-very-long-name-" * 9}
    figure = dataclasses.replace(small, figures=figures).plot()
    box = box_of(figure._suptitle)
    assert box.x0 >= 0 and box.x1 <= figure.bbox.width and figure._suptitle.get_text().count("\n") > 2
    assert not box.overlaps(figure.axes[0].get_tightbbox())


def test_captions_name_a_held_out_building_whole_and_a_file_without_its_folder():
    assert building_name("gen:office+ring:300:test/0001") == "gen:office+ring:300:test/0001"
    assert building_name("/home/me/plans/floor 2.json") == "floor 2.json"


def test_the_legend_explains_tinted_floor_where_there_are_several_maps_and_nowhere_else(unmerged):
    for result, is_explained in ((played(map="twin-01", robots=1, max_cycles=3), False), (unmerged, True)):
        (legend,) = result.plot().legends
        assert any(text.get_text() == "map of robot 0" for text in legend.get_texts()) == is_explained


def test_each_robot_is_one_entry_of_the_legend_with_both_of_its_paths(unmerged):
    (legend,) = unmerged.plot().legends
    names = [text.get_text() for text in legend.get_texts()]
    assert len(names) == len(set(names))
    assert [name for name in names if name.startswith("robot")] == [
        "robot 0: true (wide), estimated (thin)", *(f"robot {k}" for k in range(1, 8))
    ]  # fmt: skip


CLOSURES = [
    {"status": status, "correct": is_correct, "target_m": (1.0, 1.0), "source_m": (2.0, 1.0)}
    for status, is_correct in (("accepted", True), ("accepted", False), ("rejected", True), ("pending", True))
]


def test_the_map_the_film_and_the_page_use_the_same_words(small):
    (legend,) = dataclasses.replace(small, closures=CLOSURES).plot().legends
    of_map = " ".join(text.get_text() for text in legend.get_texts())
    poses = small.true_poses[-1]
    scene = Scene(np.ones((5, 5), bool), np.zeros(2), 0.1, small.grids, true_poses=poses, estimated_poses=poses)
    of_film = " ".join(text for _, _, text in frame.legend_of(scene))
    layers = files("twc_env.pictures").joinpath("replay_page.html").read_text().partition("const LAYERS")[2]
    of_page = layers.partition("filter")[0]
    for words in ("true walls", "mapped walls", "accepted closures", "rejected closures"):
        assert words in of_map and words in of_film and words in of_page
    for words in ("true poses and paths", "estimated poses"):
        assert words in of_film and words in of_page
    assert "true pose at the end" in of_map and "undecided closures (1)" in of_map


def test_a_closure_shows_on_the_floor_of_a_map_and_is_fainter_among_many(small):
    start_m = small.true_poses[0, 0, :2]
    here, away = (
        {"status": "rejected", "correct": False, "target_m": end_m, "source_m": end_m + 0.7}
        for end_m in (start_m, start_m - 900.0)
    )

    def picture(closures):
        figure = dataclasses.replace(small, closures=closures).plot()
        figure.canvas.draw()
        return np.asarray(figure.canvas.buffer_rgba()).astype(int)

    few, many = (np.abs(picture([here] + [away] * (n - 1)) - picture([away] * n)).max() for n in (30, 300))
    assert few > many > 15


def test_start_and_end_look_like_no_other_mark_and_their_samples_like_no_wall(small):
    (legend,) = small.plot().legends
    marks = {name.get_text(): mark for name, mark in zip(legend.get_texts(), legend.legend_handles, strict=True)}
    ends = {name: marks[name] for name in ("start", "true pose at the end")}
    assert len({mark.get_marker() for mark in ends.values()}) == 2
    assert {ends["start"].get_marker()}.isdisjoint(
        marks[name].get_marker() for name in ("signs", "access points", "true pose at the end")
    )
    for mark in ends.values():
        assert np.abs(palette.rgb(to_hex(mark.get_markerfacecolor())) - palette.rgb(palette.WALL)).min() > 60


def test_an_unmerged_team_is_told_what_odometry_knows(unmerged, small):
    title = unmerged.plot()._suptitle.get_text()
    assert "which knows the true starts" in " ".join(title.split())


def test_a_map_that_lies_askew_is_shown_whole_and_one_far_away_in_part(small):
    def limits(pose):
        (axes,) = dataclasses.replace(small, pose_building_map=np.tile(pose, (len(small.grids), 1))).plot().axes
        return np.array([axes.get_xlim(), axes.get_ylim()])

    (axes,) = small.plot().axes
    x0, y0, x1, y1 = small.floorplan.bounds_m
    assert np.allclose([axes.get_xlim(), axes.get_ylim()], [[x0 - 1, x1 + 1], [y0 - 1, y1 + 1]])
    beside = limits(small.pose_building_map[0] + [34.0, 0.0, 0.0])
    assert beside[0, 1] > x1 + 2 and beside[0, 0] == x0 - 1
    assert np.ptp(limits(np.array([500.0, 0.0, 0.0]))[0]) < 1.4 * (x1 - x0 + 2)


@pytest.mark.parametrize("turn_rad", [0.0, 0.4])
def test_wall_pixels_of_the_picture_lie_on_the_true_walls(small, turn_rad):
    """The estimate is replaced by the true building in turned cells, without anything else in the picture."""
    cells, size = small.floorplan.cells(), 500
    centres = np.stack(np.meshgrid(np.arange(size), np.arange(size)), axis=-1).reshape(-1, 2) * 0.1 + 0.05 - 20.0
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    places = centres @ np.array([[c, s], [-s, c]]) + (cells.origin_m + 15.0)
    column, row = np.floor((places - cells.origin_m) / cells.resolution_m).astype(int).T
    inside = (row >= 0) & (column >= 0) & (row < cells.wall.shape[0]) & (column < cells.wall.shape[1])
    log_odds = np.zeros(size * size, np.int16)
    log_odds[inside] = np.where(cells.wall[row[inside], column[inside]], 20, -20)
    grid = GridMap(log_odds.reshape(size, size), np.full(2, -20.0), 0.1)
    place = np.array([[*(cells.origin_m + 15.0), turn_rad]])
    bare = dataclasses.replace(
        small, grids=(grid,), pose_building_map=place, groups=((0, 1),), closures=[],
        floorplan=dataclasses.replace(small.floorplan, signs=(), access_points=()), viewers=((0, 1),),
        true_poses=np.full((2, 2, 3), -90.0), estimated_poses=np.full((2, 2, 3), -90.0),
        odometry_poses=np.full((2, 2, 3), -90.0),
    )  # fmt: skip
    figure = bare.plot()
    figure.canvas.draw()
    (axes,) = figure.axes
    image = np.asarray(figure.canvas.buffer_rgba())[..., :3]
    height = image.shape[0]
    v, u = np.mgrid[0:height, 0 : image.shape[1]]
    x, y = axes.transData.inverted().transform(np.column_stack([u.ravel() + 0.5, height - v.ravel() - 0.5])).T
    column, row = np.floor((np.column_stack([x, y]) - cells.origin_m) / cells.resolution_m).astype(int).T
    inside = (row >= 0) & (column >= 0) & (row < cells.wall.shape[0]) & (column < cells.wall.shape[1])
    true = np.zeros(image.shape[:2], bool).ravel()
    true[inside] = cells.wall[row[inside], column[inside]]
    dark = (np.abs(image.reshape(-1, 3).astype(int) - palette.rgb(palette.WALL)).max(axis=1) < 90) & inside
    assert np.count_nonzero(dark & true) / np.count_nonzero(dark | true) > 0.74


def test_pictures_have_every_format_the_asked_size_and_the_same_bytes(small, tmp_path):
    image = pytest.importorskip("PIL.Image")
    from twc_env.pictures.style import save_figure

    for kind, begin in (("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")):
        first, again = (save_figure(small.plot(), tmp_path / f"{k}.{kind}", 50) for k in range(2))
        assert first.read_bytes().startswith(begin) and first.read_bytes() == again.read_bytes()
    wide = save_figure(small.plot(), tmp_path / "wide.png", 100)
    with image.open(wide) as large, image.open(tmp_path / "0.png") as little:
        assert large.width == pytest.approx(2 * little.width, abs=2)
    with pytest.raises(twc_env.DataError, match="png, pdf, svg"):
        save_figure(small.plot(), tmp_path / "map.bmp")
