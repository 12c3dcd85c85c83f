import dataclasses
import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from twc_env.__main__ import main
from twc_env.__main__ import main as explore
from twc_env.maps import load_map, map_names
from twc_env.pictures.map_picture import draw_plan, plan_figure
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.floorplan_file import write_floorplan
from twc_env.world.building.splits import SPLITS


def run(*arguments) -> int:
    return main(["maps", *map(str, arguments)])


def test_list_shows_every_bundled_map_and_how_to_name_others(capsys):
    assert run("list") == 0
    out = capsys.readouterr().out
    assert all(name in out for name in map_names())
    assert "gen:KIND:AREA:SEED" in out and "train/0000 (1000)" in out


def test_without_a_command_the_maps_are_listed(capsys):
    assert run() == 0
    assert "twin-01" in capsys.readouterr().out


def test_list_describes_the_given_maps(capsys):
    assert run("list", "sfw-e4", "gen:mall:300:1") == 0
    out = capsys.readouterr().out
    assert "52 m2" in out and "gen:mall:300:1" in out and "twin-01" not in out


def test_tables_of_maps_fold_at_a_narrow_terminal(monkeypatch, capsys):
    monkeypatch.setattr("twc_env.commands.maps.terminal_width", lambda: 50)
    for command in ("list", "check"):
        assert run(command, "twin-01", "twin-02") == 0
        lines = capsys.readouterr().out.splitlines()
        assert max(map(len, lines)) <= 50
        assert sum("twin-02" in line for line in lines) == 2 and lines[-3].endswith("access points")


def test_show_writes_a_picture_with_and_without_signal(tmp_path, capsys):
    image = pytest.importorskip("PIL.Image", reason="Pillow is an optional dependency")
    for options in ([], ["--no-signal"]):
        path = tmp_path / f"picture{len(options)}.png"
        assert run("show", "sfw-e5", "--out", path, *options) == 0
        with image.open(path) as picture:
            assert min(picture.size) > 300
            assert len(picture.convert("RGB").getcolors(1 << 24)) > 50
    assert (tmp_path / "picture0.png").read_bytes() != (tmp_path / "picture1.png").read_bytes()
    assert "written: " in capsys.readouterr().out


def test_a_picture_without_suffix_is_a_png_and_its_path_is_printed(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    assert run("show", "sfw-e5", "--no-signal", "--out", tmp_path / "plan") == 0
    assert [path.name for path in tmp_path.iterdir()] == ["plan.png"]
    assert f"written: {tmp_path / 'plan.png'}" in capsys.readouterr().out
    assert run("show", "sfw-e5", "--out", tmp_path) == 2
    assert "it is a folder; name a file in it" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["twin-01", "gen:office:300:1"])
def test_names_in_a_plan_stay_inside_the_axes_and_do_not_overlap(name):
    pytest.importorskip("matplotlib")
    plan = load_map(name)
    figure = plan_figure(plan)
    (axes,) = [axes for axes in figure.axes if axes.get_xlabel() == "x [m]"]
    frame, boxes = axes.get_window_extent(), [text.get_window_extent() for text in axes.texts]
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))
    assert all(frame.x0 <= box.x0 and box.x1 <= frame.x1 and frame.y0 <= box.y0 and box.y1 <= frame.y1 for box in boxes)
    shown = {text.get_text().replace("\n", " ") for text in axes.texts}
    assert len(shown) >= 0.9 * len({sign.text for sign in plan.signs} | {room.name for room in plan.rooms})


@pytest.mark.parametrize("name", ["twin-01", "twin-02", "gen:office:300:1", "gen:ward:800:7"])
def test_names_in_a_plan_touch_no_access_point(name):
    pytest.importorskip("matplotlib")
    plan = load_map(name)
    axes = plan_figure(plan).axes[0]
    points = axes.transData.transform([point.position_m for point in plan.access_points])
    assert [text.get_text() for text in axes.texts if text.get_window_extent().padded(3).count_contains(points)] == []


def test_signs_are_squares_in_a_plan_as_in_the_map_of_an_episode():
    pytest.importorskip("matplotlib")
    (legend,) = plan_figure(load_map("sfw-e3"), with_signal=False).legends
    marks = {
        text.get_text(): mark.get_marker() for text, mark in zip(legend.get_texts(), legend.legend_handles, strict=True)
    }
    assert (marks["unique signs (3)"], marks["repeated signs (2)"], marks["access points (1)"]) == ("s", "s", "^")


def test_colours_of_signal_strength_end_at_the_outer_walls():
    pytest.importorskip("matplotlib")
    plan = load_map("sfw-e3")
    figure = plan_figure(dataclasses.replace(plan, signs=()))
    figure.canvas.draw()
    image = np.asarray(figure.canvas.buffer_rgba())[..., :3]
    at_m = [(1.0, -0.06), (5.0, 0.94), (8.44, 0.2), (1.0, 0.2), (5.0, 1.2)]  # outside of three walls, and inside
    u, v = figure.axes[0].transData.transform(at_m).T
    colours = image[np.round(image.shape[0] - v).astype(int), np.round(u).astype(int)]
    assert (colours[:3] == 255).all() and (colours[3:].min(axis=1) < 255).all()


def test_a_plan_is_written_in_every_format_and_the_same_each_time(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    for kind, begin in (("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")):
        for folder in ("first", "again"):
            path = tmp_path / folder / f"plan.{kind}"
            assert run("show", "sfw-e5", "--no-signal", "--dpi", 60, "--out", path) == 0
        assert path.read_bytes().startswith(begin)
        assert path.read_bytes() == (tmp_path / "first" / path.name).read_bytes()
    assert run("show", "sfw-e5", "--no-signal", "--format", "svg", "--out", tmp_path / "plan") == 0
    assert (tmp_path / "plan.svg").exists()


def test_a_plan_of_walls_alone_is_drawn_without_a_warning(tmp_path, recwarn):
    pytest.importorskip("matplotlib")
    plan = load_map("sfw-e1")
    draw_plan(dataclasses.replace(plan, rooms=(), signs=(), access_points=()), tmp_path / "bare.png")
    assert not [str(warning.message) for warning in recwarn if "legend" in str(warning.message)]


def test_dollar_signs_in_names_are_not_parsed_as_formulas(tmp_path):
    pytest.importorskip("matplotlib")
    plan = load_map("sfw-e1")
    signs = [dataclasses.replace(sign, text="$A_$") for sign in plan.signs]
    rooms = [dataclasses.replace(room, name="ALL FOR $5_$") for room in plan.rooms]
    write_floorplan(dataclasses.replace(plan, name="$^$", signs=signs, rooms=rooms), tmp_path / "shop.json")
    assert plan.signs and plan.rooms
    assert run("show", tmp_path / "shop.json", "--out", tmp_path / "shop.png") == 0
    assert (
        explore(["explore", "--map", str(tmp_path / "shop.json"), "--steps", "3", "--out", str(tmp_path / "run")]) == 0
    )
    assert (tmp_path / "run" / "map.png").is_file()


def test_generate_writes_the_building_of_the_generated_name(tmp_path):
    path = tmp_path / "ward.json"
    assert run("generate", "ward", 250, "--seed", 4, "--out", path) == 0
    assert load_map(path).digest == load_map("gen:ward:250:4").digest


def test_generate_uses_consecutive_seeds(tmp_path):
    assert run("generate", "office", 150, "--seed", 2, "--count", 3, "--out", tmp_path / "o.json") == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["o-2.json", "o-3.json", "o-4.json"]


def test_an_exported_ros_map_can_be_imported(tmp_path, capsys):
    assert run("export", "twin-01", tmp_path / "twin.yaml") == 0
    assert "left out: 5 rooms, 14 signs" in capsys.readouterr().out
    assert (tmp_path / "twin.pgm").is_file()
    assert run("import", tmp_path / "twin.yaml", "--seed", 3, "--out", tmp_path / "again.json") == 0
    assert load_map(tmp_path / "again.json").floor_area_m2 == pytest.approx(load_map("twin-01").floor_area_m2, rel=0.06)


def test_pictures_are_imported_at_their_resolution(tmp_path):
    assert run("export", "twin-01", tmp_path / "twin.yaml", "--resolution", 0.1) == 0
    picture = (tmp_path / "twin.pgm").read_bytes().replace(b"\xfe", b"\xff")
    (tmp_path / "twin.pgm").write_bytes(picture)
    assert run("import", tmp_path / "twin.pgm", "--resolution", 0.1, "--out", tmp_path / "again.json") == 0
    assert load_map(tmp_path / "again.json").bounds_m[2:] - load_map(tmp_path / "again.json").bounds_m[
        :2
    ] == pytest.approx(load_map("twin-01").bounds_m[2:] - load_map("twin-01").bounds_m[:2], abs=0.2)


def test_check_distinguishes_valid_from_invalid_maps(tmp_path, capsys):
    assert run("check", "twin-01", "gen:ring:200:0", "--json", tmp_path / "a.json") == 0
    findings = json.loads((tmp_path / "a.json").read_text())
    assert findings["faults"] == [] and findings["floor_m2"]["twin-01"] == pytest.approx(236.9, abs=0.5)
    (tmp_path / "broken.json").write_text("{")
    capsys.readouterr()
    assert run("check", "twin-01", tmp_path / "broken.json") == 2
    head, sound, fault = capsys.readouterr().out.splitlines()
    assert fault.startswith("FAULT") and sound.startswith("sound")
    assert head.index("floor") < sound.index("m2") and head.split()[-2:] == ["access", "points"]
    assert len(head) == len(sound)


def test_starts_of_an_own_plan_that_are_not_used_are_remarked_upon(tmp_path, capsys):
    write_floorplan(load_map("twin-01"), tmp_path / "mine.json")
    told = f"{tmp_path / 'mine.json'}: robots start at random, not at its starts, unless --set episode.starts=map"
    assert run("check", tmp_path / "mine.json", "twin-01") == 0
    assert capsys.readouterr().err.count(told) == 1
    episode = ["explore", "--steps", "1", "--no-pictures", "--out", str(tmp_path / "run")]
    for more, is_told in (([], True), (["--set", "episode.starts=map"], False)):
        assert explore([*episode, "--map", str(tmp_path / "mine.json"), *more]) == 0
        assert (told in capsys.readouterr().err) == is_told
    assert explore(episode) == 0 and "at its starts" not in capsys.readouterr().err


@pytest.mark.parametrize(("gap_m", "is_told"), [(0.4, True), (1.0, False)])
def test_floor_behind_gaps_too_narrow_for_the_robots_is_remarked_upon(tmp_path, capsys, gap_m, is_told):
    sides = [(0, 0, 8, 0), (8, 0, 8, 4), (8, 4, 0, 4), (0, 4, 0, 0), (5, 0, 5, 2), (5, 2 + gap_m, 5, 4)]
    walls = np.array(sides, float).reshape(-1, 2, 2)
    plan = Floorplan("two", walls, np.full(len(walls), 5.0), interior_m=np.array([[1.0, 1.0]]))
    mine = tmp_path / "mine.json"
    write_floorplan(plan, mine)
    assert run("check", mine) == 0
    told = f"{mine}: 9 m2 of the floor or more are cut off for robots of 0.2 m radius"
    assert (told in capsys.readouterr().err) == is_told
    episode = ["explore", "--map", str(mine), "--robots", "1", "--steps", "1", "--no-pictures", "--out", str(tmp_path)]
    assert explore(episode) == 0
    assert (told in capsys.readouterr().err) == is_told
    assert explore([*episode, "--set", "dynamics.robot_radius_m=0.55"]) == 0
    assert "m2 of the floor or more are cut off for robots of 0.55 m radius" in capsys.readouterr().err


def test_a_plan_tells_glass_from_other_walls():
    plan = load_map("sfw-e1")
    made_of = ["glass", *[""] * (len(plan.walls_m) - 2), "brick"]
    for materials, legend in ((made_of, ["glass (1)"]), ([], [])):
        figure = plan_figure(dataclasses.replace(plan, wall_materials=tuple(materials)), with_signal=False)
        names = [text.get_text() for text in figure.legends[0].get_texts()]
        assert [name for name in names if name.startswith("glass")] == legend
        assert len({tuple(colour) for colour in figure.axes[0].collections[0].get_colors()}) == 1 + len(legend)


def test_signs_of_letters_that_our_fonts_lack_are_drawn_without_a_warning(tmp_path, recwarn):
    plan = load_map("sfw-e1")
    sign = dataclasses.replace(plan.signs[0], text="\u51fa\u53e3")
    draw_plan(dataclasses.replace(plan, signs=(sign,)), tmp_path / "a.png")
    assert not [w for w in recwarn if "missing from font" in str(w.message)]


def test_help_and_readme_tell_how_many_buildings_the_splits_have(capsys):
    with pytest.raises(SystemExit):
        run("check", "--help")
    readme = (Path(__file__).parents[2] / "maps" / "README.md").read_text()
    for text in (capsys.readouterr().out, readme):
        assert f"generates all {sum(SPLITS.values()):,} " in " ".join(text.split())


def test_schema_prints_the_schema(capsys):
    assert run("schema") == 0
    assert json.loads(capsys.readouterr().out)["title"] == "twc_env/floorplan-1"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["show", "twin-1"], "did you mean 'twin-01'?"),
        (["show", "twin-01", "--out", "taken/a.png"], "cannot write taken/a.png: taken is no place"),
        (["generate", "castle", "300"], "kinds are office, ring"),
        (["generate", "office", "30"], "must be 100 to 10000 m2"),
        (["generate", "office", "300", "--out", "a.png"], "--out must end in .json"),
        (["import", "none.yaml"], "there is no map file 'none.yaml'"),
        (["import", "none.yaml", "--resolution", "0.1"], "--resolution is for .png and .pgm"),
        (["import", "none.pgm", "--resolution", "0"], "--resolution must be 0.005 to 10"),
        (["export", "twin-01", "a.dxf"], "use a name that ends in"),
        (["export", "twin-01", "a.json", "--resolution", "0.1"], "--resolution is for .yaml and .png"),
        (["generate", "office", "300", "--out", "taken/a.json"], "cannot write taken/a.json: "),
        (["check", "none"], "one check failed"),
    ],
)
def test_mistakes_end_with_one_line_and_status_2(arguments, message, refusal, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").touch()
    assert message in refusal(main, ["maps", *arguments])


@pytest.mark.parametrize(
    ("arguments", "least"),
    [
        ("generate office 300 --count 0", 1),
        ("generate office 300 --seed -1", 0),
        ("import plan.png --seed -1", 0),
    ],
)
def test_numbers_out_of_range_are_rejected(arguments, least, capsys):
    with pytest.raises(SystemExit) as stopped:
        run(*arguments.split())
    assert stopped.value.code == 2
    assert f"must be a whole number of at least {least}" in capsys.readouterr().err


@pytest.mark.parametrize("command", [[], ["list"], ["show"], ["generate"], ["import"], ["export"], ["check"]])
def test_help_explains_the_names_of_maps(command, capsys):
    with pytest.raises(SystemExit) as stopped:
        run(*command, "--help")
    assert stopped.value.code == 0
    assert "gen:office:800:7" in capsys.readouterr().out


def test_folders_of_maps_and_pictures_are_created(tmp_path):
    assert run("generate", "office", "300", "--out", tmp_path / "new" / "a.json") == 0
    assert run("import", tmp_path / "new" / "a.json", "--out", tmp_path / "brought" / "in" / "a.json") == 0
    assert run("export", "sfw-e1", tmp_path / "given" / "a.yaml") == 0
    assert load_map(str(tmp_path / "brought" / "in" / "a.json")).floor_area_m2 > 200
    assert load_map(str(tmp_path / "given" / "a.yaml")).floor_area_m2 > 10
    pytest.importorskip("matplotlib")
    assert run("show", "sfw-e1", "--no-signal", "--out", tmp_path / "drawn" / "a.png") == 0
    assert (tmp_path / "drawn" / "a.png").exists()


def test_a_fault_of_a_map_is_printed_once(capsys):
    assert run("check", "none", "sfw-e1", "gone") == 2
    said = capsys.readouterr()
    assert said.out.count("no map named 'none'") == said.out.count("no map named 'gone'") == 1
    assert said.err == "error: 2 checks failed\n"


def test_repeated_layouts_are_printed(monkeypatch, capsys):
    monkeypatch.setattr("twc_env.world.building.splits.split_layouts", lambda split: ["one layout"])
    assert run("check", "--splits") == 2
    assert "FAULT  validation/0000 repeats the layout of train/0000" in capsys.readouterr().out
