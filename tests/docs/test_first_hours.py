"""The commands of docs/first_hours run in their order, on smaller settings, and write what the pages name: in a fresh
clone, and with nothing but the wheel."""

import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.docs.test_commands import ROOT
from tests.forks import Forks
from tests.given_kernels import give_kernels
from tests.test_wheel import unpacked_wheel

PAGES = ("student", "researcher", "lecturer")
SMALLER = (
    (r"--steps 20000", "--steps 16 --max-cycles 20 --area 150 --workers 0"),
    (r"--steps \d{3,}", "--steps 12"),
    (r"--seeds 0-9", "--seeds 0"),
    (r"--buildings 5", "--buildings 2"),
    (r"generate office 400", "generate office 200"),
    (r"max_cycles=300", "max_cycles=30"),
)
"""What the test replaces in commands and programs."""
LOADED = "import numba, numpy, gymnasium, pettingzoo, twc_env.__main__, twc_env.exploration.environment"


def blocks(page: str) -> list[tuple[str, str]]:
    """(language, text) of the code blocks that a reader is to run."""
    text = (ROOT / "docs" / "first_hours" / f"{page}.md").read_text()
    return re.findall(r"^```(sh|python)\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)


def programs(page: str) -> list[str]:
    """Python programs that do what the blocks do."""
    found = []
    for language, text in blocks(page):
        for pattern, smaller in SMALLER:
            text = re.sub(pattern, smaller, text)
        if language == "python":
            found.append(text)
            continue
        for line in text.replace("\\\n", " ").splitlines():
            name, *words = shlex.split(line, comments=True)
            assert name == "twc-env"
            found.append(
                f"import sys, twc_env.__main__\nsys.argv[0] = 'twc-env'\nassert not twc_env.__main__.main({words})"
            )
    return found


def fresh_clone(folder: Path) -> Path:
    """A folder with the files that git keeps of this clone, as they are now, and nothing that was made beside them."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in (name for name in listed.split("\0") if name and (ROOT / name).is_file()):
        (folder / "clone" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, folder / "clone" / name)
    return folder / "clone"


@pytest.fixture(scope="module", params=["clone", "wheel"])
def forks(request, tmp_path_factory):
    if request.param == "clone" and not (ROOT / ".git").exists():
        pytest.skip("needs a clone")
    folder = tmp_path_factory.mktemp("forks")
    path = fresh_clone(folder) if request.param == "clone" else unpacked_wheel(folder)
    give_kernels(path, folder / "cache")
    settings = {"MPLBACKEND": "Agg", "XDG_CACHE_HOME": str(folder / "cache")}
    settings["PYTHONPATH"] = os.pathsep.join([str(path), os.environ.get("PYTHONPATH", "")])
    forks = Forks(f"import sys\nsys.path[0] = {str(path)!r}\n{LOADED}", folder, {**os.environ, **settings})
    status, said = forks.run("import twc_env.agents\nprint(twc_env.agents.__file__)", folder)
    assert status == 0 and Path(said.strip()).is_relative_to(path), said
    yield forks
    forks.close()


@pytest.mark.parametrize("page", PAGES)
def test_the_commands_of_a_first_hour_run_and_write_what_the_page_names(page, forks, tmp_path):
    if page == "student":
        pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")
    pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
    for program in programs(page):
        status, said = forks.run(program, tmp_path)
        assert status == 0, f"{program}\n{said}"
    text = (ROOT / "docs" / "first_hours" / f"{page}.md").read_text()
    named = set(re.findall(r"`(runs/[\w./-]+)`", text)) | set(
        re.findall(r"--out (\S+)", "".join(b for _, b in blocks(page)))
    )
    assert len(named) >= 2
    assert [name for name in named if not (tmp_path / name).exists()] == []


def test_every_smaller_setting_is_still_needed():
    shown = "".join(text for page in PAGES for _, text in blocks(page))
    assert [pattern for pattern, _ in SMALLER if not re.search(pattern, shown)] == []


def test_each_first_hour_begins_at_minute_zero_and_ends_within_the_hour():
    for page in PAGES:
        text = Path(ROOT / "docs" / "first_hours" / f"{page}.md").read_text()
        minutes = [int(minute) for minute in re.findall(r"^## Minute (\d+)", text, re.MULTILINE)]
        assert minutes[0] == 0 and minutes == sorted(set(minutes)) and minutes[-1] < 60
