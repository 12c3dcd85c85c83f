"""The snippets of the README and of docs/library.md run as they stand."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import twc_env

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text()
TEXT = TEXT[TEXT.index("## In other tools") : TEXT.index("## Where to go next")]
LIBRARY = (ROOT / "docs" / "library.md").read_text()


def snippets(text: str) -> dict[str, str]:
    """Heading to code."""
    found = re.findall(r"^### ([^\n]+)\n(?:(?!^### ).)*?```python\n(.*?)```", text, flags=re.DOTALL | re.MULTILINE)
    return dict(found)


SNIPPETS = snippets(TEXT) | snippets(LIBRARY)
NEEDS = {"stable-baselines3": "stable_baselines3", "TorchRL": "torchrl", "RLlib": "ray", "Seeing it": "PIL"}


@pytest.mark.parametrize("heading", SNIPPETS)
def test_a_snippet_runs(heading, tmp_path):
    module = NEEDS.get(heading, "numpy")
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"needs {module}")
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", SNIPPETS[heading]],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr


def test_the_page_names_every_tool_and_every_task():
    assert {*NEEDS, "Gymnasium, vectorised", "Copies and moments"} == snippets(TEXT).keys()
    assert len(snippets(LIBRARY)) == LIBRARY.count("\n### ") == LIBRARY.count("```python")
    assert set(re.findall(r"`(twc/[\w-]+)`", TEXT)) == set(twc_env.TASKS)
