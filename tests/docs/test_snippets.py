"""The snippets of docs/integrations.md, docs/library.md and other pages run as they stand."""

import importlib.util
import os
import re
from pathlib import Path

import pytest

from tests.forks import Forks

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "integrations.md").read_text()
LIBRARY = (ROOT / "docs" / "library.md").read_text()


def snippets(text: str) -> dict[str, str]:
    """Code of the snippets by heading."""
    found = re.findall(r"^### ([^\n]+)\n(?:(?!^### ).)*?```python\n(.*?)```", text, flags=re.DOTALL | re.MULTILINE)
    return dict(found)


OTHERS = {
    f"{page} {k}": text
    for page in ("gallery", "frames", "learning")
    for k, text in enumerate(re.findall(r"```python\n(.*?)```", (ROOT / "docs" / f"{page}.md").read_text(), re.DOTALL))
}
SNIPPETS = snippets(TEXT) | snippets(LIBRARY) | OTHERS
LIBRARIES = "gymnasium", "pettingzoo", "numba", "torchrl.envs", "stable_baselines3"
NEEDS = {
    "stable-baselines3": "stable_baselines3",
    "TorchRL": "torchrl",
    "RLlib": "ray",
    "Rendering and recording": "PIL",
}
NEEDS_OF_OTHERS = {"learning 0": "torch", "Error over time": "matplotlib"}


@pytest.fixture(scope="module")
def forks(tmp_path_factory):
    """Loads third-party libraries once for all snippets."""
    loaded = "\n".join(f"import {name}" for name in LIBRARIES if importlib.util.find_spec(name.split(".")[0]))
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    forks = Forks(loaded, tmp_path_factory.mktemp("forks"), {**os.environ, "PYTHONPATH": path})
    yield forks
    forks.close()


@pytest.mark.parametrize("heading", SNIPPETS)
def test_a_snippet_runs(heading, forks, tmp_path):
    module = {**NEEDS, **NEEDS_OF_OTHERS}.get(heading, "numpy")
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"needs {module}")
    status, said = forks.run(SNIPPETS[heading], tmp_path)
    assert status == 0, said


def test_the_library_page_names_every_tool():
    assert {*NEEDS, "Gymnasium, vectorised", "Copying and snapshots"} == snippets(TEXT).keys()
    assert len(snippets(LIBRARY)) == LIBRARY.count("\n### ") == LIBRARY.count("```python")
