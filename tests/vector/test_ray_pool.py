"""Environments in actors of a Ray cluster of two machines, both of them this one (make test-ray)."""

import contextlib
import os
import signal

import numpy as np
import pytest

from twc_env.errors import DataError, WorkerError
from twc_env.vector.teams import VectorTeams

ray = pytest.importorskip("ray", reason="needs the extra 'ray'")
CHOICES = {"action.kind": "frontier", "lidar.beam_count": 36, "robots": 2, "max_cycles": 60}
pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture
def cluster():
    """Two machines with one core each, of which the second can be removed."""
    from ray.cluster_utils import Cluster

    machines = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    second = machines.add_node(num_cpus=1)
    machines.wait_for_nodes()
    ray.init(address=machines.address, log_to_driver=False, logging_level="ERROR")
    yield machines, second
    ray.shutdown()
    machines.shutdown()


def place(_actor):
    return ray.get_runtime_context().get_node_id(), os.getpid()


def play(teams, steps, accidents=()):
    """Results of some steps with random valid choices; accidents: step -> what happens before its results are there."""
    random, told = np.random.default_rng(0), []
    teams.reset(5)
    for step in range(steps):
        masks = teams.action_masks()
        actions = (random.random(masks.shape) * masks).argmax(-1)
        teams.send(actions, range(teams.count))
        dict(accidents).get(step, lambda: None)()
        ids, seen, rewards, ended, infos = teams.recv()
        order = np.argsort(ids)
        told.append([*(block[order] for block in seen.values()), rewards[order], ended[order], teams.states()])
        told.append([[info["reward_terms"] for info in infos[at]] for at in order])
    return told


def same(first, second):
    return all(
        np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b
        for one, other in zip(first, second, strict=True)
        for a, b in zip(one, other, strict=True)
    )


def test_actors_play_the_same_bytes_also_when_their_process_or_their_machine_is_lost(cluster):
    machines, second = cluster
    with VectorTeams(3, CHOICES) as alone, VectorTeams(3, CHOICES, ray="auto") as far:
        assert far.workers == 2, "one per core of the cluster"
        places = [ray.get(actor.__ray_call__.remote(place)) for actor in far._runner._actors]
        assert len({machine for machine, _ in places}) == 2 and os.getpid() not in {process for _, process in places}

        def kill():
            os.kill(places[0][1], signal.SIGKILL)

        accidents = {3: kill, 7: lambda: machines.remove_node(second, allow_graceful=False)}
        played = play(far, 12, accidents)
        assert far._runner._losses >= 2 and same(played, play(alone, 12))
        assert played[-2][-2].size and any(each[-2].any() for each in played[::2]), "an episode has ended"
    with pytest.raises(WorkerError, match=r"were lost 6 times"), VectorTeams(1, CHOICES, ray="auto") as far:
        far._runner._losses = 5
        far.reset(0)
        ray.kill(far._runner._actors[0])
        far.step(far.sample())


def test_errors_and_machines_with_other_code_are_named(cluster, monkeypatch):
    monkeypatch.setattr("twc_env.vector.ray_pool.code_digest", lambda: "0")
    with pytest.raises(DataError, match=r"has other code .* than this one \(0\): install the same version"):
        VectorTeams(1, CHOICES, ray="auto")
    with contextlib.suppress(ValueError):
        assert ray.is_initialized(), "who connected also disconnects"
