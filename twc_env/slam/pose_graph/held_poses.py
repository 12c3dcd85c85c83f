"""Poses that are held together, as those of a finished map, as one pose of a graph."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.geometry import between, compose, inverse
from twc_env.records.twists import adjoint

Parts = tuple[Array, Array, Array, Array, Array]
"""Ends (e, 2), measured (e, 3), information (e, 3, 3), is_closure (e,), is_used (e,) of edges."""


def contracted(held: Array, edges: Parts) -> tuple[Array, Parts]:
    """The edges of a graph whose first poses, held (k, 3), are one pose, the first; the others follow it.

    Edges among the held poses are left out; returns also which stay (e,). An edge measured from a held pose says the
    same of the first pose, with the same information, as that is in the axes of its other end; one measured towards a
    held pose has its information carried to the first pose by the adjoint.
    """
    ends, measured, information, is_closure, is_used = edges
    count = len(held)
    is_left = np.logical_or(*(ends >= count).T)
    ends, measured, information = ends[is_left], measured[is_left].copy(), information[is_left].copy()
    relative = between(held[:1], held)
    begins, arrives = np.flatnonzero(ends[:, 0] < count), np.flatnonzero(ends[:, 1] < count)
    measured[begins] = compose(relative[ends[begins, 0]], measured[begins])
    back = inverse(relative[ends[arrives, 1]])
    measured[arrives] = compose(measured[arrives], back)
    carried = adjoint(back)
    information[arrives] = np.swapaxes(carried, 1, 2) @ information[arrives] @ carried
    parts = np.maximum(ends - count + 1, 0), measured, information, is_closure[is_left], is_used[is_left]
    return is_left, parts
