"""The errors twc_env raises: every message names the value, what was expected and what to do."""

import difflib
from collections.abc import Iterable

_LINE_MAX = 1200
"""Characters of a message; of longer ones, which name values without end, the middle is left out."""
_MEANT_MAX, _FEW = 3, 8
"""More names than the first are no suggestion, more than the second too many to list beside one."""

UNFIT = (TypeError, ValueError, OverflowError, RecursionError)
"""What reading or converting a value from outside may raise: of another type, no number, beyond what a float holds, or
nested too deeply."""


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """End of a message about an unknown name: the most similar known name, or else the few that contain it or begin
    with the same four letters, or "" if there are none."""
    names, typed = list(known), str(name).lower()
    around = [whole for whole in names if len(typed) > 2 and typed in whole.lower()]
    alike = [whole for whole in names if len(typed) > 3 and whole.lower().startswith(typed[:4])]
    near = difflib.get_close_matches(str(name), names, n=1) or (around if len(around) == 1 else alike)
    return f"; did you mean {' or '.join(map(repr, near))}?" if 0 < len(near) <= _MEANT_MAX else ""


def one_of(name: object, known: Iterable[str], among: str = "known are") -> str:
    """End of a message about an unknown name: what it probably means, and all known names if they are few or nothing
    is alike."""
    names = list(known)
    near = did_you_mean(name, names)
    return f"; {among} {', '.join(names)}{near}" if names and (not near or len(names) <= _FEW) else near


class TwcError(ValueError):
    """Base class of all errors that twc_env raises on bad input; the message is always one line."""

    def __init__(self, message: object = ""):
        line = " ".join(line.strip() for line in str(message).splitlines())
        super().__init__(line if len(line) <= _LINE_MAX else f"{line[: _LINE_MAX // 2]} ... {line[-_LINE_MAX // 4 :]}")


class ConfigError(TwcError):
    """A configuration key is unknown, or its value has the wrong type or is out of range."""


class ArgumentError(ConfigError, TypeError):
    """A call has an unknown argument; tools that probe arguments, such as TorchRL, expect a TypeError."""


class MapError(TwcError):
    """A floor plan cannot be read, or describes no building that a robot can explore."""


class DataError(TwcError):
    """A log, checkpoint or run folder cannot be read."""


class WorkerError(TwcError):
    """A worker process has died."""


class ActionError(TwcError):
    """An action has the wrong shape or a value that is not finite."""
