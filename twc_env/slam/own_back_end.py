"""A back end from a file of one's own, whose answers are looked at before the engine takes them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.class_file import class_in
from twc_env.config import PoseGraphConfig
from twc_env.errors import DataError
from twc_env.slam.pose_graph import Graph


class OwnBackEnd:
    """The class that `robust` names as FILE.py:CLASS, made of the settings, anew for each optimisation."""

    def __init__(self, config: PoseGraphConfig):
        """Raises ConfigError where there is no such class, or it has no `solve`."""
        remedy = "a back end has solve(poses, edges, measured, information, is_closure, fixed)"
        self._file = config.robust
        self._own = class_in(self._file, ("solve",), remedy)(config)

    def solve(self, poses: Array, graph: Graph, fixed: int) -> tuple[Array, Array]:
        """Poses (n, 3) and which edges were believed (e,), odometry always. Raises DataError for what is neither."""
        answer = self._own.solve(poses.copy(), *(part.copy() for part in graph.parts), fixed)
        if not isinstance(answer, tuple) or len(answer) != 2:
            raise DataError(f"{self._file} must answer with poses and which edges it believes; got {answer!r}")
        out, accepted = (np.array(part) for part in answer)
        if out.shape != poses.shape or out.dtype.kind not in "fiu" or not np.isfinite(out).all():
            raise DataError(f"{self._file} must answer with {len(poses)} finite poses; got {out.dtype} of {out.shape}")
        if accepted.shape != graph.is_closure.shape or accepted.dtype != bool:
            raise DataError(
                f"{self._file} must say of {len(graph.edges)} edges, by a bool each, whether it believes them; "
                f"got {accepted.dtype} of {accepted.shape}"
            )
        return out.astype(float), accepted | ~graph.is_closure
