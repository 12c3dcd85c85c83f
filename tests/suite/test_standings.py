"""Rows of a leaderboard from episodes whose figures are known, and the files that show them."""

import csv
import io
import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from tests.chromium import CONTRASTS, screen
from twc_env.config import EnvConfig
from twc_env.records.class_file import digest_of
from twc_env.suite import leaderboard, tables
from twc_env.suite.entries import Entry
from twc_env.suite.gaps import rows_of_models
from twc_env.suite.leaderboard import Origin, rows_as_json
from twc_env.suite.page import DEFINITIONS, page_of
from twc_env.suite.standings import ALL, THRESHOLDS, standings_of
from twc_env.suite.tables import COLUMNS

TASKS = ("twc/ExploreQuick-v1", "twc/ExploreOffice-v1")
LEVELS = {"random": 0.1, "mine": 0.4, "other": 0.3, "informed": 0.6}
"""Coverage of each team, constant over an episode of 100 s; in the second task half of it."""


TEXTS = {f"leaderboard.{ending}" for ending in ("json", "csv", "md", "tex", "html")}


def values_of(level: float, number: int, **changes) -> dict:
    return {
        "period_s": 1.0, "coverage": [level + 0.01 * number] * 50, "merged_s": 10.0 + number, "is_covered": False,
        "ate_m": 0.02 * (number + 1), "path_m": 100.0, "steps": 500, "sim_time_s": 50.0, "merged_robots": 3,
        "wrong_merges": number, "bytes_sent": 2_000_000, "collisions": 1,
        "stuck_share": 0.02, **changes,
    }  # fmt: skip


def played(teams=tuple(LEVELS), tasks=TASKS, buildings=3, change=lambda entry, values: values):
    config = EnvConfig(max_cycles=1000)
    entries = [Entry(task, config, team, n) for n in range(buildings) for task in tasks for team in teams]
    values = [
        change(e, values_of(LEVELS[e.team] / (1 + TASKS.index(e.task)), e.number)) for e in entries
    ]  # fmt: skip
    return entries, values, standings_of(entries, values)


def row(standings, task, team):
    return next(row for row in standings.rows if (row.task, row.team) == (task, team))


def test_scores_lie_between_the_random_and_the_informed_team_of_each_task():
    *_, standings = played()
    assert standings.is_normalised
    for task, spread in zip(TASKS, (0.5, 0.25), strict=True):
        assert row(standings, task, "random").score == pytest.approx(0.0)
        assert row(standings, task, "informed").score == pytest.approx(1.0)
        mine = row(standings, task, "mine")
        assert mine.score == pytest.approx(0.6)
        assert mine.score - mine.low == pytest.approx(0.01 / spread, rel=0.05), "the least of three means of three"
        assert mine.coverage_mean == pytest.approx((0.4 if task == TASKS[0] else 0.2) + 0.01)
    assert row(standings, ALL, "mine").score == pytest.approx(0.6)
    assert [r.team for r in standings.rows_of(TASKS[0])] == ["informed", "mine", "other", "random"]


def test_the_best_other_team_is_no_reference():
    *_, standings = played()
    found = {team: row(standings, TASKS[0], team) for team in LEVELS}
    assert {team: r.improvement_over for team, r in found.items()} == {
        "mine": "other", "other": "mine", "random": "mine", "informed": "mine"
    }  # fmt: skip
    assert {team: r.improvement for team, r in found.items()} == {
        "mine": 1.0, "other": 0.0, "random": 0.0, "informed": 1.0
    }  # fmt: skip


def test_an_oracle_that_lacks_a_piece_of_the_truth_is_marked_and_is_no_rival(monkeypatch):
    monkeypatch.setitem(LEVELS, "informed-plan-only", 0.55)
    entries, values, standings = played(tuple(LEVELS))
    assert row(standings, TASKS[0], "informed-plan-only").score == pytest.approx(0.9)
    assert row(standings, TASKS[0], "mine").improvement_over == "other"
    assert "informed-plan-only (oracle)" in tables.text_of(standings)
    assert rf"\textbf{{{row(standings, TASKS[0], 'mine').score:.3f}}}" in tables.latex_of(standings)
    assert rows_of_models(["mine"], entries, values)[0]["best_scripted"] == "other"


def test_figures_are_sums_means_and_medians_over_buildings():
    def change(entry, values):
        return {**values, "merged_s": None} if entry.number > 0 and entry.team == "mine" else values

    *_, standings = played(change=change)
    mine, other = row(standings, TASKS[0], "mine"), row(standings, TASKS[0], "other")
    assert (mine.wrong_merges, mine.collisions, mine.bytes_sent) == (3, 1.0, 2e6)
    assert mine.ate_m == pytest.approx(0.04)
    assert mine.merged_s == math.inf and other.merged_s == 11.0
    assert mine.to_50_s == math.inf and row(standings, TASKS[0], "informed").to_50_s == 1.0
    assert row(standings, ALL, "mine").wrong_merges == 6 and row(standings, ALL, "mine").buildings == 6


def test_a_team_aware_of_slam_is_compared_with_its_blind_twin_building_by_building(monkeypatch):
    levels = {**LEVELS, "relay": 0.35, "minpos": 0.30, "rendezvous": 0.2}
    monkeypatch.setitem(globals(), "LEVELS", levels)

    def change(entry, values):  # buildings differ by more than the teams do
        harder = [level - 0.1 * entry.number for level in values["coverage"]]
        return {**values, "coverage": harder, "merged_s": None if entry.team == "minpos" else 10.0}

    *_, standings = played(("random", "relay", "minpos", "informed"), TASKS[:1], change=change)
    (twins,) = standings.twins
    assert (twins.team, twins.twin, twins.buildings) == ("relay", "minpos", 3)
    assert (twins.lead, twins.low, twins.high) == pytest.approx((0.05, 0.05, 0.05))
    assert (twins.merged_s, twins.twin_merged_s) == (10.0, math.inf)
    for text in (tables.text_of(standings), tables.markdown_of(standings, ""), page_of(standings, "t", "l", [])):
        assert tables.TWINS_TITLE in text and "relay - minpos" in text and "+0.050 to +0.050" in text
    assert standings.as_json()["twins"][0]["lead"] == pytest.approx(0.05)
    *_, standings = played(("random", "relay", "informed"), TASKS[:1])
    assert not standings.twins and tables.TWINS_TITLE not in tables.text_of(standings)


def test_without_an_informed_team_scores_are_the_area_itself_and_this_is_said():
    entries, _, standings = played(teams=("random", "mine"))
    assert not standings.is_normalised
    assert row(standings, TASKS[0], "mine").score == pytest.approx(0.41)
    assert {r["score_is"] for r in rows_as_json(standings)} == {"mean coverage"}
    assert "there is no team 'informed' in this version" in Origin("v1", "test", 3).lead(standings)
    assert entries[0].task == TASKS[0]


def test_an_informed_team_worse_than_random_scales_nothing():
    def change(entry, values):
        return {**values, "coverage": [0.01] * 50} if entry.team == "informed" else values

    *_, standings = played(change=change)
    assert not standings.is_normalised
    assert "did not beat the random one" in leaderboard.raw_remark(standings)


def test_one_building_has_no_interval_and_no_band():
    *_, standings = played(buildings=1)
    mine = row(standings, TASKS[0], "mine")
    assert math.isnan(mine.low) and tables.interval_of(mine) == "-"
    assert rows_as_json(standings)[0]["low"] != rows_as_json(standings)[0]["low"]  # nan, null in the file
    assert "nan" not in tables.text_of(standings) + tables.latex_of(standings)


def test_curves_are_means_over_buildings_up_to_the_budget():
    *_, standings = played()
    curve = standings.curves[TASKS[0]]["mine"]
    assert curve["time_s"] == [float(second) for second in range(1, 101)]
    assert curve["mean"] == pytest.approx([0.41] * 100), "an episode that ended keeps its last value"
    assert min(curve["low"]) >= 0.4 and max(curve["high"]) <= 0.42


def test_profiles_fall_from_all_episodes_to_none():
    *_, standings = played()
    profile = standings.profiles["mine"]
    assert all(
        low <= share <= high for low, share, high in zip(*(profile[k] for k in ("low", "share", "high")), strict=True)
    )
    mine = dict(zip(THRESHOLDS.tolist(), profile["share"], strict=True))
    assert mine[0.5] == 1.0 and mine[0.7] == 0.0 and 0.0 < mine[0.6] < 1.0


class Cells(HTMLParser):
    """Counts the parts of a page, and notes addresses in it."""

    def __init__(self):
        super().__init__()
        self.counts, self.addresses = {}, []

    def handle_starttag(self, tag, attributes):
        self.counts[tag] = self.counts.get(tag, 0) + 1
        self.addresses += [value for name, value in attributes if name in ("src", "href")]


def test_every_file_shows_the_same_rows_and_the_page_needs_no_other_file(tmp_path):
    pytest.importorskip("matplotlib", reason="pictures need the extra 'viz'")
    entries, _, standings = played()
    written = leaderboard.write_leaderboard(standings, Origin("v1", "test", 3), entries, tmp_path, ("png", None))
    assert {path.name for path in written} == {path.name for path in tmp_path.iterdir()}
    board = json.loads((tmp_path / "leaderboard.json").read_text())
    table = list(csv.DictReader(io.StringIO((tmp_path / "leaderboard.csv").read_text())))
    assert len(board["rows"]) == len(table) == 3 * 4
    assert [float(r["score"]) for r in table] == [r["score"] for r in board["rows"]]
    assert board["seeds"] == [0, 1, 2] and board["tasks"][TASKS[0]]["budget_s"] == 100.0
    markdown = (tmp_path / "leaderboard.md").read_text()
    assert markdown.count("| informed (oracle) | 1.000 |") == 3 and "24 episodes" in markdown
    latex = (tmp_path / "leaderboard.tex").read_text()
    assert latex.count(r"\\") == 5 and latex.count(r"\textbf{0.600}") == 3
    page = Cells()
    page.feed((tmp_path / "leaderboard.html").read_text())
    assert (page.counts["table"], page.counts["tr"], page.counts["img"]) == (3, 3 * 5, 2)
    assert all(address.startswith(("data:image/png;base64,", "#")) for address in page.addresses)
    assert not re.search(r"https?://(?!www\.w3\.org)", (tmp_path / "leaderboard.html").read_text())


def test_a_leaderboard_tells_which_version_of_a_file_played(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    entries, values, standings = played()
    (tmp_path / "mine.py").write_text("class Mine: pass\n")
    own = [replace(entry, team="mine.py:Mine") if entry.team == "mine" else entry for entry in entries]
    origin, digests = Origin("v1", "test", 3), {"mine.py:Mine": digest_of("mine.py:Mine")}
    assert origin.as_json(own)["agent_digests"] == digests and "agent_digests" not in origin.as_json(entries)
    lead = origin.lead(standings_of(own, values))
    assert lead == f"{origin.lead(standings)} Files of teams: mine.py:Mine {digests['mine.py:Mine']}."


def test_the_page_explains_every_column():
    shown = [long.partition(" [")[0] for long, _, _ in COLUMNS[3:]]  # after the team, its score and the interval
    own = [name for name in shown if not name.startswith(("one map after", "to "))]  # these are the times
    assert [name for name in own if not any(name in explained for explained in DEFINITIONS)] == []


def test_pictures_have_the_format_that_is_asked_for_and_none_of_an_earlier_run_is_left(tmp_path):
    pytest.importorskip("matplotlib", reason="pictures need the extra 'viz'")
    entries, _, standings = played()
    sizes = []
    for pictures, kinds in ((("pdf", None), ("png", "pdf")), (("png", 40), ("png",)), (None, ())):
        written = leaderboard.write_leaderboard(standings, Origin("v1", "test", 3), entries, tmp_path, pictures)
        drawn = {f"{name}.{kind}" for name in ("curves", "profiles") for kind in kinds}
        assert {path.name for path in tmp_path.iterdir()} == {path.name for path in written} == TEXTS | drawn
        assert (tmp_path / "leaderboard.html").read_text().count("<img") == len(drawn) // max(len(kinds), 1)
        sizes += [(tmp_path / "curves.png").stat().st_size] if drawn else []
    assert sizes[1] < sizes[0], "fewer dots per inch"


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [(1300, 900), (390, 800)], ids=["desktop", "phone"])
def test_the_page_is_readable_light_and_dark_on_a_desktop_and_a_phone_and_sorts(tmp_path, browser, scheme, size):
    _, _, standings = played()
    page = tmp_path / "leaderboard.html"
    page.write_text(page_of(standings, "Leaderboard", "lead", []), encoding="utf-8")
    with screen(browser, scheme, size) as script:
        browser.get(page.as_uri())
        assert [(text, ratio) for text, ratio in script(CONTRASTS) if ratio < 4.5] == []
        assert script("return document.documentElement.scrollWidth") <= size[0]
        names = "return [...document.querySelector('tbody').rows].map(row => row.cells[0].textContent)"
        best_first = script(names)
        assert best_first[0] == "informed (oracle)" and best_first[-1] == "random"
        assert all(script("return [...document.querySelectorAll('.axis text')].map(e => e.getBBox().width > 0)"))
        for _ in range(2):  # the second click turns the order around
            script("document.querySelectorAll('thead button')[1].click()")
        assert script(names) == best_first[::-1]


def test_names_of_teams_are_escaped_in_pages_and_in_latex(tmp_path):
    entries, values, _ = played(tasks=TASKS[:1])
    odd = [Entry(e.task, e.config, e.team.replace("mine", "<b>my_team&co.py:Mine"), e.number) for e in entries]
    standings = standings_of(odd, values)
    assert r"<b>my\_team\&co.py:Mine" in tables.latex_of(standings)
    assert "<b>" not in page_of(standings, "t", "l", [])


PAGE_PX = 680
"""Width of a picture on a page of the documentation."""


@pytest.mark.parametrize("tasks", [TASKS, TASKS[:1]], ids=["tasks", "task"])
def test_the_print_of_pictures_can_be_read_on_a_page(tmp_path, monkeypatch, tasks):
    pytest.importorskip("matplotlib", reason="pictures need the extra 'viz'")
    from matplotlib.text import Text

    from twc_env.pictures.style import style
    from twc_env.suite import pictures

    _, _, standings = played(tasks=tasks)
    figures = []
    monkeypatch.setattr(pictures, "save_figure", lambda figure, *_: figures.append(figure))
    with style():
        pictures.draw_curves(standings, tmp_path / "curves.png")
        pictures.draw_profiles(standings, tmp_path / "profiles.png")
        for figure in figures:
            figure.draw_without_rendering()
            scale = PAGE_PX / (72 * figure.get_size_inches()[0])
            sizes = {text.get_text(): scale * text.get_fontsize() for text in figure.findobj(Text) if text.get_text()}
            assert len(sizes) > 10 and min(sizes.values()) >= 9, sizes


def test_every_scripted_team_has_a_line_of_its_own_in_pictures():
    pytest.importorskip("matplotlib", reason="pictures need the extra 'viz'")
    from twc_env.agents.roster import TEAMS

    from twc_env.suite.pictures import _style

    teams = [*TEAMS, "learned", "mine.py:Mine"]
    assert len(teams) > 20 and len({_style(team, teams) for team in teams}) == len(teams)


@pytest.mark.parametrize("others", [1, 18])
def test_a_long_legend_leaves_the_panels_their_room(tmp_path, monkeypatch, others):
    pytest.importorskip("matplotlib", reason="pictures need the extra 'viz'")
    from twc_env.pictures.style import style
    from twc_env.suite import pictures

    _, _, standings = played(tasks=TASKS[:1])
    names = [f"team-{k}" for k in range(others)]
    for kept in (standings.profiles, *standings.curves.values()):
        kept.update(dict.fromkeys(names, next(iter(kept.values()))))
    figures = []
    monkeypatch.setattr(pictures, "save_figure", lambda figure, *_: figures.append(figure))
    standings = replace(standings, teams=(*standings.teams, *names))
    with style():
        pictures.draw_curves(standings, tmp_path / "curves.png")
        (figure,) = figures
        figure.draw_without_rendering()
        label = figure.axes[0].yaxis.label.get_window_extent()
    assert label.y0 >= 0.0 and label.y1 <= figure.bbox.height
