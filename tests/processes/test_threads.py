import os
import subprocess
import sys

import pytest

from twc_env.processes.threads import THREADS, single_threaded


@pytest.mark.parametrize("before", [None, "4"])
def test_processes_started_inside_have_one_thread_and_the_environment_is_restored(monkeypatch, before):
    for name in THREADS:
        monkeypatch.delenv(name, raising=False) if before is None else monkeypatch.setenv(name, before)
    ask = [sys.executable, "-c", f"import os; print({[*THREADS]} == [n for n in {[*THREADS]} if os.environ[n] == '1'])"]
    with single_threaded():
        assert subprocess.run(ask, capture_output=True, text=True, check=True).stdout.strip() == "True"
    assert [os.environ.get(name) for name in THREADS] == [before] * len(THREADS)
