import subprocess
import sys

import pytest

HEAVY = ("torch", "pygame", "matplotlib", "PIL", "stable_baselines3", "pandas", "IPython")
WARM_IMPORT_MAX_S = 0.6
"""CPU time, which hardly depends on the load of the machine."""

TIMED = "import time; t = time.process_time(); import twc_env; print(time.process_time() - t)"


def run(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout


def test_importing_twc_env_loads_no_heavy_dependency():
    loaded = run(f"import sys, twc_env; print([name for name in {HEAVY!r} if name in sys.modules])")
    assert loaded.strip() == "[]"


def test_dir_lists_the_public_names_before_they_are_loaded():
    assert "ExplorationEnv" in run("import twc_env; print(dir(twc_env))")


@pytest.mark.parametrize("name", ["agents", "config", "datasets", "metrics", "planning", "vector"])
def test_a_public_submodule_is_there_without_an_import_of_its_own_and_loaded_only_then(name):
    code = f"import sys, twc_env; print('twc_env.{name}' in sys.modules, {name!r} in dir(twc_env), twc_env.{name})"
    was_loaded, is_listed, *shown = run(code).split()
    assert was_loaded == "False" and is_listed == "True"
    assert f"<module 'twc_env.{name}' from" in " ".join(shown)


def test_an_environment_needs_no_slow_part_of_scipy_to_start():
    parts = tuple(f"scipy.{name}" for name in ("linalg", "ndimage", "sparse", "spatial", "special", "stats"))
    code = f"import sys, twc_env.exploration.environment; print([name for name in {parts!r} if name in sys.modules])"
    assert run(code).strip() == "[]"


def test_a_warm_import_takes_less_than_its_limit(slowdown):
    best_s = min(float(run(TIMED)) for _ in range(5))
    print(f"import twc_env: {best_s:.2f} s of CPU time warm, best of 5")
    assert best_s < WARM_IMPORT_MAX_S * slowdown


@pytest.mark.parametrize("name", ["config", "records.messages", "records.geometry", "vector"])
def test_every_public_module_can_be_imported_alone(name):
    assert run(f"import twc_env.{name}; print(twc_env.{name}.__name__)").strip() == f"twc_env.{name}"


def test_without_stable_baselines3_its_adapter_names_the_extra():
    code = "import sys; sys.modules['stable_baselines3'] = None; import twc_env.vector.sb3"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stderr.splitlines()[-1].endswith(
        "twc_env.vector.sb3 needs stable-baselines3: pip install 'twc_env[train]'"
    )
