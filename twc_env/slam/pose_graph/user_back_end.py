"""A pose-graph back end loaded from a user's file, with checks of its output."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PoseGraphConfig
from twc_env.errors import DataError
from twc_env.records.class_file import check_call, class_in
from twc_env.slam.pose_graph.solver import Graph

_GIVEN = ("poses", "edges", "measured", "information", "is_closure", "fixed")
"""What its `solve` is given."""


class OwnBackEnd:
    """The class that `robust` names as FILE.py:CLASS, constructed from the config anew for each optimisation."""

    def __init__(self, config: PoseGraphConfig):
        """Raises ConfigError if the class does not exist, has no `solve`, or takes other arguments."""
        self._file = config.robust
        own = class_in(self._file, ("solve",), f"a back end has solve({', '.join(_GIVEN)})")
        check_call(f"{self._file}, when it is made,", "with the settings (slam.pose_graph)", own, config)
        self._own = own(config)
        check_call(f"{self._file}.solve", f"with ({', '.join(_GIVEN)})", self._own.solve, *_GIVEN)

    def solve(self, poses: Array, graph: Graph, fixed: int) -> tuple[Array, Array]:
        """Poses (n, 3) and accepted edges (e,) bool, with odometry always accepted. Raises DataError for malformed
        output."""
        answer = self._own.solve(poses.copy(), *(part.copy() for part in graph.parts), fixed)
        if not isinstance(answer, tuple) or len(answer) != 2:
            got = f"an array of {answer.shape}" if isinstance(answer, np.ndarray) else f"{answer!r:.100}"
            raise DataError(f"{self._file} must answer with (poses, which edges it believes); got {got}")
        out, accepted = (np.array(part) for part in answer)
        if out.shape != poses.shape or out.dtype.kind not in "fiu" or not np.isfinite(out).all():
            raise DataError(f"{self._file} must answer with {len(poses)} finite poses; got {out.dtype} of {out.shape}")
        if accepted.shape != graph.is_closure.shape or accepted.dtype != bool:
            raise DataError(
                f"{self._file} must say of {len(graph.edges)} edges, by a bool each, whether it believes them; "
                f"got {accepted.dtype} of {accepted.shape}"
            )
        return out.astype(float), accepted | ~graph.is_closure
