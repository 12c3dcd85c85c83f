"""One thread for the matrix libraries of NumPy and SciPy, where several only wait for each other.

They share even small products among threads. Beside another busy program each waits for the slowest, so a fit of a
thousand of them takes many times as long; and sums of other parts round differently, so results depend on the cores.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Matrix libraries compute in one thread in this block, whichever thread of the process calls them; of blocks in
    several threads the first decides. For functions it is a decorator."""
    with _libraries().limit(limits=1, user_api="blas"):
        yield


@cache
def _libraries() -> ThreadpoolController:
    """The libraries, found once. SciPy's own is loaded first: what is loaded later is not known to the controller."""
    import scipy.linalg.lapack  # noqa: F401  late: a tenth of the start-up time, and most episodes need none of this
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
