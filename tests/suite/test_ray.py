"""A benchmark on a Ray cluster of this machine (make test-ray)."""

import pytest

from twc_env.suite.entries import entries
from twc_env.suite.runs import play_all

ray = pytest.importorskip("ray", reason="needs the extra 'ray'")


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_gives_the_same_episodes_as_this_process(tiny, tmp_path):
    planned = entries(tiny, ["random"], "test", 1)
    assert play_all(planned, tmp_path / "a", ray_address="auto") == play_all(planned, tmp_path / "b")
