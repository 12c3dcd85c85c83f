"""Published figures of TWC-SLAM's Table I, and a statistic for tables with gaps."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray as Array

PRINT = {
    "#01": {"text": ((35, 89), (52, 78), (78, 31)), "wifi": ((45, 86), (62, 72), (68, 70)),
            "twc": ((65, 92), (95, 90), (96, 65))},
    "#02": {"text": ((41, 75), (61, 76), (88, 45)), "wifi": ((51, 81), (70, 76), (87, 40)),
            "twc": ((54, 89), (82, 93), (84, 68))},
}  # fmt: skip
"""Published precision and recall [%]."""


def over_known(values: Array, statistic: Callable[[Array], float], digits: int) -> float:
    """A statistic of the finite values, rounded; NaN if there are none."""
    known = values[np.isfinite(values)]
    return round(float(statistic(known)), digits) if len(known) else math.nan
