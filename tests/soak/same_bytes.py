"""The same bytes with other instruction sets and one thread: whole episodes of every task, in processes that may not
use newer instructions or further threads.

Compiled kernels, NumPy and OpenBLAS choose their instructions by the processor, and OpenBLAS its threads by the number
of cores. Each attempt plays one task in a process in which one of `SWITCHES` takes that choice away, and compares the
digest of all observations, rewards, paths and maps with that of a process without a switch. All this takes hours: a
file keeps the digests of one version of the code, and a run goes on with those that it lacks.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from twc_env.agents import make_policy

import twc_env
from tests.soak.attempts import Attempt, append_row, kept_rows
from tests.soak.observation_check import random_actions
from twc_env.tasks import TASKS, task_config

_WIDE = "AVX2 FMA3 AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR"
SWITCHES = {
    "kernels for any x86-64": {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
    "kernels for Haswell": {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": "+avx2,+fma,+bmi,+bmi2"},
    "OpenBLAS for Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "OpenBLAS for SSE3": {"OPENBLAS_CORETYPE": "Prescott"},
    "NumPy without AVX2 and AVX-512": {"NPY_DISABLE_CPU_FEATURES": _WIDE},
    "one thread of OpenBLAS": {"OPENBLAS_NUM_THREADS": "1"},
}
SWITCHES["all for any x86-64"] = {
    **SWITCHES["kernels for any x86-64"],
    **SWITCHES["OpenBLAS for SSE3"],
    **SWITCHES["NumPy without AVX2 and AVX-512"],
}
TEAM = "nearest-frontier"


def episodes(count: int, seed: int = 0, kept: Path | None = None) -> Iterator[Attempt]:
    """`count` pairs of a task and a switch, every task once before one comes again; equal seeds play equal episodes.

    kept: a file of digests, a line each, which are not played again."""
    pairs = [pair(number) for number in range(min(count, len(TASKS) * len(SWITCHES)))]
    plain = found_digests("none", list(dict.fromkeys(task for _, task in pairs)), seed, kept)
    for switch in SWITCHES:
        own = [task for name, task in pairs if name == switch]
        found = found_digests(switch, own, seed, kept)
        for task in own:
            yield f"{switch}, {task}", partial(_compare, plain[task], found[task])


def pair(number: int) -> tuple[str, str]:
    """Switch and task of a number: all of them once, tasks and switches in turn."""
    rounds, task = divmod(number, len(TASKS))
    return tuple(SWITCHES)[(task + rounds) % len(SWITCHES)], tuple(TASKS)[task]


def _compare(plain: str, found: str) -> None:
    assert plain == found, f"other bytes: {found} where a process without a switch has {plain}"


def found_digests(switch: str, tasks: list[str], seed: int, kept: Path | None = None) -> dict[str, str]:
    """Digest of one episode of each task with a switch of `SWITCHES`, or "none"; those that the file lacks are played,
    each in a process of its own, and appended to it."""
    if kept is None:
        return _digests(SWITCHES.get(switch, {}), tasks, seed) if tasks else {}
    rows = [row for row in kept_rows(kept) if (row.get("switch"), row.get("seed")) == (switch, seed)]
    found = {row["task"]: row["digest"] for row in rows}
    for task in tasks:
        if task not in found:
            found |= _digests(SWITCHES.get(switch, {}), [task], seed)
            append_row(kept, {"switch": switch, "task": task, "seed": seed, "digest": found[task]})
    return found


def _digests(switch: dict[str, str], tasks: list[str], seed: int) -> dict[str, str]:
    """Digest of one episode of each task, in a process with these environment variables."""
    call = [sys.executable, "-W", "ignore", "-m", "tests.soak.same_bytes", str(seed), *tasks]
    set_by_user = {name for each in SWITCHES.values() for name in each}
    own = {name: value for name, value in os.environ.items() if name not in set_by_user}
    done = subprocess.run(call, env={**own, **switch}, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{switch}: {done.stderr[-400:]}"
    found: dict[str, str] = json.loads(done.stdout.splitlines()[-1])
    return found


def digest_of_episode(task: str, seed: int) -> str:
    """Number of calls of `step` and digest of a whole episode, by `TEAM`, or at random with frontiers."""
    config = task_config(task)
    env = twc_env.parallel_env(config=config)
    digest, steps = hashlib.sha256(), 0
    observations, infos = env.reset(seed=seed)
    policy = make_policy(TEAM, config) if config.action.kind == "velocity" else None
    if policy is not None:
        policy.reset(seed, env.possible_agents)
    random = np.random.default_rng(seed)
    _take(digest, observations)
    while env.agents:
        if policy is None:
            actions = random_actions(env, infos, random)
        else:
            actions = policy.act({name: env.belief(name) for name in env.agents})
        *parts, infos = env.step(actions)
        for part in parts:
            _take(digest, part)
        steps += 1
    result = env.result()
    for part in (result.true_poses, result.estimated_poses, *(grid.log_odds for grid in result.grids)):
        _take(digest, part)
    env.close()
    return f"{steps} steps {digest.hexdigest()[:16]}"


def _take(digest, value) -> None:
    if isinstance(value, dict):
        for key in sorted(value):
            digest.update(str(key).encode())
            _take(digest, value[key])
    else:
        digest.update(np.ascontiguousarray(value).tobytes())


if __name__ == "__main__":
    print(json.dumps({task: digest_of_episode(task, int(sys.argv[1])) for task in sys.argv[2:]}))
