"""Episodes on a Ray cluster of this machine (make test-ray)."""

import os
import signal

import pytest

from twc_env.errors import ConfigError, DataError
from twc_env.running import ray_cluster

try:
    import ray
except ImportError:
    ray = None
needs_ray = pytest.mark.skipif(ray is None, reason="needs the extra 'ray'")


def square(part):
    """Also ends its own process, once, if the part names a file that does not exist yet."""
    number, path = part
    if path and not os.path.exists(path):
        with open(path, "w"):
            os.kill(os.getpid(), signal.SIGKILL)
    return number**2


def refuse(part):
    raise ConfigError(f"no {part}")


@pytest.fixture
def cluster():
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    yield
    ray.shutdown()


@needs_ray
@pytest.mark.filterwarnings("ignore")
def test_a_part_whose_worker_is_killed_is_done_again(cluster, tmp_path):
    parts = [(3, ""), (4, str(tmp_path / "killed")), (5, "")]
    assert dict(ray_cluster.on_ray(square, parts, "auto")) == {0: 9, 1: 16, 2: 25}
    assert (tmp_path / "killed").exists()


@needs_ray
@pytest.mark.filterwarnings("ignore")
def test_errors_of_a_part_are_passed_on(cluster):
    with pytest.raises(ConfigError, match=r"^no robots$"):
        list(ray_cluster.on_ray(refuse, ["robots"], "auto"))


@needs_ray
@pytest.mark.filterwarnings("ignore")
def test_a_cluster_out_of_reach_is_named():
    with pytest.raises(
        DataError, match=r"no Ray cluster at '127\.0\.0\.1:1': .*start one with `ray start --head`"
    ) as e:
        list(ray_cluster.on_ray(square, [(1, "")], "127.0.0.1:1"))
    assert "\n" not in str(e.value)


@pytest.mark.skipif(ray is not None, reason="ray is installed")
def test_without_ray_the_remedy_is_named():
    with pytest.raises(DataError, match=r"--ray needs ray; install it with: pip install 'twc_env\[ray\]'"):
        list(ray_cluster.on_ray(square, [(1, "")], "auto"))
