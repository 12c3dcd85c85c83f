"""The tutorials run: every script learns for a moment and writes its curve."""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "docs" / "tutorials"
NEEDS = {
    "sb3": ("stable_baselines3",),
    "maskable_ppo": ("sb3_contrib",),
    "torchrl_ppo": ("torchrl", "tensordict"),
    "rllib_ppo": ("ray", "torch"),
    "benchmarl_mappo": ("benchmarl",),
    "one_file": ("torch",),
}
"""Script -> modules without which it cannot run."""


def test_every_script_has_a_test_and_a_page():
    scripts = {path.stem for path in FOLDER.glob("*.py")} - {"small_task"}
    assert scripts == set(NEEDS)
    shown = "".join(path.read_text() for path in FOLDER.glob("*.md"))
    assert [name for name in scripts if f"<!-- file: docs/tutorials/{name}.py -->" not in shown] == []


@pytest.mark.parametrize("name", NEEDS)
def test_a_tutorial_runs_and_writes_its_curve(name, tmp_path):
    for module in (*NEEDS[name], "matplotlib"):
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"needs {module}")
    path = os.pathsep.join([str(FOLDER.parents[1]), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, str(FOLDER / f"{name}.py"), "600", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env={**os.environ, "PYTHONPATH": path})
    assert done.returncode == 0, done.stderr
    (written,) = tmp_path.glob("*.json")
    curve = json.loads(written.read_text())
    assert curve["episodes"] >= 4 and all(0 <= mean <= 1 for mean in curve["means"])
    assert written.with_suffix(".png").exists()
