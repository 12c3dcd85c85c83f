import re
import subprocess
import sys
from pathlib import Path

import pytest

from agents.explore import explore
from twc_env import EnvConfig

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def example() -> str:
    blocks = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    return blocks[0]


def test_the_example_of_the_readme_has_ten_lines_at_most_and_runs(tmp_path):
    assert len([line for line in example().splitlines() if line.strip()]) <= 10
    done = subprocess.run([sys.executable, "-c", example()], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(r"\d+% mapped rightly, [1-3] robots in one frame\n", done.stdout)


@pytest.mark.parametrize(
    "name", ["README.md", "CONTRIBUTING.md", "docs/figures.md", "docs/results.md", "maps/README.md"]
)
def test_links_to_files_lead_somewhere(name):
    text = (ROOT / name).read_text()
    targets = [target for target in re.findall(r"\]\(([^)#]+)", text) if "://" not in target]
    assert [target for target in targets if not (ROOT / name).parent.joinpath(target).exists()] == []


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
