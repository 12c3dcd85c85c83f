import base64
import json
import re
import shutil
import zlib

import numpy as np
import pytest

import twc_env
from tests.chromium import CONTRASTS, screen
from tests.conftest import wander_by_scan
from twc_env.__main__ import main
from twc_env.bench.rates import wander
from twc_env.errors import ConfigError, DataError
from twc_env.exploration.drawing.smooth_map import wall_strokes
from twc_env.exploration.trace import FREE, TRACE_KEYS, UNKNOWN, WALL
from twc_env.pictures.replay_page import write_page
from twc_env.pictures.rerun_export import rectangles, write_rerun

STEPS = 120


def play(watched: bool):
    env = twc_env.parallel_env(map="twin-02", robots=2, max_cycles=STEPS, config={"lidar.beam_count": 90})
    env.reset(seed=3)
    trace = twc_env.EpisodeTrace(env, period_s=1.0) if watched else None
    seen = []
    for actions in wander(env, 3):
        observations, rewards, *_ = env.step(actions)
        seen.append((observations["robot_0"]["map"].tobytes(), rewards["robot_0"]))
        if trace is not None:
            trace.note(rewards)
    return env, trace, seen


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    env, trace, _ = play(watched=True)
    trace.write(folder / "trace.npz")
    (folder / "report.json").write_text(json.dumps({**env.result().figures, "agent": "wanderer"}))
    return folder


def data_of(page) -> dict:
    text = page.read_text(encoding="utf-8")
    start = text.index('type="application/json">') + len('type="application/json">')
    return json.loads(text[start : text.index("</script>", start)])


def test_a_trace_does_not_affect_the_episode():
    env, _, seen = play(watched=True)
    other, _, unwatched = play(watched=False)
    assert seen == unwatched
    assert env.result().figures == other.result().figures


def test_the_last_moment_of_the_page_equals_the_report(run):
    data = data_of(write_page(run, run / "page.html"))
    last, report = data["moments"][-1], data["report"]
    assert last["step"] == STEPS == report["steps"]
    for key in ("coverage_correct", "wall_iou", "team_ate_m", "merged_robots", "bytes_sent"):
        assert last["figures"][key] == pytest.approx(report[key], rel=1e-12), key
    assert last["figures"]["closures_accepted"] == report["closures"]["accepted"]
    assert len(data["true_poses"]) == len(data["estimated_poses"]) == STEPS + 1


@pytest.mark.parametrize("kind", ["velocity", "frontier"])
def test_estimates_stay_beside_the_true_robots_at_the_start_after_merges_and_within_long_actions(tmp_path, kind):
    env = twc_env.parallel_env(map="gen:office:100:1", robots=2, max_cycles=270, config={"action.kind": kind})
    observations, infos = env.reset(seed=4)
    trace, merged = twc_env.EpisodeTrace(env, period_s=20.0), 0
    while env.agents:
        if kind == "frontier":
            actions = {agent: int(np.argmax(infos[agent]["action_mask"])) for agent in env.agents}
        else:
            ranges_m = [10 * observations[agent]["lidar"] for agent in env.agents]
            actions = {a: wander_by_scan(ranges_m[k], env.episode.steps, 3 * k) for k, a in enumerate(env.agents)}
        observations, rewards, _, _, infos = env.step(actions)
        trace.note(rewards)
        merged += bool(env.belief("robot_0").teammates)
    trace.write(tmp_path / "trace.npz")
    drawn = np.load(tmp_path / "trace.npz")
    away_m = np.linalg.norm((drawn["estimated_poses"] - drawn["true_poses"])[..., :2], axis=-1)
    assert merged and away_m.max() < 0.1


def test_the_page_shows_walls_and_estimates_that_ever_lay_beside_the_building_but_none_far_away(run, tmp_path):
    shutil.copy(run / "report.json", tmp_path)
    with np.load(run / "trace.npz") as data:
        trace = dict(data)
    x0, y0, x1, y1 = data_of(write_page(run, run / "page.html"))["bounds_m"]
    ends_m = trace["walls_m"].reshape(-1, 2)
    assert np.allclose([x0, y0, x1, y1], [*ends_m.min(axis=0), *ends_m.max(axis=0)], atol=0.1)

    def bounds(by_m, of_robot_m):
        moments, poses = json.loads(str(trace["moments"])), trace["estimated_poses"].copy()
        moments[1]["layers"][0]["pose_building_map"][0] += by_m
        poses[3, 0, 1] += of_robot_m
        np.savez(
            tmp_path / "trace.npz", **{**trace, "moments": np.array(json.dumps(moments)), "estimated_poses": poses}
        )
        return data_of(write_page(tmp_path, tmp_path / "page.html"))["bounds_m"]

    wide = bounds(x1 - x0, -(y1 - y0))
    assert wide[0] == x0 and wide[3] == y1 and x1 + 1 < wide[2] <= x1 + 0.31 * (x1 - x0) and wide[1] < y0 - 1
    assert np.allclose(bounds(900.0, 0.0), [x0, y0, x1 + 0.3 * (x1 - x0), y1], atol=0.1)


def test_long_episodes_keep_a_bounded_number_of_moments(monkeypatch):
    monkeypatch.setattr("twc_env.exploration.trace.MOMENTS_MAX", 4)
    _, trace, _ = play(watched=True)
    assert len(trace._moments) <= 5


def test_the_command_writes_the_page_into_the_run_folder(run, capsys):
    assert main(["replay", str(run), "--html"]) == 0
    assert (run / "replay.html").stat().st_size > 10_000
    assert "replay.html" in capsys.readouterr().out


def test_the_error_of_an_incomplete_trace_or_report_names_it(run, tmp_path):
    with np.load(run / "trace.npz") as data:
        trace = {key: data[key] for key in data.files}
    for missing in TRACE_KEYS:
        np.savez(tmp_path / "trace.npz", **{key: value for key, value in trace.items() if key != missing})
        with pytest.raises(DataError, match=f"lacks {missing}"):
            write_page(tmp_path, tmp_path / "page.html")
    shutil.copy(run / "trace.npz", tmp_path)
    for report in ("[]", "{}", '{"map": "twin-01"}'):
        (tmp_path / "report.json").write_text(report)
        with pytest.raises(DataError, match="not a report with config_digest, map, seed, version"):
            write_page(tmp_path, tmp_path / "page.html")


@pytest.mark.parametrize("name", ["trace.npz", "report.json"])
def test_the_error_of_a_missing_or_corrupt_file_names_it(run, tmp_path, name):
    for other in ("trace.npz", "report.json"):
        shutil.copy(run / other, tmp_path / other)
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:40])
    with pytest.raises(DataError, match=name):
        write_page(tmp_path, tmp_path / "page.html")
    (tmp_path / name).unlink()
    with pytest.raises(DataError, match=name):
        write_page(tmp_path, tmp_path / "page.html")


@pytest.mark.parametrize(
    "change",
    [
        {"moments": np.array("[")},
        {"moments": np.array("[]")},
        {"moments": np.array("3")},
        {"map_ends": np.zeros(1, np.int64)},
        {"walls_m": np.zeros(3)},
        {"sign_texts": np.array("{")},
        {"config": np.array("{")},
        {"true_poses": np.full((3, 2, 3), np.nan)},
        {"signal_dbm": np.array("loud")},
    ],
    ids=lambda change: "-".join(change),
)
def test_the_error_of_an_inconsistent_trace_names_it_in_one_line(run, tmp_path, change):
    with np.load(run / "trace.npz") as data:
        np.savez(tmp_path / "trace.npz", **{**data, **change})
    shutil.copy(run / "report.json", tmp_path)
    with pytest.raises(DataError, match=r"trace\.npz") as error:
        write_page(tmp_path, tmp_path / "page.html")
    assert "\n" not in str(error.value) and not (tmp_path / "page.html").exists()


def with_odd_names(run, folder):
    """A copy of a run with markup in its names, which would change the page if it were not escaped."""
    names = ["<!-- <script>", "</script><script>alert(1)</script>", "__TITLE__", "&lt;", "\u2028\\n"]
    with np.load(run / "trace.npz") as data:
        np.savez(folder / "trace.npz", **{**data, "sign_texts": np.array(json.dumps(names))})
    report = json.loads((run / "report.json").read_text())
    (folder / "report.json").write_text(json.dumps({**report, "map": "__DATA__ <b>.json", "agent": "<i>"}))
    return names


def test_names_are_escaped_in_the_page(run, tmp_path):
    names = with_odd_names(run, tmp_path)
    plain, odd = write_page(run, tmp_path / "plain.html"), write_page(tmp_path, tmp_path / "odd.html")
    assert data_of(odd)["sign_texts"] == names
    tags = [re.findall(r"<[!/]?[a-z-]*", page.read_text(encoding="utf-8")) for page in (plain, odd)]
    assert tags[0] == tags[1]
    assert "<title>&lt;i&gt; on __DATA__ &lt;b&gt;.json" in odd.read_text(encoding="utf-8")


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_a_browser_loads_and_plays_the_page_and_shows_the_figures_of_the_report(run, browser):
    from selenium.webdriver.support.ui import WebDriverWait

    wait = WebDriverWait(browser, 30)
    browser.get(write_page(run, run / "page.html").as_uri())
    wait.until(lambda b: b.find_element("tag name", "body").get_attribute("data-ready") == "yes")
    picture = "return Array.from(document.getElementById('stage').getContext('2d').getImageData(0, 0, 900, 400).data)"
    assert f"step {STEPS} of {STEPS}" in browser.find_element("id", "time").text  # the page opens at the end
    before = np.array(browser.execute_script(picture))
    assert before.std() > 5.0  # something is drawn

    browser.execute_script(
        "const s = document.getElementById('slider'); s.value = 100; s.dispatchEvent(new Event('input'))"
    )
    assert "step 100" in browser.find_element("id", "time").text
    assert not np.array_equal(before, browser.execute_script(picture))

    browser.find_element("id", "play").click()
    wait.until(lambda b: f"step {STEPS} of {STEPS}" in b.find_element("id", "time").text)
    for layer in browser.find_elements("css selector", "[data-layer]"):
        layer.click()

    report = json.loads((run / "report.json").read_text())
    for key in ("team_ate_m", "coverage_correct", "merged_robots", "bytes_sent", "path_length_m"):
        row = browser.find_element("css selector", f"#figures [data-key='{key}']")
        assert json.loads(row.get_attribute("data-value")) == report[key]
    shown = browser.find_element("id", "figures").text
    assert f"team ATE\n{report['team_ate_m']:.3f} m" in shown
    assert f"floor mapped correctly\n{report['coverage_correct']:.1%}" in shown
    assert "odometry-only figures know the true relative starts" in browser.find_element("id", "remark").text
    errors = [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
    assert errors == []


INKS = """
const c = document.querySelector(".curve canvas"), g = c.getContext("2d");
const drawn = (x, y, w, h) => g.getImageData(x, y, w, h).data.filter((v, k) => k % 4 === 3 && v > 100).length;
return [drawn(0, 0, LEFT_PX - 3, c.height), drawn(0, c.height - BOTTOM_PX + 1, c.width, BOTTOM_PX - 1)];
"""
"""Drawn pixels left of a curve and below it."""


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_odometry_alone_is_a_layer_that_is_off_at_first(run, tmp_path, browser):
    page = write_page(run, run / "page.html")
    odometry = play(watched=False)[0].result().odometry_poses
    assert np.allclose(data_of(page)["odometry_m"], odometry[..., :2], atol=1e-3)

    browser.get(page.as_uri())
    box = browser.find_element("css selector", "[data-layer=odometry]")
    picture = "return Array.from(stage.getContext('2d').getImageData(0, 0, stage.width, stage.height).data)"
    without = browser.execute_script(picture)
    assert not box.is_selected()
    box.click()
    assert browser.execute_script(picture) != without
    shutil.copy(run / "report.json", tmp_path)
    with np.load(run / "trace.npz") as trace:  # as written by versions before
        np.savez(tmp_path / "trace.npz", **{key: trace[key] for key in trace.files if key != "odometry_poses"})
    browser.get(write_page(tmp_path, tmp_path / "page.html").as_uri())
    assert not browser.find_elements("css selector", "[data-layer=odometry]")
    assert len(browser.find_elements("css selector", "[data-layer]")) == 9


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(("width", "height"), [(1300, 900), (390, 800)], ids=["desktop", "phone"])
def test_the_page_is_readable_light_and_dark_on_a_desktop_and_a_phone(run, browser, scheme, width, height):
    from selenium.webdriver.support.ui import WebDriverWait

    with screen(browser, scheme, (width, height)) as script:
        browser.get(write_page(run, run / "page.html").as_uri())
        WebDriverWait(browser, 30).until(lambda b: b.find_element("tag name", "body").get_attribute("data-ready"))
        contrasts = script(CONTRASTS)
        assert len(contrasts) > 30
        assert [(text, round(ratio, 2)) for text, ratio in contrasts if ratio < 4.5] == []
        light = script("return getComputedStyle(document.body).backgroundColor")
        assert (sum(map(int, re.findall(r"\d+", light)[:3])) > 384) == (scheme == "light")
        assert script("return document.documentElement.scrollWidth") <= width  # nothing sticks out at the side
        boxes = script("return [...document.querySelectorAll('.card')].map(e => e.getBoundingClientRect().toJSON())")
        assert all(box["left"] >= 0 and box["right"] <= width for box in boxes)
        assert (boxes[1]["top"] >= boxes[0]["bottom"]) == (width < 900)  # a phone has one column
        inks = script(INKS)
        assert min(inks) > 20  # numbers at both axes


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_a_browser_shows_names_that_contain_markup(run, tmp_path, browser):
    from selenium.webdriver.support.ui import WebDriverWait

    with_odd_names(run, tmp_path)
    browser.get(write_page(tmp_path, tmp_path / "page.html").as_uri())
    WebDriverWait(browser, 30).until(lambda b: b.find_element("tag name", "body").get_attribute("data-ready") == "yes")
    assert browser.find_element("tag name", "h1").text.startswith("<i> on __DATA__ <b>.json")


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_the_page_draws_the_walls_that_pictures_and_films_draw(run, browser):
    page = write_page(run, run / "page.html")
    browser.get(page.as_uri())
    layers = [layer for moment in data_of(page)["moments"] for layer in moment["layers"]]
    kinds = [np.frombuffer(zlib.decompress(base64.b64decode(layer["cells"])), np.uint8) for layer in layers]
    grids = [kind.reshape(layer["shape"]) for kind, layer in zip(kinds, layers, strict=True)]
    for grid in (grids[0], grids[-1], np.random.default_rng(0).choice(np.array([0, 1, 2], np.uint8), (30, 40))):
        asked = "return wallStrokes(arguments[0], arguments[1], D.strokes)"
        drawn = np.array(browser.execute_script(asked, grid.ravel().tolist(), grid.shape))
        assert np.allclose(drawn, wall_strokes(np.where(grid == WALL, 1, np.where(grid == FREE, -1, 0))), atol=1e-9)


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_texts_of_signs_at_the_edges_stay_inside_the_picture(run, browser):
    browser.get(write_page(run, run / "page.html").as_uri())
    width, height = browser.execute_script("return [stage.width, stage.height]")
    for u, v in ((0, 0), (width, 0), (0, height), (width, height), (width / 2, height / 2)):
        left, top, right, bottom = browser.execute_script(f"return textBox({u}, {v}, 90)")
        assert 0 <= left < right <= width and 0 <= top < bottom <= height
        assert not (left <= u <= right and top <= v <= bottom)


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_numbers_of_robots_are_inside_the_picture_and_on_no_other_robot(run, browser):
    browser.get(write_page(run, run / "page.html").as_uri())
    x0, y0, x1, y1 = browser.execute_script("return D.bounds_m")
    width, height = browser.execute_script("return [stage.width, stage.height]")
    corner, beside = [x1 + 0.8, y1 + 0.8, 0.0], 0.9  # of the picture; and a place for the number of the first robot
    for first in ([x0, y0, 0.0], [(x0 + x1) / 2, (y0 + y1) / 2, 0.0], corner):
        second = [first[0] + beside, first[1] + beside, 0.0] if first != corner else [x0, y1 + 0.8, 0.0]
        places = browser.execute_script("return numberPlaces(arguments[0])", [first, second])
        robots = browser.execute_script("return arguments[0].map(p => [sx(p[0]), sy(p[1])])", [first, second])
        for u, v in places:
            assert 0 < u < width and 0 < v < height
            assert all(np.hypot(u - a, v - b) > 10 for a, b in robots)
        assert np.hypot(*np.subtract(*places)) > 14


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_axes_of_counts_have_whole_numbers_and_end_at_the_number_of_robots(run, browser):
    browser.get(write_page(run, run / "page.html").as_uri())
    ticks = {
        most: browser.execute_script("return ticksOf('closures_accepted', 0, arguments[0])", most) for most in (0, 3, 9)
    }
    assert ticks == {0: [0, 1], 3: [0, 2, 4], 9: [0, 5, 10]}
    assert browser.execute_script("return ticksOf('merged_robots', 0, 2)") == [0, 1, 2]
    merged = f"{data_of(run / 'page.html')['report']['merged_robots']} of 2"
    assert ["merged_robots", "robots in one map", merged] in data_of(run / "page.html")["figures"]


def test_the_recording_contains_every_step_and_the_figures_of_the_report(run, capsys):
    chunk = pytest.importorskip("rerun.chunk", reason="needs rerun-sdk (extra 'rerun')")
    assert main(["replay", str(run), "--rerun"]) == 0
    assert "replay.rrd" in capsys.readouterr().out
    reader = chunk.RrdReader(str(run / "replay.rrd"))
    assert [entry.application_id for entry in reader.recordings()] == ["twc_env"]
    store = reader.store()
    paths = set(store.schema().entity_paths())
    assert {"/building/walls", "/building/signs", "/team/maps/0", "/team/closures/accepted", "/report"} <= paths
    assert {f"/{who}/robot_{k}/place" for who in ("building", "team") for k in range(2)} <= paths
    summary = store.summary()
    assert f"/building/robot_1/place rows={STEPS + 1} " in summary
    assert "/figures/shares/coverage_correct" in summary


def test_rectangles_cover_each_known_cell_once():
    random = np.random.default_rng(0)
    kinds = random.choice(np.array([UNKNOWN, FREE, WALL], np.uint8), (30, 40), p=[0.2, 0.6, 0.2])
    kinds[10:20, 5:25] = FREE
    boxes, kind = rectangles(kinds)
    painted, times = np.zeros_like(kinds), np.zeros(kinds.shape, int)
    for (first, end, low, high), what in zip(boxes, kind, strict=True):
        painted[low:high, first:end] = what
        times[low:high, first:end] += 1
    assert np.array_equal(painted, kinds)
    assert times.max() == 1
    assert len(rectangles(np.full((50, 50), FREE, np.uint8))[0]) == 1
    assert len(rectangles(np.zeros((5, 5), np.uint8))[0]) == 0


def test_without_rerun_the_error_names_the_extra(run, tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"twc_env\[rerun\]"):
        write_rerun(run, tmp_path / "x.rrd")


def test_the_error_of_rerun_names_a_corrupt_run_or_an_unwritable_path(run, tmp_path):
    pytest.importorskip("rerun", reason="needs rerun-sdk (extra 'rerun')")
    shutil.copy(run / "report.json", tmp_path)
    with pytest.raises(DataError, match=r"trace\.npz"):
        write_rerun(tmp_path, tmp_path / "x.rrd")
    with np.load(run / "trace.npz") as data:
        np.savez(tmp_path / "trace.npz", **{**data, "map_ends": np.zeros(1, np.int64)})
    with pytest.raises(DataError, match="contradicts itself"):
        write_rerun(tmp_path, tmp_path / "x.rrd")
    with pytest.raises(DataError, match="--out FOLDER"):
        write_rerun(run, tmp_path / "report.json" / "x.rrd")


@pytest.mark.parametrize("what", ["--html", "--rerun"])
def test_missing_folders_are_created(what, run, tmp_path):
    if what == "--rerun":
        pytest.importorskip("rerun")
    folder = tmp_path / "new" / "deep"
    assert main(["replay", str(run), what, "--out", str(folder)]) == 0
    (path,) = folder.iterdir()
    assert path.stem == "replay" and path.stat().st_size > 10_000


@pytest.mark.parametrize(("what", "file"), [("--html", "replay.html"), ("--rerun", "replay.rrd")])
def test_the_option_that_once_named_a_file_says_where_it_is_now(what, file, run, tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["replay", str(run), what, str(tmp_path / "mine")])
    assert f"{what} takes no value now, the " in (error := capsys.readouterr().err) and error.count("\n") == 1
    assert f"is {file} in --out FOLDER" in error


def test_a_log_is_not_converted(tmp_path, refusal):
    (tmp_path / "a.log").write_text("")
    assert "--rerun converts a run folder" in refusal(main, ["replay", str(tmp_path / "a.log"), "--rerun"])


@pytest.mark.parametrize("what", ["--html", "--rerun"])
def test_the_error_of_a_missing_run_folder_names_it(what, tmp_path, capsys):
    assert main(["replay", str(tmp_path / "gone"), what]) == 2
    assert f"there is no run folder {tmp_path / 'gone'}: " in capsys.readouterr().err
    assert main(["replay", str(tmp_path / "gone")]) == 2
    assert f"there is no run folder or log {tmp_path / 'gone'}: " in capsys.readouterr().err
