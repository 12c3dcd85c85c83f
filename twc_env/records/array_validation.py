"""Validation of arrays from callers; the kernels behind it check nothing."""

from __future__ import annotations

import math
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike
from numpy.typing import NDArray as Array

from twc_env.errors import UNFIT, DataError

_FLOAT = np.dtype(np.float64)


def validated_rows(values: ArrayLike, shape: tuple[int, ...], name: str, kind: Any = float, rows: str = "n") -> Array:
    """(rows, *shape) array of a dtype (kind), C-contiguous; an empty list counts as no rows.

    Raises DataError if values are not numbers, have another shape, or are not whole numbers for `np.int64`.
    """
    try:
        given = np.asarray(values)
        made: Array = np.ascontiguousarray(given, kind)
    except UNFIT as error:
        raise DataError(f"{name} must be numbers of shape {(rows, *shape)}: {error}") from None
    if made.shape == (0,):
        return made.reshape(0, *shape)
    if made.shape[1:] != shape or made.ndim != 1 + len(shape):
        raise DataError(f"{name} must have shape {(rows, *shape)}; got {made.shape}")
    if kind is np.int64 and not np.array_equal(made, given):
        raise DataError(f"{name} must be whole numbers; got {given.dtype} with {given.ravel()[:4].tolist()}")
    return made


def real_array(values: ArrayLike, name: str) -> Array:
    """Values of any shape as floats. Raises DataError if they are no real numbers."""
    if _is_plain(values):
        return values
    try:
        with np.errstate(all="ignore"):
            given = np.asarray(values)
            if given.dtype.kind not in "biufO":
                raise TypeError(f"their type is {given.dtype}")
            return given.astype(float)
    except Exception as error:  # an object of another library may raise any
        raise DataError(f"{name} must be real numbers; got {values!r:.80}: {error}") from None


def validated_points(values: ArrayLike, name: str = "points") -> Array:
    """(n, 2) finite points. Raises DataError for others."""
    is_ready = _is_plain(values) and values.ndim == 2 and values.shape[1] == 2
    points: Array = np.asarray(values) if is_ready else validated_rows(values, (2,), name)
    flat = points.reshape(-1)
    if not math.isfinite(flat.dot(flat)) and not np.isfinite(points).all():  # the first test is ten times faster
        raise DataError(f"{name} must be finite; row {int(np.argmin(np.isfinite(points).all(axis=1)))} is not")
    return points


def validated_pose(values: ArrayLike, name: str) -> Array:
    """(3,) finite pose. Raises DataError for others."""
    pose: Array
    if _is_plain(values) and values.shape == (3,):
        pose = values
    else:
        try:
            pose = np.ascontiguousarray(values, float)
        except UNFIT:
            pose = np.full(3, np.nan)
    if pose.shape != (3,) or not all(map(math.isfinite, pose.tolist())):
        raise DataError(f"{name} must be a finite pose (x [m], y [m], heading [rad]); got {values!r}")
    return pose


def plain(values: ArrayLike) -> Array:
    """The values as a C-contiguous float64 array; not copied if they are one."""
    return values if _is_plain(values) else np.ascontiguousarray(values, float)


def _is_plain(values: ArrayLike) -> TypeGuard[Array]:
    """Whether the value is a C-contiguous float64 array; faster than a conversion."""
    return type(values) is np.ndarray and values.dtype == _FLOAT and values.flags.c_contiguous
