"""The errors twc_env raises: every message names the value, what was expected and what to do."""

import difflib
from collections.abc import Iterable


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """What ends a message about an unknown name: the nearest of those known, "" where none is near."""
    near = difflib.get_close_matches(str(name), list(known), n=1)
    return f"; did you mean {near[0]!r}?" if near else ""


class TwcError(ValueError):
    """Base of all errors that twc_env raises on bad input; always one line, whatever value it names."""

    def __init__(self, message: object = ""):
        super().__init__(" ".join(line.strip() for line in str(message).splitlines()))


class ConfigError(TwcError):
    """A configuration key is unknown, or its value has the wrong type or is out of range."""


class ArgumentError(ConfigError, TypeError):
    """A call has an argument that there is not; tools that try arguments, as TorchRL does, wait for a TypeError."""


class MapError(TwcError):
    """A floor plan cannot be read, or it describes no building a robot can explore."""


class DataError(TwcError):
    """A log, checkpoint or run folder cannot be read."""


class WorkerError(TwcError):
    """A process that worked for this one has died."""


class ActionError(TwcError):
    """An action has the wrong shape or a value that is not finite."""
