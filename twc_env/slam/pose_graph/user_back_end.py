"""A pose-graph back end loaded from a user's file, with checks of its output."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PoseGraphConfig
from twc_env.errors import DataError
from twc_env.records.class_file import class_in
from twc_env.slam.pose_graph.solver import Graph


class OwnBackEnd:
    """The class that `robust` names as FILE.py:CLASS, constructed from the config anew for each optimisation."""

    def __init__(self, config: PoseGraphConfig):
        """Raises ConfigError if the class does not exist or has no `solve`."""
        remedy = "a back end has solve(poses, edges, measured, information, is_closure, fixed)"
        self._file = config.robust
        self._own = class_in(self._file, ("solve",), remedy)(config)

    def solve(self, poses: Array, graph: Graph, fixed: int) -> tuple[Array, Array]:
        """Poses (n, 3) and accepted edges (e,) bool, with odometry always accepted. Raises DataError for malformed
        output."""
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
