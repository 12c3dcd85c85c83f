"""Times as tables write them: ISO 8601, or dates with the year last, with the day or the month first."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import DataError

_DATE = re.compile(
    r"(\d{1,2})([./-])(\d{1,2})\2(\d{4})[ T,]+(\d{1,2}):(\d\d)(?::(\d\d(?:[.,]\d+)?))?(?: ?([AaPp])[Mm])?"
)
"""Date with the year last, and time of day."""
_TIME_OF_DAY = re.compile(r"\d{1,2}:\d\d(?!\d)")
_MONTHS = 12


def is_time_of_day(cell: str) -> bool:
    """Whether a cell begins with hours and minutes."""
    return _TIME_OF_DAY.match(cell.strip()) is not None


def written_times_s(
    cells: Sequence[str], lines: Sequence[int], order: str | None, path: str | Path
) -> tuple[Array, bool]:
    """Unix times of cells (k,) [s], and whether all name their time zone; the others are taken for UTC.

    lines (k,): of the file, to name them in errors. order: "dmy" or "mdy", which the user says, or None. Raises
    DataError for a cell that is no time, and for dates that can be either.
    """
    is_day_first = _is_day_first(cells, order, path)
    moments = [
        _moment(cell.strip(), is_day_first, f"{path}, row {line}") for cell, line in zip(cells, lines, strict=True)
    ]
    times_s = np.array([(m if m.tzinfo else m.replace(tzinfo=UTC)).timestamp() for m in moments])
    return times_s, all(moment.tzinfo is not None for moment in moments)


def _is_day_first(cells: Sequence[str], order: str | None, path: str | Path) -> bool | None:
    """Whether dates such as 01/05/2026 begin with the day; None if there are none. With points they do, unless the user
    says otherwise."""
    dates = [match for match in (_DATE.fullmatch(cell.strip()) for cell in cells) if match]
    if not dates:
        return None
    if order is None and dates[0][2] == ".":
        return True
    can = {
        "dmy": all(int(date[3]) <= _MONTHS for date in dates),
        "mdy": all(int(date[1]) <= _MONTHS for date in dates),
    }
    if order is None and all(can.values()):
        shown = dates[0][0]
        raise DataError(
            f"{path}: the date {shown!r} can be day or month first; give --units date=dmy or --units date=mdy"
        )
    return order == "dmy" if order else can["dmy"]


def _moment(cell: str, is_day_first: bool | None, where: str) -> datetime:
    date = _DATE.fullmatch(cell)
    try:
        if date and is_day_first is not None:
            return _of_date(date, is_day_first)
        return datetime.fromisoformat(cell.replace("/", "-"))
    except (ValueError, OverflowError) as error:
        needed = "a column date beside it" if is_time_of_day(cell) else "seconds"
        raise DataError(f"{where}: {cell[:40]!r} is no time; give {needed}, or 2026-05-01T12:00:00.5Z") from error


def _of_date(date: re.Match[str], is_day_first: bool) -> datetime:
    """Time of a match of `_DATE`."""
    first, _, second, year, hour, minute, seconds, half = date.groups()
    day, month = (first, second) if is_day_first else (second, first)
    hours = int(hour) % 12 + 12 * (half in "Pp") if half else int(hour)
    whole = datetime(int(year), int(month), int(day), hours, int(minute))
    return whole + timedelta(seconds=float((seconds or "0").replace(",", ".")))
