"""Numba's cache on disk sees edits of a kernel's own file only: kernels must take nothing from other files."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = [path for path in sorted((ROOT / "twc_env").rglob("*.py")) if "njit" in path.read_text()]


def borrowed(source: str) -> list[str]:
    """Names that kernels of a file use although they were imported from twc_env."""
    tree = ast.parse(source)
    imported = {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.level or (node.module or "").startswith("twc_env"))
        for alias in node.names
    }
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and any("njit" in ast.unparse(d) for d in node.decorator_list):
            own = {argument.arg for argument in node.args.args}
            names = {n.id for n in ast.walk(node) if isinstance(n, ast.Name)} - own
            found += sorted(f"{node.name}: {name}" for name in names & imported)
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_kernels_use_nothing_from_other_files(path):
    assert borrowed(path.read_text()) == []


def test_the_check_sees_a_borrowed_kernel_and_a_borrowed_number():
    source = "from twc_env.geometry import f, LIMIT\n\n@njit(cache=True)\ndef g(x):\n    return f(x) + LIMIT\n"
    source += "\n@njit\ndef h(f):\n    return f\n"
    assert borrowed(source) == ["g: LIMIT", "g: f"]
