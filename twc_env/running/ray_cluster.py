"""A Ray cluster (extra `ray`; only Ray Core is used), and independent parts of a computation as its tasks."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from twc_env.errors import DataError
from twc_env.processes.worker_processes import in_processes

AUTO = "auto"
RETRIES = 5
"""How often a part is computed anew whose worker process or machine was lost."""
ANSWER_S = 10.0
"""How long a cluster may take to answer."""
THREADS = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")}


@contextmanager
def connected(address: str) -> Iterator[Any]:
    """The module `ray`, connected to a cluster until the end of the block, unless it was connected before.

    address: of a cluster, or `auto`: the cluster that this machine belongs to, or one of this machine's cores alone.
    Raises DataError if Ray is not installed or the cluster is out of reach.
    """
    try:
        import ray
    except ImportError:
        raise DataError("--ray needs ray; install it with: pip install 'twc_env[ray]', or leave out --ray") from None
    is_ours = not ray.is_initialized()
    if is_ours:
        try:
            where = {} if address == AUTO else {"address": _answering(address)}
            ray.init(**where, log_to_driver=False, logging_level="ERROR", runtime_env={"env_vars": THREADS})
        except (ConnectionError, OSError, RuntimeError, ValueError) as error:
            reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
            raise DataError(
                f"no Ray cluster at {address!r}: {reason}; start one with `ray start --head`, or leave out --ray"
            ) from error
    try:
        yield ray
    finally:
        if is_ours:
            ray.shutdown()


def _answering(address: str) -> str:
    """The address, once something answers there: Ray itself would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdecimal():
        raise ValueError("an address is HOST:PORT")
    socket.create_connection((host, int(port)), timeout=ANSWER_S).close()
    return address


def spread_out(
    work: Callable[[Any], Any], parts: Sequence[Any], jobs: int, address: str | None
) -> Iterator[tuple[int, Any]]:
    """Yield (k, work(parts[k])) as each part is done: by processes of this machine, or on the cluster at `address`."""
    return in_processes(work, parts, jobs) if address is None or not parts else on_ray(work, parts, address)


def on_ray(work: Callable[[Any], Any], parts: Sequence[Any], address: str) -> Iterator[tuple[int, Any]]:
    """Yield (k, work(parts[k])) as each part is done, one Ray task with one core per part.

    All machines need this version of twc_env, and files that teams are read from. Parts of workers that are lost are
    done again. Raises DataError as `connected` does, or if a part was lost repeatedly; exceptions of `work` are passed
    on.
    """
    with connected(address) as ray:
        task = ray.remote(num_cpus=1, max_retries=RETRIES)(work)
        waiting = {task.remote(part): k for k, part in enumerate(parts)}
        while waiting:
            (done,), _ = ray.wait(list(waiting), num_returns=1)
            try:
                result = ray.get(done)
            except ray.exceptions.RayTaskError as error:  # an exception of `work` itself
                raise error.cause from None
            except ray.exceptions.RayError as error:
                raise DataError(
                    f"an episode was lost {RETRIES + 1} times ({type(error).__name__}): see the machines' memory, "
                    "then run the same again"
                ) from error
            yield waiting.pop(done), result
