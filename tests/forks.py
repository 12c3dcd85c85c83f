"""Separate processes for tests, forked from a process that has already loaded slow modules. This takes a tenth of the
time of new processes; each fork imports other modules itself."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ALONE = {"PYTHONPATH": str(Path(__file__).parents[1]), "PYTHONDONTWRITEBYTECODE": "1"}
"""Complete environment of processes that must not depend on that of the tests."""
SERVER = """
import atexit, json, os, sys, traceback
{loaded}
for line in sys.stdin:
    folder, code, said = json.loads(line)
    child = os.fork()
    if child:
        print(os.waitpid(child, 0)[1], flush=True)
        continue
    os.dup2(os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 1)
    os.dup2(1, 2)
    os.chdir(folder)
    sys.path[0] = folder
    status = 1
    try:
        exec(code, {{"__name__": "__main__"}})
        status = 0
    except BaseException:
        traceback.print_exc()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    os._exit(status)  # a normal exit would take longer than most programs
"""


class Forks:
    """Runs programs, each in a separate forked process."""

    def __init__(self, loaded: str, folder: Path, env: dict[str, str]):
        """loaded: code that is run once, before the forks; folder: for the output of the programs."""
        code = SERVER.format(loaded=loaded)
        self._said = folder / "said"
        self._server = subprocess.Popen(
            [sys.executable, "-c", code], env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def run(self, code: str, folder: Path) -> tuple[int, str]:
        """Run a program in a folder; returns its exit status and its output."""
        if not hasattr(os, "fork"):
            pytest.skip("processes cannot be forked here")
        server = self._server
        assert server.stdin is not None and server.stdout is not None
        server.stdin.write(json.dumps([str(folder), code, str(self._said)]) + "\n")
        server.stdin.flush()
        return int(server.stdout.readline()), self._said.read_text()

    def close(self) -> None:
        """End the server process."""
        self._server.communicate()
