import os
import re
import subprocess
import sys
from dataclasses import fields, is_dataclass
from functools import reduce
from pathlib import Path

import pytest
from twc_env.agents.explore import explore
from twc_env.agents.roster import TEAMS

from twc_env import TASKS, EnvConfig
from twc_env.reproduce.runner import TABLES, table_module

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
PAGES = sorted(
    str(path.relative_to(ROOT)) for pattern in ("*.md", "docs/**/*.md", "maps/*.md") for path in ROOT.glob(pattern)
)


def example() -> str:
    blocks = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    return blocks[0]


def test_the_example_of_the_readme_has_ten_lines_at_most_and_runs(tmp_path):
    assert len([line for line in example().splitlines() if line.strip()]) <= 10
    done = subprocess.run([sys.executable, "-c", example()], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(r"9\d\.\d% mapped correctly, 3 robots in one frame\n", done.stdout)


@pytest.mark.parametrize("name", PAGES)
def test_lines_outside_tables_have_120_columns_at_most(name):
    text = re.sub(r"<!-- rows:.*?-->", "", (ROOT / name).read_text(), flags=re.DOTALL)  # forms of lines of tables
    lines = text.splitlines()
    assert [line for line in lines if len(line) > 120 and not line.startswith("|")] == []


@pytest.mark.parametrize("name", PAGES)
def test_links_lead_to_existing_files_and_headings(name):
    text = (ROOT / name).read_text()
    for target in re.findall(r"\]\(([^)]+)\)", text):
        if "://" in target:
            continue
        file, _, heading = target.partition("#")
        path = (ROOT / name).parent / file if file else ROOT / name
        assert path.exists(), target
        assert not heading or heading in headings(path.read_text()), target


def headings(text: str) -> set[str]:
    """Anchors of the headings of a text."""
    return {
        re.sub(r"[^\w -]", "", line.lower()).replace(" ", "-") for line in re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    }


def test_every_setting_named_in_a_document_exists():
    config = EnvConfig()
    sections = "|".join(field.name for field in fields(config) if is_dataclass(getattr(config, field.name)))
    for path in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]:
        for name in re.findall(rf"`((?:{sections})\.[a-z_0-9.]+)[`= ]", path.read_text()):
            folder, _, module = f"twc_env/{name.replace('.', '/')}".rpartition("/")
            is_code = (
                (ROOT / f"{folder}.py").exists()
                or (ROOT / folder / f"{module}.py").exists()
                or (ROOT / f"{folder}.py").exists()
            )
            is_setting = reduce(lambda at, part: getattr(at, part, None), name.split("."), config) is not None
            assert is_code or is_setting or name == "radio.preset", f"{path.name} names {name}"


def test_names_that_contributing_locates_in_files_are_there():
    text = (ROOT / "CONTRIBUTING.md").read_text()
    for file in re.findall(r"`([a-z_/]+/[a-z_0-9]*\.?[a-z]*)`", text):
        assert (ROOT / file).exists() or (ROOT / "twc_env" / file).exists(), file
    named = re.findall(r"`(\w+)`\s+\(`([\w/.]+\.py)`\)", text)
    assert len(named) >= 3
    for name, file in named:
        assert re.search(rf"^(class |def )?{name}\b", (ROOT / file).read_text(), re.MULTILINE), (name, file)


def test_the_readme_counts_tasks_and_teams_rightly():
    words = {"nine": 9, "ten": 10, "eleven": 11, "eighteen": 18, "nineteen": 19, "twenty": 20, "twenty-one": 21}
    tasks, teams = re.search(r"(\S+) tasks with held-out buildings, (\S+) scripted teams", README).groups()
    assert words[tasks] == sum(name.endswith("-v1") for name in TASKS)
    assert words[teams] == sum(not team.is_oracle for team in TEAMS.values())


def test_the_commands_of_the_readme_are_targets_of_the_makefile():
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE))
    named = set(re.findall(r"^make ([a-z]+)", README, flags=re.MULTILINE))
    assert named == {"demo", "test"}
    assert named <= targets


def test_the_docs_define_every_figure_of_a_report_and_no_other():
    report = explore(EnvConfig(map="twin-01", robots=2, max_cycles=5), "random", 0).report
    rows = re.findall(r"^\| (.+?) \|", (ROOT / "docs/figures.md").read_text(), flags=re.MULTILINE)
    defined = [row.strip("`") for row in rows if row != "key"]
    assert sorted(defined) == sorted({*report, *report["closures"]} - {"closures"})


def test_tables_from_real_data_name_their_files_which_exist():
    page = (ROOT / "docs" / "real_data.md").read_text()
    needy = [name for name in TABLES if hasattr(table_module(name), "data_folder")]
    assert [name for name in needy if f"`{name}`" not in page] == []
    if "TWC_DATA" not in os.environ:
        pytest.skip("TWC_DATA names the folder with real data; it is not set")
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    for folders, _, files in (row.partition(": ") for row in rows):
        for folder in re.findall(r"`([^`]+)`", folders):
            within = Path(os.environ["TWC_DATA"]) / folder
            for name in re.findall(r"`([^`]+\.[a-z0-9]+)`", files):
                assert name.startswith("_") or name[0] == "-" or list(within.glob(name)), f"{folder}{name}"
            assert within.exists() or list(Path(os.environ["TWC_DATA"]).glob(folder)), folder
