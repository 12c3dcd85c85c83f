"""docs/papers.md and the code agree: items, modules, settings, tables and maps that they name exist."""

import argparse
import ast
import re
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from tests.test_architecture import MODULES, imports_of
from twc_env.config import EnvConfig, override
from twc_env.maps import map_names
from twc_env.reproduce.runner import TABLES, table_module

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "papers.md").read_text()
ITEMS = {
    f"{kind}{number}"
    for kind, first, last in re.findall(r"\b([TKRX])(\d+)(?:-[TKR](\d+))?", TEXT)
    for number in range(int(first), int(last or first) + 1)
}
QUOTED = set(re.findall(r"`([^`]+)`", TEXT))
ROWS = [line for line in TEXT.splitlines() if re.match(r"\| [TKR]\d", line)]


def test_every_item_named_in_the_code_is_in_the_document():
    named = {}
    for path in [*(ROOT / "twc_env").rglob("*.py"), *(ROOT / "agents").glob("*.py")]:
        for words in re.findall(r"papers\.md ((?:[TKRX]\d+[a-z]?(?:, |-| and )?)+)", path.read_text()):
            named |= dict.fromkeys(re.findall(r"[TKRX]\d+", words), path.name)
    assert len(named) > 20
    assert {item: where for item, where in named.items() if item not in ITEMS} == {}


@pytest.mark.parametrize("name", sorted(q for q in QUOTED if re.match(r"(slam|world|metrics|reproduce)(\.\w+)+$", q)))
def test_every_module_named_in_the_document_exists(name):
    package, _, module = name.replace(".", "/").rpartition("/")
    home = ROOT / "twc_env" / f"{package}.py"  # of a name in a module
    own = (ROOT / "twc_env" / package / f"{module}.py").exists() or (home.exists() and module in home.read_text())
    assert own or is_setting(name) or f'"{module}"' in (ROOT / "twc_env" / package / "__init__.py").read_text()


@pytest.mark.parametrize("name", sorted(q for q in QUOTED if " = " in q and "." in q))
def test_every_setting_in_the_document_is_valid(name):
    key, value = name.split(" = ")
    assert override(EnvConfig(), {key: value.strip('"')})


def test_tables_and_maps_named_in_the_document_exist():
    tables = {q.split()[0] for q in QUOTED if re.match(r"(twc|sfw|radio|real)-(?!env)[a-z]", q)}
    known = {*TABLES, *map_names()}
    assert {name for name in tables if name not in known} == set()


@pytest.mark.parametrize("row", ROWS)
def test_every_item_names_a_table_that_prints_its_figure_and_has_the_options_named(row):
    command = row.rstrip(" |").rpartition("|")[2].strip()
    if command == "none: not built":
        assert "omitted" in row
        return
    name, *options = command.strip("`").split()
    parser = argparse.ArgumentParser()
    table_module(name).add_arguments(parser)
    parser.parse_args(options)


@pytest.mark.parametrize("row", ROWS)
def test_the_commands_of_an_item_import_the_modules_that_the_item_names(row):
    tables = {name for quoted in re.findall(r"`([^`]+)`", row) if (name := quoted.split()[0]) in TABLES}
    quoted = re.findall(r"`((?:slam|metrics|world)(?:\.\w+)+)", row)
    named = {module for name in quoted if not is_setting(name) and (module := home_of(f"twc_env.{name}"))}
    assert named <= {module for name in tables for module in reached(table_module(name).__name__)} or not tables


def test_no_function_that_an_item_names_is_called_by_tests_alone():
    called: Counter[str] = Counter()
    for path in MODULES.values():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, (ast.Name, ast.Attribute)):
                called[node.id if isinstance(node, ast.Name) else node.attr] += 1
    functions = {
        name for q in QUOTED if re.fullmatch(r"[\w.]+", q) and (name := q.rpartition(".")[2]) in functions_of()
    }
    assert len(functions) >= 8
    assert [name for name in sorted(functions) if not called[name]] == []


def home_of(name: str) -> str:
    """The module that a dotted name is, or that holds it; "" for settings and others."""
    return max((m for m in MODULES if m != "twc_env" and f"{name}.".startswith(f"{m}.")), key=len, default="")


@cache
def functions_of() -> set[str]:
    """Names of all public functions and classes of the package."""
    kinds = (ast.FunctionDef, ast.ClassDef)
    trees = (ast.parse(path.read_text()) for path in MODULES.values())
    return {node.name for tree in trees for node in tree.body if isinstance(node, kinds) and node.name[0] != "_"}


@cache
def reached(module: str) -> frozenset[str]:
    """The modules that a module imports, and those that they import."""
    found, left = set(), [module]
    while left:
        at = left.pop()
        if at in found or at not in MODULES:
            continue
        found.add(at)
        left += imported_by(at)
    return frozenset(found)


@cache
def imported_by(module: str) -> tuple[str, ...]:
    path = MODULES[module]
    found = imports_of(path.read_text(), module, path.name == "__init__.py")
    return tuple({place for base, name in found for place in (base, f"{base}.{name}") if place in MODULES})


def is_setting(name: str) -> bool:
    """Whether the name is a dotted key of the config."""
    at: object = EnvConfig()
    for part in name.split("."):
        if not hasattr(at, part):
            return False
        at = getattr(at, part)
    return True
