"""Starting the workers of a Ray cluster: what goes wrong is told in one line, and the connection is closed again. Ray
itself is not needed: `test_ray_pool` plays on a real cluster."""

from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from twc_env.errors import DataError
from twc_env.running.finished_parts import code_digest
from twc_env.vector import ray_pool
from twc_env.vector.teams import VectorTeams


class RayError(Exception):
    pass


class Cluster:
    """The part of the module `ray` that starting uses, on a cluster of two cores whose workers answer with `code`."""

    exceptions = SimpleNamespace(RayError=RayError)

    def __init__(self, code):
        self.code, self.started, self.killed, self.is_connected = code, 0, 0, True

    def cluster_resources(self):
        return {"CPU": 2.0}

    available_resources = cluster_resources

    def remote(self, **_):
        def start(*_):
            self.started += 1
            return SimpleNamespace(code=SimpleNamespace(remote=lambda: None))

        return lambda group: SimpleNamespace(remote=start)

    def get(self, references):
        if isinstance(self.code, Exception):
            raise self.code
        return [self.code for _ in references]

    def kill(self, actor):
        self.killed += 1


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (RayError("the actor died\nbecause of an error"), r"a worker of the Ray cluster does not start \(RayError\)"),
        ("0", r"has other code \(0\) than this one .*: install the same version"),
        (code_digest(), None),
    ],
    ids=["no start", "other code", "sound"],
)
def test_workers_that_do_not_start_are_told_in_one_line_and_nothing_stays_open(monkeypatch, code, words):
    cluster = Cluster(code)

    @contextmanager
    def connected(address):
        try:
            yield cluster
        finally:
            cluster.is_connected = False

    monkeypatch.setattr(ray_pool, "connected", connected)
    if words is None:
        teams = VectorTeams(2, {"robots": 1}, ray="auto")
        assert cluster.is_connected and teams.workers == cluster.started == 2
        teams.close()
    else:
        with pytest.raises(DataError, match=words) as told:
            VectorTeams(2, {"robots": 1}, ray="auto")
        assert "\n" not in str(told.value)
    assert not cluster.is_connected and cluster.killed == 2
