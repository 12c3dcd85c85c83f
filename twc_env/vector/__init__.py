"""Many environments at once: worker processes, and adapters to learning libraries."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twc_env.vector.teams import VectorTeams

__all__ = ["VectorTeams"]


def __getattr__(name: str) -> Any:
    if name == "VectorTeams":
        from twc_env.vector.teams import VectorTeams

        return VectorTeams
    raise AttributeError(f"module 'twc_env.vector' has no attribute {name!r}")
