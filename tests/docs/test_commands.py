"""Every command of twc-env that a document or a notebook shows is one that twc-env accepts."""

import argparse
import json
import re
import shlex
from pathlib import Path

import pytest

from twc_env.__main__ import COMMANDS, _parser

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    str(p.relative_to(ROOT)) for pattern in ("*.md", "docs/**/*.md", "maps/*.md") for p in ROOT.glob(pattern)
)
PAGES.remove("CHANGELOG.md")  # it also has commands of earlier versions
VERB = "|".join(COMMANDS)


def shown_in(text: str) -> list[list[str]]:
    """The words of all commands in the code blocks of a page."""
    found = []
    for block in re.findall(r"^```\w*\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE):
        lines = re.sub(r"\$\(.*?\)", "validation/0000", block.replace("\\\n", " ")).splitlines()
        for part in (part for line in lines for part in line.split("&&")):
            _, name, words = part.partition("twc-env ")
            if name:
                found.append(shlex.split(words.split(" > ")[0], comments=True))
    return found


def mentioned_in(text: str) -> list[list[str]]:
    """The words of all commands in the running text: with or without `twc-env`, and often only their beginning."""
    prose = re.sub(r"^```\w*\n(.*?)^```", "", text, flags=re.DOTALL | re.MULTILINE)
    codes = [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", prose)]
    own = [re.sub(r"^twc-env ", "", code) for code in codes if re.match(rf"twc-env |({VERB}) ", code)]
    return [code.split(" > ")[0].replace("...", "").split() for code in own]


def check_mentioned(words: list[str]) -> None:
    """Names of commands and options exist; values are not looked at, and words in capitals stand for any."""
    parser = _parser()
    for word in words:
        below = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
        if word.startswith("-"):
            assert word.partition("=")[0] in parser._option_string_actions, f"{parser.prog} has no option {word}"
        elif below and not word.isupper():
            assert word in below[0].choices, f"{parser.prog} has no command {word}"
            parser = below[0].choices[word]


@pytest.mark.parametrize("page", PAGES)
def test_every_command_in_a_code_block_can_be_parsed(page):
    for words in shown_in((ROOT / page).read_text()):
        try:
            _parser().parse_args(words)
        except SystemExit as error:
            assert error.code == 0, f"{page}: twc-env {' '.join(words)}"


@pytest.mark.parametrize("page", PAGES)
def test_every_command_in_running_text_exists_with_its_options(page):
    for words in mentioned_in((ROOT / page).read_text()):
        check_mentioned(words)


@pytest.mark.parametrize("path", sorted(ROOT.glob("notebooks/*.ipynb")), ids=lambda path: path.name)
def test_every_command_in_a_notebook_exists_with_its_options(path):
    for cell in json.loads(path.read_text())["cells"]:
        if cell["cell_type"] == "markdown":
            for words in mentioned_in("".join(cell["source"])):
                check_mentioned(words)


def test_the_pages_show_all_commands():
    text = "\n".join((ROOT / page).read_text() for page in PAGES)
    assert len(shown_in(text)) > 40 and len(mentioned_in(text)) > 30
    assert {words[0] for words in shown_in(text) + mentioned_in(text)} >= set(COMMANDS)


def test_no_text_names_a_command_of_an_earlier_version():
    sources = [p for room in ("twc_env", "agents", "training", "notebooks") for p in (ROOT / room).rglob("*")]
    for path in [*sources, *(ROOT / page for page in PAGES), ROOT / "Makefile"]:
        if path.suffix in (".py", ".md", ".ipynb", "") and path.is_file():
            assert not re.search(r"-m\s+(agents|training)\b|`agents [a-z]", path.read_text()), path
