"""The notebooks store their outputs, and run from top to bottom; here on smaller settings."""

import importlib.util
import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
SMALL = {
    "01-first-episode": "max_cycles = 60",
    "02-drift-and-loop-closures": "max_cycles, drifts = 60, (1, 2)",
    "03-look-alike-rooms": "max_cycles, seeds = 60, range(1)",
    "04-false-closures": "shares, repeats = (0.0, 0.2), 1",
    "05-walls-from-wifi": "max_cycles = 400",
    "06-train-and-watch": "decisions, max_cycles, test_seeds = 64, 30, range(2)",
}
"""What the test sets after the cell tagged `parameters`, as papermill does."""
NEEDS = {"06-train-and-watch": "stable_baselines3"}


def cells_of(path: Path, kind: str = "code") -> list:
    return [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == kind]


def test_every_notebook_is_tested_on_small_settings():
    assert [path.stem for path in NOTEBOOKS] == list(SMALL)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_outputs_of_one_run_from_top_to_bottom_are_stored(path):
    cells = cells_of(path)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [output for cell in cells for output in cell.outputs]
    assert not any(output.output_type == "error" or output.get("name") == "stderr" for output in outputs)
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert path.stat().st_size < 1_500_000


def test_the_interval_over_eight_buildings_is_that_of_eight():
    """It was 1.96 standard errors, which hold the mean of eight values in 91 of 100 cases."""
    sources = [cell.source for cell in cells_of(NOTEBOOKS[-1])]
    assert any("mean_interval(lead)" in source for source in sources) and not any("1.96" in each for each in sources)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_begins_with_a_title_and_ends_with_three_exercises(path):
    texts = [cell.source for cell in cells_of(path, "markdown")]
    assert texts[0].startswith("# ")
    last = texts[-1][texts[-1].index("## Exercises") :]
    assert re.findall(r"^(\d)\. ", last, re.MULTILINE) == ["1", "2", "3"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_first_cell_installs_the_package_only_where_it_is_missing(path, monkeypatch):
    cell = cells_of(path)[0].source
    extras = re.findall(r"^    %pip install --quiet 'twc_env\[([\w,]+)\]'$", cell, re.MULTILINE)
    assert extras == ["viz,train" if path.stem in NEEDS else "viz"]
    code, asked = cell.replace("%pip", "asked.append('pip') #"), []
    exec(code, {"asked": asked})
    assert asked == []
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    exec(code, {"asked": asked})
    assert asked == ["pip"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_the_notebook_runs_from_top_to_bottom(path, tmp_path):
    module = NEEDS.get(path.stem, "matplotlib")
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"needs {module}")
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    (place,) = (k for k, cell in enumerate(notebook.cells) if "parameters" in cell.metadata.get("tags", []))
    notebook.cells.insert(place + 1, nbformat.v4.new_code_cell(SMALL[path.stem]))
    NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    assert all(cell.execution_count for cell in notebook.cells if cell.cell_type == "code")
