"""Numbers in the texts are those of the files that the named commands wrote (docs/data)."""

import json
import re
from pathlib import Path

import pytest

from twc_env.reproduce.twc import twc_table1

DOCS = Path(__file__).parents[2] / "docs"
TUTORIALS = ("sb3", "maskable_ppo", "torchrl", "one_file", "rllib", "benchmarl")


def read(name: str):
    return json.loads((DOCS / "data" / f"{name}.json").read_text())


def row(name: str, **wanted) -> dict:
    (found,) = (r for r in read(name) if all(r[key] == value for key, value in wanted.items()))
    return found


def table2(method: str, backend: str) -> dict:
    return row("twc-table2", method=method, backend=backend)


def sfw(method: str) -> dict:
    return row("sfw-table1", method=method)


def radio(method: str) -> dict:
    return row("radio-table1", method=method)


def carried(figure: str) -> dict:
    return read("carried")["gen:office:800:7"]["figures"][figure]


def gaps(method: str, count: int) -> str:
    """Deviations of a method from the published Table I, as its command prints them: of all, on #01, on #02."""
    lines = twc_table1.remarks(read("results/twc-table1"))
    (line,) = (line for line in lines if line.startswith(f"{method} against the paper, all pairs: "))
    return " ".join(re.findall(r"(?:error|#01|#02) ([\d.]+)", line)[:count])


def least_recall() -> float:
    """Recall of `fused` at precision 1.00 [%], of both scenes and sign sets."""
    return min(
        r["recall_at_full_precision"]
        for r in read("results/twc-table1")
        if r["method"] in ("fused", "fused departments")
    )


def lead(kind: str) -> str:
    """How far `information-gain` is ahead of the shipped policy."""
    return f"{-row('results/transfer', kind=kind, team='information-gain')['lead']:.3f}"


def scanned(dataset: str, quantity: str, where: str = "simulated") -> float:
    """A figure of `lidar-model`."""
    return row("results/lidar-model", dataset=dataset, quantity=quantity)[where]


def ideal_mm() -> str:
    """Least and greatest residual of ideal scanners in four logs, and that of freiburg-101."""
    found = {
        r["dataset"]: 1e3 * r["simulated"] for r in read("results/lidar-model") if r["quantity"] == "residual, ideal"
    }
    last = found.pop("freiburg-101")
    return f"{min(found.values()):.0f} {max(found.values()):.0f} {last:.0f}"


def too_much() -> str:
    """By how much the simulated share of points off the map is too great in the two Freiburg logs [%]."""
    name = "off the map of a run"
    return " ".join(
        f"{100 * (scanned(log, name) - scanned(log, name, 'real')):.1f}" for log in ("freiburg-079", "freiburg-101")
    )


def noisy(figure: str, noise: str = "assumed", sizes: tuple[float, ...] = (0.0, 0.25, 1.0, 2.0)) -> list[float]:
    """A figure of freiburg-101 driven again with Intel's odometry errors times each size [m]."""
    return [row("odometry-noise", log="freiburg-101", size=size, noise=noise)[figure] for size in sizes]


def listed(values: list[float]) -> str:
    return " ".join(f"{value:.3f}" for value in values)


def covered(model: str) -> float:
    return read("results/es")[0]["mean_coverage"][model]


def leads() -> str:
    """Of the policies that `es` trained: in all buildings of Entrance, and the least and greatest in Radio."""
    radio = [r["lead"] for r in read("results/es-seeds") if r["task"] == "twc/ExploreRadio-v1"]
    return listed([read("results/es-entrance")[0]["lead"], min(radio), max(radio)])


def behind() -> str:
    """How far the shipped policy is behind in Quick."""
    return listed([-read("results/es")[0]["lead"]])


def most_merges() -> str:
    """Most wrong merges of a training seed in Radio, and those of the best scripted team."""
    radio = [r for r in read("results/es-seeds") if r["task"] == "twc/ExploreRadio-v1"]
    most = max(radio, key=lambda r: r["wrong_merges"])
    return f"{most['wrong_merges']} {most['wrong_merges_of_best']}"


def waiting(name: str) -> str:
    """Number of closures that wait for others, of a run that says so."""
    return re.search(r"(\d+) closures between them wait", " ".join(read(name)["lacked"]))[1]


NUMBERS = [
    ("index.md", "After {} steps", lambda: str(read("demo")["steps"])),
    ("index.md", "{} s of simulated time", lambda: f"{read('demo')['sim_time_s']:.0f}"),
    ("index.md", "one map of\n{} % of the floor", lambda: f"{100 * read('demo')['coverage_correct']:.1f}"),
    ("index.md", "trajectories are off by {} m", lambda: f"{read('demo')['team_ate_m']:.3f}"),
    ("index.md", "would be by {} m with odometry", lambda: f"{read('demo')['odometry_ate_m']:.1f}"),
    (
        "explained/twc_slam.md",
        "{} % of its closures are right",
        lambda: f"{100 * table2('lidar', 'plain')['closure_precision']:.0f}",
    ),
    ("explained/twc_slam.md", "a trajectory error (ATE) of {} m", lambda: f"{table2('lidar', 'plain')['ate_m']:.1f}"),
    ("explained/twc_slam.md", "collapses as well ({} m)", lambda: f"{table2('text', 'plain')['ate_m']:.1f}"),
    (
        "explained/twc_slam.md",
        "{} % of the closures are",
        lambda: f"{100 * table2('twc', 'plain')['closure_precision']:.0f}",
    ),
    ("explained/twc_slam.md", "still bend it: {} m", lambda: f"{table2('twc', 'plain')['ate_m']:.2f}"),
    ("explained/twc_slam.md", "they do no harm: {} m", lambda: f"{table2('twc', 'ours')['ate_m']:.3f}"),
    ("explained/twc_slam.md", "heap of the laser has {} m", lambda: f"{table2('lidar', 'plain')['epe_m']:.2f}"),
    ("explained/twc_slam.md", "readable map of `twc` {} m", lambda: f"{table2('twc', 'plain')['epe_m']:.2f}"),
    ("explained/k_visibility.md", "counts the walls of {} %", lambda: f"{100 * sfw('paper')['k_accuracy']:.1f}"),
    ("explained/k_visibility.md", "(the paper: {} %)", lambda: f"{100 * sfw('paper')['paper_k_accuracy']:.1f}"),
    ("explained/k_visibility.md", "true one with an IoU of {}", lambda: f"{sfw('paper')['iou_free']:.3f}"),
    ("explained/k_visibility.md", "(the paper: {}).", lambda: f"{sfw('paper')['paper_iou']:.3f}"),
    ("explained/k_visibility.md", "Ours counts {} % rightly", lambda: f"{100 * sfw('ours')['k_accuracy']:.1f}"),
    ("explained/k_visibility.md", "has an IoU of {} for floor", lambda: f"{sfw('ours')['iou_free']:.3f}"),
    ("explained/radio_slam.md", "odometry is off by {} m", lambda: f"{radio('odometry')['error_mean_m']:.1f}"),
    ("explained/radio_slam.md", "radio SLAM by {} m", lambda: f"{radio('wifi')['error_mean_m']:.2f}"),
    ("first_hours/lecturer.md", "hardly changes ({} and", lambda: f"{read('demo')['team_ate_m']:.3f}"),
    ("first_hours/lecturer.md", "and {} m), odometry leaves", lambda: f"{read('drift')['team_ate_m']:.3f}"),
    ("first_hours/lecturer.md", "leaves the building ({} and", lambda: f"{read('demo')['odometry_ate_m']:.1f}"),
    ("first_hours/lecturer.md", "4.4 and {} m).", lambda: f"{read('drift')['odometry_ate_m']:.1f}"),
    ("first_hours/lecturer.md", "an error of {} m where", lambda: f"{read('gullible')['team_ate_m']:.0f}"),
    ("first_hours/lecturer.md", "{} % of the floor pass", lambda: f"{100 * read('gullible')['coverage_correct']:.1f}"),
    ("first_hours/lecturer.md", "the walls {} % agree", lambda: f"{100 * read('gullible')['wall_iou']:.0f}"),
    ("first_hours/lecturer.md", "would have had {} m", lambda: f"{read('gullible')['odometry_ate_m']:.0f}"),
    ("first_hours/researcher.md", "{} closures that wait", lambda: waiting("blind")),
    (
        "results.md",
        "none is merged wrongly, and the mean ATE is {} m",
        lambda: f"{carried('team_ate_m')['mean']:.3f}" * (carried("wrong_merges")["max"] == 0),
    ),
    (
        "results.md",
        "`twc` differs from the published values by {} percentage points (#01 {}, #02 {})",
        lambda: gaps("twc departments", 3),
    ),
    ("results.md", "text alone by {} and WiFi", lambda: gaps("text departments", 1)),
    ("results.md", "and WiFi alone by {}.", lambda: gaps("wifi departments", 1)),
    ("results.md", "columns contradict each other by {} points", lambda: f"{twc_table1.contradiction() / 2:.1f}"),
    ("results.md", "original signs of the map, `twc` differs by {} points", lambda: gaps("twc", 1)),
    (
        "learning.md",
        "leads by {} of the floor mapped over time; in 100 of `ExploreRadio-v1` each of three training seeds does, "
        "by {} to {};",
        leads,
    ),
    ("learning.md", "more wrong merges than that team, {} against {}.", most_merges),
    ("learning.md", "In Quick itself the shipped one is {} behind", behind),
    (
        "learning.md",
        "in all hundred the lead of seed 0 is {}, not {},",
        lambda: listed([read("results/es-entrance")[0]["lead"], read("results/es-seeds")[0]["lead"]]),
    ),
    ("results.md", "by {} of the floor mapped over time in Entrance, by {} to {} in Radio", leads),
    ("results.md", "level with that team in Office, and {} behind it in Quick", behind),
    (
        "learning.md",
        "leads `information-gain` by {}.",
        lambda: f"{covered('informed') - covered('information-gain'):.3f}",
    ),
    ("learning.md", "on real floors, and {} behind it with eight", lambda: lead("8 robots")),
    *(
        ("results.md", sentence, lambda figure=figure, noise=noise: listed(noisy(figure, noise)))
        for figure, noise, sentence in (
            ("ate_m", "assumed", "the path ends {}, {}, {} and {} m from the corrected one"),
            ("ate_std_m", "assumed", "over the three draws {}, {}, {} and {})"),
            ("ate_m", "from log", "by what the log shows it ends {}, {}, {} and {} m off"),
            ("ate_std_m", "from log", "deviations by what the log shows {}, {}, {} and {})"),
        )
    ),
    *(
        (
            page,
            "perfect odometry ends {} m worse than",
            lambda: listed([noisy("ate_m", "from log")[0] - noisy("ate_m")[0]]),
        )
        for page in ("results.md", "trust.md")
    ),
    ("trust.md", "the twins, recall .{} at", lambda: f"{least_recall():.0f}"),
    ("world.md", "residuals, {} to {} mm ({} mm in `freiburg-101`)", ideal_mm),
    (
        "world.md",
        "The rest, {} and {} %, the simulation",
        lambda: " ".join(f"{100 * scanned(log, 'off the map of a run', 'real'):.1f}" for log in ("aces", "orebro")),
    ),
    ("world.md", "has too much, by {} to {} %", too_much),
    ("world.md", "map bent by {} m in", lambda: f"{row('results/lidar-effects', effect='lds-01')['ate_max_m']:.1f}"),
    (
        "structure_from_wifi.md",
        "k accuracy of {}, {}, {}, {}, {} and {} in E1 to E6",
        lambda: " ".join(
            f"{r['k_accuracy']:.3f}" for r in read("results/sfw-table1") if r["method"] == "paper, distance"
        ),
    ),
]
"""Page, the words around the numbers, and the numbers as the file has them."""


@pytest.mark.parametrize(("page", "words", "value"), NUMBERS, ids=[f"{page} {words}" for page, words, _ in NUMBERS])
def test_a_number_is_that_of_its_file(page, words, value):
    text = " ".join((DOCS / page).read_text().split())
    found = re.finditer(re.escape(" ".join(words.split())).replace(r"\{\}", r"(\d[\d.,]*\d|\d)"), text)
    assert [" ".join(match.groups()) for match in found] == [value()]


@pytest.mark.parametrize("name", [name for name in TUTORIALS if (DOCS / "tutorials" / f"{name}.md").exists()])
def test_the_means_of_a_tutorial_are_those_of_its_curve_which_rises(name):
    curve = read(f"tutorial-{name}")
    text = " ".join((DOCS / "tutorials" / f"{name}.md").read_text().split())
    half = len(curve["means"]) // 2
    first, later = curve["means"][0], sum(curve["means"][half:]) / half
    assert f"In {curve['episodes']:,} episodes" in text and f"from {first:.2f} to {later:.2f}" in text
    error = sum(error**2 for error in curve["standard_errors"][half:]) ** 0.5 / half
    assert later - first > 2 * (curve["standard_errors"][0] + error)


def test_words_of_a_first_hour_are_those_of_its_run():
    assert read("blind")["merged_robots"] == 2 and any("cannot be trusted" in why for why in read("blind")["lacked"])
    assert read("gullible")["wrong_merges"] == 3


def test_every_number_that_the_readme_claims_stands_in_the_brief_table_of_the_results():
    readme = (DOCS.parent / "README.md").read_text()
    claims = re.search(r"^## Results.*?(?=^## )", readme, re.DOTALL | re.MULTILINE)[0]
    brief = re.search(r"^## In brief.*?(?=^## )", (DOCS / "results.md").read_text(), re.DOTALL | re.MULTILINE)[0]
    numbers = re.findall(r"\d[\d,]*\.?\d*(?<![.,])", re.sub(r"95 % interval", "", claims))
    assert len(numbers) >= 8
    assert [number for number in numbers if not re.search(rf"(?<![\d.,]){re.escape(number)}(?![\d])", brief)] == []


def test_no_graph_takes_twice_the_time_of_gtsam():
    assert max(r["of_gtsam"] for r in read("results/solver")) < 2


def test_words_about_scanners_are_those_of_their_table():
    table = read("results/lidar-effects")
    assert {r["effect"]: 5 - r["fully_merged"] for r in table if "fully_merged" in r and r["fully_merged"] < 4} == {
        "rolling 5 Hz, not undone": 5,
        "mid-360": 2,
    }
    assert not any(r.get("wrong_merges") for r in table)


def test_every_kept_file_is_checked(monkeypatch):
    used = {f"tutorial-{name}" for name in TUTORIALS}
    stored = read
    monkeypatch.setitem(globals(), "read", lambda name: used.add(name) or stored(name))
    for _, _, value in NUMBERS:
        value()
    assert {path.stem for path in (DOCS / "data").glob("*.json")} - used == set()
