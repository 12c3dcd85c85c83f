"""Floor plans from pictures of free space: every edge between a free and another cell becomes part of a wall."""

from __future__ import annotations

import io
import logging
import math
import re
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array
from scipy import ndimage

from twc_env.errors import MapError
from twc_env.kernels.compiled import kernel
from twc_env.world.building.floor_cells import CELLS_MAX
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.floorplan_file import load_bytes

WALL_LOSS_DB = 5.0
"""Loss of a whole wall; each of its two faces has half."""
SPECK_M2 = 0.02
"""Smaller obstacles are removed as noise."""
STRIP_M = 0.2
"""Free strips up to this width, too narrow for a robot, are removed as stray beams and gaps of the scan."""
LEFT_OUT_MIN_M2 = 1.0
"""Parts of the floor of this size are named if they are left out."""
EDGES_MAX = 250_000
"""Edges of pixels between floor and others: 12.5 km of walls at 5 cm, where the largest real map has 1.6 km."""
FLOOR_CELLS_MAX = 6_000_000
"""Pixels of floor: 15,000 m2 at 5 cm; the largest real picture has a million pixels in all."""
_OUTSIDE_SHARE = 0.9
"""A floor that takes more of the border of a picture goes around the building."""
_MARK_MAX_M, _MARKS_MIN = 1.5, 2
"""So many obstacles up to this size that stand free are named: they may be writing."""
_LOG = logging.getLogger(__name__)
_GAP = rb"(?:\s|#[^\n]*\n)*"
_PGM_HEADER = re.compile(_GAP + rb"(P[25])" + 3 * (rb"\s" + _GAP + rb"(\d{1,9})") + rb"(?!\S)")
"""Kind, columns, rows and the value of white, with optional comments in between."""


def plan_from_free(free: Array, resolution_m: float, name: str, origin_m: Sequence[float] = (0.0, 0.0)) -> Floorplan:
    """Free cells (rows, columns), row 0 the lowest y -> a plan without signs whose walls are the cells' edges.

    Only the largest connected part is kept; specks and narrow strips are dropped, and what is behind them, which is
    said. Raises MapError when nothing is free.
    """
    box = _box(free, math.ceil(math.sqrt(SPECK_M2) / resolution_m))
    free, low = largest_part(free[box]), np.array([box[1].start, box[0].start])
    wide = _without_strips(_without_specks(free, resolution_m), resolution_m)
    free = largest_part(wide)
    all_m2, kept_m2 = (part.sum() * resolution_m**2 for part in (wide, free))
    name_left_out(name, all_m2 - kept_m2, all_m2, f"no passage wider than {STRIP_M:g} m leads there")
    if not free.any():
        raise MapError(
            f"map {name!r} shows no free space wider than {STRIP_M} m; free cells must be white, "
            "or check the thresholds and the resolution"
        )
    origin = np.asarray(origin_m, float)
    walls = (free_edges(free) + low) * resolution_m + origin
    row, column = np.array(deepest_cell(free)) + low[::-1]
    return Floorplan(
        name=name,
        walls_m=walls,
        wall_loss_db=np.full(len(walls), WALL_LOSS_DB / 2),
        interior_m=origin + (np.array([[column, row]]) + 0.5) * resolution_m,
    )


def name_left_out(where: str, lost_m2: float, all_m2: float, why: str, what: str = "of floor") -> None:
    """Warn that so much of a floor is left out, if it is worth a word."""
    if lost_m2 >= LEFT_OUT_MIN_M2:
        _LOG.warning("%s: %.0f of %.0f m2 %s left out: %s", where, lost_m2, all_m2, what, why)


def checked_floor(free: Array, resolution_m: float, where: str) -> Array:
    """The largest part of the floor. Raises MapError if it goes around the building, is a pattern, or is too large.

    free: (rows, columns) bool. Named, in warnings, are floor at the border of the picture and floor that is left out.
    """
    if (pixels := int(free.sum())) > FLOOR_CELLS_MAX:
        raise MapError(f"{where}: {pixels} pixels of floor, {FLOOR_CELLS_MAX} are possible; make the picture coarser")
    box = _box(free, 1)
    piece = free[box]
    edges = int((piece[1:] != piece[:-1]).sum() + (piece[:, 1:] != piece[:, :-1]).sum())
    if edges > EDGES_MAX:
        raise MapError(
            f"{where}: {edges} edges of pixels between floor and walls, {EDGES_MAX} are possible: it is a photo or a "
            "pattern; draw the floor in plain white and the walls in plain black"
        )
    labels, sizes = parts(piece)
    kept = np.zeros_like(free)
    kept[box] = _largest_of(labels, sizes)
    border = np.concatenate([kept[0], kept[-1], kept[1:-1, 0], kept[1:-1, -1]])
    if border.mean() > _OUTSIDE_SHARE and _has_inside_walls(kept):
        raise MapError(
            f"{where}: the floor reaches {border.sum()} of {border.size} pixels of the picture's border, so that the "
            "outside is floor: close the gaps of the outer wall, or paint the outside dark"
        )
    if border.any():
        _LOG.warning(
            "%s: the floor reaches the border of the picture at %d of %d pixels, where a wall is assumed; check that "
            "the outer wall has no gap", where, border.sum(), border.size,
        )  # fmt: skip
    outside = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    sizes[outside[outside > 0] - 1] = 0
    lost = sizes[sizes * resolution_m**2 >= LEFT_OUT_MIN_M2].sum() - (0 if border.any() else kept.sum())
    all_m2 = (kept.sum() + lost) * resolution_m**2
    name_left_out(where, lost * resolution_m**2, all_m2, f"not connected; draw doors of at least {STRIP_M:g} m")
    return kept


def _has_inside_walls(free: Array) -> bool:
    """Whether anything is drawn apart from the border."""
    return bool((~free[1:-1, 1:-1]).any())


def name_marks(free: Array, resolution_m: float, where: str) -> None:
    """Warn of small obstacles that stand free on a floor (rows, columns) of one part, as letters do."""
    labels, _ = ndimage.label(~free[_box(free, math.ceil(_MARK_MAX_M / resolution_m) + 1)], np.ones((3, 3)))
    sizes = [max(box[0].stop - box[0].start, box[1].stop - box[1].start) for box in ndimage.find_objects(labels)]
    count = int((np.array(sizes, float) * resolution_m <= _MARK_MAX_M).sum())
    if count >= _MARKS_MIN:
        _LOG.warning(
            "%s: %d shapes of at most %g m stand free on the floor and become walls; if they are writing, erase it",
            where, count, _MARK_MAX_M,
        )  # fmt: skip


def _box(free: Array, margin: int) -> tuple[slice, slice]:
    """Where the free cells lie in a picture, which is mostly grey if it is large, with a margin where there is room.

    With a margin, what lies around the floor is connected and no small obstacle.
    """
    pieces = []
    for axis in (1, 0):
        taken = np.flatnonzero(free.any(axis=axis))
        begin, end = (int(taken[0]), int(taken[-1]) + 1) if len(taken) else (0, 0)
        pieces.append(slice(max(begin - margin, 0), end + margin))
    return pieces[0], pieces[1]


def free_edges(free: Array) -> Array:
    """Free cells (rows, columns) -> (walls, 2, 2) their outline as straight runs, in cells."""
    padded = np.pad(free, 1)
    horizontal = _runs(padded[1:] != padded[:-1])
    vertical = _runs((padded[:, 1:] != padded[:, :-1]).T)
    lying = np.stack([horizontal[:, [1, 0]], horizontal[:, [2, 0]]], axis=1)
    standing = np.stack([vertical[:, [0, 1]], vertical[:, [0, 2]]], axis=1)
    # Line k of the padded differences is the lower edge of cell k; columns of the padding count from -1.
    return np.concatenate([lying - np.array([1, 0]), standing - np.array([0, 1])]).astype(float)


def largest_part(free: Array) -> Array:
    """(rows, columns) bool: only the largest 4-connected part of the free cells, of equal ones the first."""
    return _largest_of(*parts(free))


def _largest_of(labels: Array, sizes: Array) -> Array:
    return labels == np.argmax(sizes) + 1 if len(sizes) else np.zeros(labels.shape, bool)


def parts(free: Array, neighbours: Array | None = None) -> tuple[Array, Array]:
    """The parts of the free cells: labels (rows, columns) from 1, and the parts' sizes in cells.

    Cells are 4-connected unless `neighbours` (3, 3) says otherwise.
    """
    labels, _ = ndimage.label(free, neighbours)
    return labels, np.bincount(labels.ravel())[1:]


def deepest_cell(free: Array) -> tuple[int, int]:
    """(row, column) of a free cell with the largest distance to non-free cells."""
    depth = _depth(np.ascontiguousarray(np.pad(free, 1)))[1:-1, 1:-1]
    row, column = np.unravel_index(np.argmax(depth), depth.shape)
    return int(row), int(column)


def read_grey(path: Path, behind: int = 0) -> Array:
    """(rows, columns) uint8, row 0 at the top. Pillow reads formats other than PGM; alpha is blended with grey
    `behind`.

    Raises MapError if the file cannot be read or is too large.
    """
    raw = load_bytes(path, "picture")
    if ".pgm" in [suffix.lower() for suffix in path.suffixes][-2:]:
        return _decode_pgm(raw, path.name)
    return _decode_with_pillow(raw, path, behind)


def _decode_with_pillow(raw: bytes, path: Path, behind: int) -> Array:
    try:
        from PIL import Image, UnidentifiedImageError
    except ImportError as error:
        raise MapError(f"reading {path.name} needs Pillow; run `pip install 'twc_env[viz]'`, or use .pgm") from error
    try:
        with warnings.catch_warnings(), Image.open(io.BytesIO(raw), formats=("PNG", "PPM", "JPEG", "BMP")) as picture:
            warnings.simplefilter("error")
            if picture.width * picture.height > CELLS_MAX:
                raise ValueError(f"{picture.width} x {picture.height} pixels are too many")
            if picture.mode.startswith("I"):  # greys of 16 bits
                return np.round(np.asarray(picture, float) * (255 / 65535)).astype(np.uint8)
            if picture.mode in ("L", "RGB", "1") and "transparency" not in picture.info:
                return np.asarray(picture.convert("L"))
            pixels = np.asarray(picture.convert("RGBA"), dtype=float)
    except Exception as error:  # a broken picture surfaces as almost any exception
        reason = "it holds no picture" if isinstance(error, UnidentifiedImageError) else error
        raise MapError(f"cannot read the picture {path}: {reason}; save it again as png or pgm") from error
    cover = pixels[..., 3] / 255
    return (pixels[..., :3].mean(axis=-1) * cover + behind * (1.0 - cover)).astype(np.uint8)


def _decode_pgm(raw: bytes, where: str) -> Array:
    """P5 (binary) and P2 (text), 8 or 16 bit, comments allowed; values are scaled to 0..255."""
    incomplete = f"{where} is not a complete PGM image (P5 or P2); export it again"
    header = _PGM_HEADER.match(raw)
    if header is None:
        raise MapError(incomplete)
    at, (columns, rows, white) = header.end(), map(int, header.group(2, 3, 4))
    if min(columns, rows) < 1 or not 0 < white < 65536:
        raise MapError(incomplete)
    if rows * columns > CELLS_MAX:
        raise MapError(f"{where} has {columns} x {rows} pixels, more than {CELLS_MAX}; cut it or make it coarser")
    try:
        if header[1] == b"P2":
            pixels = np.array(raw[at:].split()[: rows * columns], dtype=float)
        else:
            pixels = np.frombuffer(raw, "u1" if white < 256 else ">u2", rows * columns, at + 1).astype(float)
        pixels = pixels.reshape(rows, columns)
    except ValueError:
        raise MapError(incomplete) from None
    if not np.isfinite(pixels).all():
        raise MapError(incomplete)
    return np.round(np.clip(pixels / white, 0, 1) * 255).astype(np.uint8)


def _runs(edges: Array) -> Array:
    """(lines, n) bool -> (runs, 3) int: line, begin and end of each run of True."""
    flips = np.diff(np.pad(edges, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    lines, begins = np.nonzero(flips == 1)
    _, ends = np.nonzero(flips == -1)
    return np.column_stack([lines, begins, ends])


def _without_specks(free: Array, resolution_m: float) -> Array:
    """Fill areas enclosed by free space that are too small to be obstacles."""
    labels, sizes = parts(~np.pad(free, 1), np.ones((3, 3)))
    small = np.append(False, sizes * resolution_m**2 < SPECK_M2)
    filled: Array = small[labels]
    return free | filled[1:-1, 1:-1]


def _without_strips(free: Array, resolution_m: float) -> Array:
    """The area that a square slightly wider than STRIP_M covers (a morphological opening)."""
    side = int(STRIP_M / resolution_m + 1e-6) + 1
    if min(free.shape) < side:
        return np.zeros_like(free)
    fits = _of_squares(np.logical_and, free, side)
    return _of_squares(np.logical_or, np.pad(fits, side - 1), side)


def _of_squares(operation: np.ufunc, cells: Array, side: int) -> Array:
    """(r, c) bool -> (r - side + 1, c - side + 1): all or any of the cells of each square."""
    rows, columns = (count - side + 1 for count in cells.shape)
    lying = cells[:, :columns].copy()
    for k in range(1, side):
        operation(lying, cells[:, k : k + columns], out=lying)
    out = lying[:rows].copy()
    for k in range(1, side):
        operation(out, lying[k : k + rows], out=out)
    return out


@kernel
def _depth(free):
    """Chamfer distance of each free cell to the nearest other, in thirds of a cell; the border must not be free."""
    rows, columns = free.shape
    depth = np.where(free, np.int32(1 << 30), np.int32(0))
    for r in range(1, rows - 1):
        for c in range(1, columns - 1):
            near = min(depth[r - 1, c] + 3, depth[r, c - 1] + 3, depth[r - 1, c - 1] + 4, depth[r - 1, c + 1] + 4)
            depth[r, c] = min(depth[r, c], near)
    for r in range(rows - 2, 0, -1):
        for c in range(columns - 2, 0, -1):
            near = min(depth[r + 1, c] + 3, depth[r, c + 1] + 3, depth[r + 1, c + 1] + 4, depth[r + 1, c - 1] + 4)
            depth[r, c] = min(depth[r, c], near)
    return depth
