"""The odometry filters of all robots, by the back end that the settings name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from twc_env.config import OdometryFilterConfig
from twc_env.slam.odometry.odometry_filter import CompiledFilters, OdometryAlone

if TYPE_CHECKING:
    from twc_env.slam.odometry.filterpy_filter import FilterpyFilters


def make_filters(
    config: OdometryFilterConfig | Sequence[OdometryFilterConfig], count: int, believes_scans: bool = True
) -> CompiledFilters | FilterpyFilters:
    """One filter per robot, of the type that `config.backend` names; config: of all robots, or of each."""
    backend = (config if isinstance(config, OdometryFilterConfig) else config[0]).backend
    if not believes_scans:
        return OdometryAlone(config, count)
    if backend == "filterpy":
        from twc_env.slam.odometry.filterpy_filter import FilterpyFilters

        return FilterpyFilters(config, count)
    return CompiledFilters(config, count)
