"""The snippets of the README and of docs/library.md run as they stand."""

import importlib.util
import os
import re
from pathlib import Path

import pytest

import twc_env
from tests.forks import Forks

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
TEXT = README[README.index("## Integrations") : README.index("## Documentation")]
LIBRARY = (ROOT / "docs" / "library.md").read_text()


def snippets(text: str) -> dict[str, str]:
    """Code of the snippets by heading."""
    found = re.findall(r"^### ([^\n]+)\n(?:(?!^### ).)*?```python\n(.*?)```", text, flags=re.DOTALL | re.MULTILINE)
    return dict(found)


SNIPPETS = snippets(TEXT) | snippets(LIBRARY)
LIBRARIES = "gymnasium", "pettingzoo", "numba", "torchrl.envs", "stable_baselines3"
NEEDS = {
    "stable-baselines3": "stable_baselines3",
    "TorchRL": "torchrl",
    "RLlib": "ray",
    "Rendering and recording": "PIL",
}


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
    module = NEEDS.get(heading, "numpy")
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"needs {module}")
    status, said = forks.run(SNIPPETS[heading], tmp_path)
    assert status == 0, said


def test_the_library_page_names_every_tool_and_task():
    assert {*NEEDS, "Gymnasium, vectorised", "Copying and snapshots"} == snippets(TEXT).keys()
    assert len(snippets(LIBRARY)) == LIBRARY.count("\n### ") == LIBRARY.count("```python")
    assert set(re.findall(r"`(twc/[\w-]+)`", README)) == set(twc_env.TASKS)
