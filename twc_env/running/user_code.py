"""Exceptions in code that a user names as FILE.py:CLASS: told with the user's own line first."""

from __future__ import annotations

import re
import traceback
from pathlib import Path

from twc_env.records.class_file import is_user_file

_FRAME = re.compile(r'^\s*File "(?P<file>.+)", line (?P<line>\d+), in (?P<where>.+)\n(?P<source>.*)', re.MULTILINE)


def told_of_user_code(error: BaseException) -> str | None:
    """The exception with the user's frames, innermost first, also one that comes from a worker process; None if it was
    not raised in, or below, code of a user."""
    if isinstance(error, SyntaxError) and error.filename and is_user_file(Path(error.filename)):
        source = (error.text or "").strip()
        return f"error in your code: {error.filename}, line {error.lineno}\n    {source}\nSyntaxError: {error.msg}\n"
    frames = [
        (found["file"], found["line"], found["where"], found["source"].strip())
        for found in _FRAME.finditer("".join(traceback.format_exception(error)))
        if not found["file"].startswith("<") and is_user_file(Path(found["file"]))  # <frozen importlib._bootstrap>
    ]
    if not frames:
        return None
    frames = [frame for frame, outer in zip(frames, [None, *frames], strict=False) if not _is_on_line_of(outer, frame)]
    lines = []
    for k, (file, line, where, source) in enumerate(reversed(frames)):
        lines.append(f"{'called from' if k else 'error in your code:'} {file}, line {line}, in {where}\n    {source}\n")
    kind = "".join(traceback.format_exception_only(error)).strip()
    return f"{lines[0]}{kind}\n{''.join(lines[1:])}"


def _is_on_line_of(outer: tuple[str, ...] | None, frame: tuple[str, ...]) -> bool:
    """Whether a frame is a comprehension or a lambda in the line from which it is called."""
    return outer is not None and frame[:2] == outer[:2] and frame[2].startswith("<")
