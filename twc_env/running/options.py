"""Options that several commands have, what they stand for, and types of arguments."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from twc_env.errors import ConfigError, DataError
from twc_env.records.json_values import check_folder

if TYPE_CHECKING:
    from twc_env.config import EnvConfig

PICTURE_FORMATS = ("png", "pdf", "svg")
SEEDS_MAX = 100_000
"""Largest range of seeds on a command line."""
SEED_DIGITS_MAX = 20
"""Longer numbers are no seeds of any library."""


def add_pictures(parser: argparse.ArgumentParser) -> None:
    """The options `--format` and `--dpi` of commands that write pictures, which `picture_options` reads."""
    parser.add_argument("--format", type=_picture_format, default="png", metavar="{png,pdf,svg}", help="of pictures")
    parser.add_argument("--dpi", type=number(20, 1200), help="of pictures: dots per inch (default: 130)")


def _picture_format(text: str) -> str:
    if text not in PICTURE_FORMATS:
        remedy = "; for no pictures say --no-pictures" if text == "none" else ""
        raise argparse.ArgumentTypeError(f"must be one of {', '.join(PICTURE_FORMATS)}; got {text!r}{remedy}")
    return text


def picture_options(options: argparse.Namespace) -> tuple[str, float | None] | None:
    """Format and dpi of pictures; None with --no-pictures or without matplotlib."""
    if getattr(options, "no_pictures", False) or find_spec("matplotlib") is None:
        return None
    return getattr(options, "format", "png"), getattr(options, "dpi", None)


def add_set(parser: argparse.ArgumentParser) -> None:
    """The option `--set`, which `assignments` reads."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override a setting, e.g. lidar.beam_count=90; repeatable (list: twc-env settings)",
    )


def assignments(texts: Sequence[str]) -> dict[str, object]:
    """`KEY=VALUE` texts of the command line as a dictionary of texts; of a key that is there twice, the last.

    Raises ConfigError for a text of another form. Keys and values are checked by `twc_env.config.override`.
    """
    pairs = [text.partition("=") for text in texts]
    for text, (key, separator, _) in zip(texts, pairs, strict=True):
        if not separator or not key:
            raise ConfigError(f"--set takes KEY=VALUE, for example lidar.beam_count=360; got {text!r}")
    return {key: value for key, _, value in pairs}


def add_config(parser: argparse.ArgumentParser) -> None:
    """The option `--config`, which `config_of` reads."""
    parser.add_argument(
        "--config", metavar="FILE", help="settings: TOML, JSON, a run folder or a task such as twc/ExploreHard-v0"
    )


def add_ray(parser: argparse._ActionsContainer, more: str = "") -> None:
    """The option `--ray`. Commands that also have `--jobs` call `refuse_jobs_with_ray`."""
    parser.add_argument(
        "--ray",
        metavar="ADDRESS",
        help="play on a Ray cluster, HOST:PORT; auto: the one this machine belongs to, or a local one (pip install "
        f"'twc_env[ray]'){more}",
    )


def refuse_jobs_with_ray(options: argparse.Namespace) -> None:
    """Raise ConfigError for `--jobs` beside `--ray`."""
    if options.ray is not None and options.jobs != 1:
        raise ConfigError(f"--jobs {options.jobs}: a Ray cluster uses all of its cores; leave it out with --ray")


def refuse_ignored(options: argparse.Namespace, names: Iterable[str], why: str) -> None:
    """Raise DataError for the first of these options that was given, as it would be ignored. `why` says so, in words
    that follow the option. None, False and an empty list are options that were not given."""
    for name in names:
        value = getattr(options, name, None)
        if value is None or value is False or value == []:
            continue
        told = " ".join(map(str, value)) if isinstance(value, list) else value
        shown = "" if value is True else f" {told}"
        raise DataError(f"--{name.replace('_', '-')}{shown}: {why}; leave it out")


def add_allow_code(parser: argparse.ArgumentParser) -> None:
    """The option `--allow-code`, see `refuse_code`."""
    parser.add_argument(
        "--allow-code",
        action="store_true",
        help="execute the Python files that settings of a file, log or run folder name (FILE.py:CLASS), as those of "
        "--set always are",
    )


def refuse_code(config: EnvConfig, source: str | Path, asked: Iterable[str] = ()) -> None:
    """Raise ConfigError if settings read from `source` name Python files to execute, apart from the settings `asked`,
    which the user's own command line replaces. A file that somebody else wrote must not choose what is executed."""
    from twc_env.config import code_named_in

    named = [f"{key}={name}" for key, name in code_named_in(config).items() if key not in set(asked)]
    if named:
        raise ConfigError(
            f"{source} names code to execute ({', '.join(named)}): if you trust it, add --allow-code or the same by "
            "--set; if not, choose another by --set"
        )


def config_of(name: str | None) -> EnvConfig:
    """The settings that `--config` names: a standard task, a TOML or JSON file, or a run folder; without it the
    defaults. Raises ConfigError."""
    from twc_env.config import EnvConfig, load
    from twc_env.tasks import task_config

    if name is None:
        return EnvConfig()
    return task_config(name) if name.startswith("twc/") else load(name)


def add_json(parser: argparse.ArgumentParser, more: str = "") -> None:
    """The option `--json`, for `write_json`; more: what else is written then."""
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help=f"also write the results as JSON{more}; - for the terminal"
    )


def add_lasting(parser: argparse.ArgumentParser) -> None:
    """The options `--prior` and `--save`: maps that last from session to session."""
    parser.add_argument(
        "--prior", type=Path, metavar="FILE", help="begin with a map saved earlier; robots start anywhere in it"
    )
    parser.add_argument(
        "--save",
        type=Path,
        metavar="FILE",
        help="write the map (.npz: keyframes, pose graph, grid) for later sessions; with --prior old and new as one",
    )


def prior_setting(options: argparse.Namespace) -> dict[str, str]:
    """The setting that `--prior` stands for; none without it. Raises DataError if `--save` cannot be written."""
    if options.save is not None:
        check_folder(options.save.parent)
        if options.save.is_dir():
            raise DataError(f"cannot write the map to {options.save}: it is a folder; name a file")
    return {} if options.prior is None else {"slam.prior": str(options.prior)}


def add_folder(parser: argparse.ArgumentParser, option: str, default: str, what: str) -> None:
    """An option that names a folder."""
    parser.add_argument(option, type=Path, default=Path(default), metavar="FOLDER", help=what)


def count(text: str) -> int:
    """A number of things, from 1 on, as an argument's type."""
    return _whole_number(text, 1)


def natural(text: str) -> int:
    """A whole number from 0 on, as an argument's type."""
    return _whole_number(text, 0)


def _whole_number(text: str, least: int) -> int:
    if not (text.isascii() and text.isdigit()) or int(text) < least:
        raise argparse.ArgumentTypeError(f"must be a whole number of at least {least}; got {text!r}")
    return int(text)


def number(least: float, most: float) -> Callable[[str], float]:
    """The type of an argument of argparse that is a number from `least` to `most`, both allowed."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"must be a number from {least:g} to {most:g}; got {text!r}")
        return value

    return read


def parse_seeds(text: str) -> tuple[int, ...]:
    """Seeds of a list such as 0-3,7 -> (0, 1, 2, 3, 7). Raises ConfigError for other texts and huge ranges."""
    seeds: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise ConfigError(f"seeds must be numbers and ranges such as 0-9 or 1,4,7-9; got {text!r}")
        if max(len(first), len(last)) > SEED_DIGITS_MAX:
            raise ConfigError(f"a seed has at most {SEED_DIGITS_MAX} digits; got one of {max(len(first), len(last))}")
        begin, end = int(first), int(last if dash else first) + 1
        if end <= begin:
            raise ConfigError(f"seeds must be numbers and ranges such as 0-9 or 1,4,7-9; got {text!r}")
        if end - begin > SEEDS_MAX:
            raise ConfigError(f"a range holds at most {SEEDS_MAX} seeds; got {part.strip()}")
        seeds += range(begin, end)
    return tuple(dict.fromkeys(seeds))
