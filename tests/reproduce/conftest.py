"""Ways to run a table: by its module, or by its command."""

import argparse
import json

import pytest

from twc_env.__main__ import main
from twc_env.reproduce.runner import Runner


@pytest.fixture(scope="session")
def parsed():
    """The options that a table makes of words."""

    def parse(table, *words: str) -> argparse.Namespace:
        parser = argparse.ArgumentParser()
        table.add_arguments(parser)
        return parser.parse_args(words)

    return parse


@pytest.fixture
def rows_of(parsed, tmp_path):
    """The rows that a table's module gives for words."""
    return lambda table, *words: table.rows(parsed(table, *words), Runner("table", tmp_path, {"words": words}))


@pytest.fixture
def written(tmp_path):
    """The rows that a command writes."""

    def run(name: str, *words: str) -> list[dict]:
        path = tmp_path / "rows.json"
        assert main(["reproduce", name, *words, "--json", str(path), "--cache", str(tmp_path / "cache")]) == 0
        return json.loads(path.read_text())

    return run
