"""Libraries that learning needs (extra `train`)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from twc_env.errors import DataError


@contextmanager
def learning_libraries() -> Iterator[None]:
    """Turns a missing library of the extra `train` into an error of one line."""
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in ("torch", "stable_baselines3", "tqdm", "safetensors"):
            raise
        raise DataError(f"training needs {error.name}; install it with: pip install 'twc_env[train]'") from None
