"""Other bytes with another set of instructions are found; `make soak` plays every task."""

import json
import subprocess

import pytest

from tests.soak import same_bytes
from tests.soak.attempts import attempt_all
from twc_env.tasks import TASKS


def test_a_task_that_has_other_bytes_is_named(monkeypatch):
    def digests(switch, tasks, seed):
        odd = "NPY_DISABLE_CPU_FEATURES" in switch and "NUMBA_CPU_NAME" not in switch
        return {task: f"{task} {odd and task == 'twc/ExploreTwin01-v0'}" for task in tasks}

    monkeypatch.setattr(same_bytes, "_digests", digests)
    pairs = len(TASKS) * len(same_bytes.SWITCHES)
    done = attempt_all(same_bytes.episodes(pairs + 10))
    assert (done.tried, done.accepted) == (pairs, pairs - 1)
    (fault,) = done.wrong
    assert fault.startswith("NumPy without AVX2 and AVX-512, twc/ExploreTwin01-v0: AssertionError: other bytes")


def test_a_run_that_was_interrupted_plays_what_the_file_lacks(monkeypatch, tmp_path):
    played = []

    def digests(switch, tasks, seed):
        played.extend(tasks)
        if len(played) == 25:
            raise KeyboardInterrupt
        return dict.fromkeys(tasks, "equal")

    monkeypatch.setattr(same_bytes, "_digests", digests)
    file = tmp_path / "digests.jsonl"
    with pytest.raises(KeyboardInterrupt):
        attempt_all(same_bytes.episodes(len(TASKS), 0, file))
    done = attempt_all(same_bytes.episodes(len(TASKS), 0, file))
    assert (done.tried, done.accepted, len(played)) == (len(TASKS), len(TASKS), 2 * len(TASKS) + 1)
    file.write_text(file.read_text().replace("equal", "other", 1))
    assert len(attempt_all(same_bytes.episodes(len(TASKS), 0, file)).wrong) == 1
    attempt_all(same_bytes.episodes(1, 1, file))
    assert len(played) == 2 * len(TASKS) + 3  # of another seed


def test_few_pairs_are_spread_over_tasks_and_switches():
    few = [same_bytes.pair(number) for number in range(len(TASKS))]
    assert [task for _, task in few] == list(TASKS) and {switch for switch, _ in few} == set(same_bytes.SWITCHES)
    every = {same_bytes.pair(number) for number in range(len(TASKS) * len(same_bytes.SWITCHES))}
    assert len(every) == len(TASKS) * len(same_bytes.SWITCHES)


def test_what_the_user_has_switched_off_does_not_count_in_the_process_without_a_switch(monkeypatch):
    def run(call, env, **_):
        told = json.dumps({name: env.get(name) for name in ("OPENBLAS_CORETYPE", "NUMBA_CPU_NAME")})
        return subprocess.CompletedProcess(call, 0, told, "")

    monkeypatch.setenv("OPENBLAS_CORETYPE", "Haswell")
    monkeypatch.setattr(same_bytes.subprocess, "run", run)
    assert same_bytes._digests({}, [], 0) == {"OPENBLAS_CORETYPE": None, "NUMBA_CPU_NAME": None}
    assert same_bytes._digests({"NUMBA_CPU_NAME": "generic"}, [], 0)["NUMBA_CPU_NAME"] == "generic"


def test_the_digest_covers_what_is_played(monkeypatch):
    monkeypatch.setattr(same_bytes, "task_config", lambda task: small(task))
    first, again, other = (same_bytes.digest_of_episode("twc/Explore-v0", seed) for seed in (0, 0, 1))
    assert first == again != other and first.startswith("30 steps")


@pytest.mark.parametrize("task", TASKS)
def test_every_task_can_be_played(task, monkeypatch):
    monkeypatch.setattr(same_bytes, "task_config", lambda task: small(task, max_cycles=3))
    assert int(same_bytes.digest_of_episode(task, 0).split()[0]) in (1, 2, 3)  # several time steps are one of frontiers


def small(task, max_cycles=30):
    from twc_env.config import override
    from twc_env.tasks import task_config

    return override(task_config(task), {"max_cycles": max_cycles, "robots": 2})
