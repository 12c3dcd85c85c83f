"""A guard of objects that one thread at a time may use."""

from __future__ import annotations

from threading import get_ident

from twc_env.errors import TwcError


class OneThread:
    """A `with` block for one thread at a time. Another thread gets a TwcError at once, before anything is changed."""

    __slots__ = ("_holder", "_what")

    def __init__(self, what: str):
        """what: the guarded object, for the message."""
        self._what = what
        self._holder: dict[str, int] = {}

    def __enter__(self) -> None:
        if self._holder.setdefault("thread", get_ident()) != get_ident():  # one operation: no thread comes between
            raise TwcError(f"{self._what} is at work in another thread: make one for each thread, or share a lock")

    def __exit__(self, *_: object) -> None:
        self._holder.clear()
