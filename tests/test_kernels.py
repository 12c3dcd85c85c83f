"""A compiled kernel on disk is out of date as soon as anything that it is made of changes."""

import subprocess
import sys
from pathlib import Path

import pytest

from twc_env import geometry
from twc_env.kernels import kernel

ROOT = Path(__file__).parents[1]
UPPER = """from lower import FACTOR, scaled
from twc_env.kernels import kernel


@kernel
def total(x):
    return more(x) + FACTOR


@kernel
def more(x):
    return scaled(x)
"""
LOWER = """from twc_env.kernels import kernel

FACTOR = {factor}


@kernel
def scaled(x):
    return {body}
"""


def test_a_kernel_is_compiled_anew_when_a_kernel_or_a_constant_of_another_file_changes(tmp_path):
    (tmp_path / "upper.py").write_text(UPPER)
    code = "import upper; print(upper.total(3), len(upper.total.stats.cache_hits))"

    def value_and_hits(body: str, factor: int) -> tuple[int, ...]:
        (tmp_path / "lower.py").write_text(LOWER.format(body=body, factor=factor))
        command, path = [sys.executable, "-B", "-c", code], {"PYTHONPATH": str(ROOT)}
        said = subprocess.run(command, cwd=tmp_path, env=path, capture_output=True, text=True)
        assert not said.returncode, said.stderr
        return tuple(map(int, said.stdout.split()))

    assert value_and_hits("2 * x", 1) == (7, 0)
    assert value_and_hits("2 * x", 1) == (7, 1)
    assert value_and_hits("5 * x", 1) == (16, 0)
    assert value_and_hits("5 * x", 4) == (19, 0)


def test_a_kernel_may_not_reach_into_a_module_of_the_package():
    def reaching(x):
        return geometry.wrap_angle(x)

    with pytest.raises(TypeError, match=r"kernel reaching: import names from twc_env\.geometry"):
        kernel(reaching)
