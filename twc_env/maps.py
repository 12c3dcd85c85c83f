"""Floor plans by name or by file: the one door through which buildings come in."""

from __future__ import annotations

import difflib
from functools import lru_cache
from pathlib import Path

from twc_env.config.checks import whole_number
from twc_env.errors import MapError
from twc_env.world.floorplan import Floorplan
from twc_env.world.floorplan_check import validate
from twc_env.world.floorplan_file import floorplan_from_values, load_json, read_floorplan

_SUFFIXES = (".json", ".geojson", ".yaml", ".yml", ".png", ".pgm", ".gz")
_INSTALLED, _CHECKOUT = Path(__file__).parent / "maps", Path(__file__).parent.parent / "maps"


def bundled_folder() -> Path:
    """Where the bundled maps lie: in an installed package, or else in a checkout."""
    return _INSTALLED if _INSTALLED.is_dir() else _CHECKOUT


def map_names() -> tuple[str, ...]:
    """Names of the bundled maps: files, and twins that are drawn by code."""
    from twc_env.world.twins import RADIO_TWINS

    return tuple(sorted((*_bundled(), *RADIO_TWINS)))


def load_map(name_or_path: str | Path, seed: int = 0) -> Floorplan:
    """A map by name or from a file.

    Names: a bundled map (`twin-01`), a generated building (`gen:office:800:7`: kind, floor area in m2, seed) or one
    of a fixed split (`train/0007`). Files: twc_env or HouseExpo .json, ROS .yaml, indoor .geojson (`FILE#LEVEL` for
    one level), .png or .pgm picture; all but .yaml also packed as .gz.
    Formats without signs and access points are furnished by `seed`. Plans are cached and shared: they are read-only.
    Raises MapError for an unknown name, an unknown suffix or a plan no robot can explore, ConfigError for a seed that
    is no whole number from 0 on.
    """
    name, seed = str(name_or_path), whole_number("seed", seed, 0)
    bundled = _bundled()
    if name in bundled:
        return _read_native(bundled[name], bundled[name].stat().st_mtime_ns)
    plan = _drawn_by_code(name)
    if plan is not None:
        return plan
    path, level = _file(name)
    if path is None:
        raise MapError(_in_folder(Path(name)) if _is_folder(name) else _unknown(name))
    try:
        return _read_file(path, _written(path), seed, level)
    except (RecursionError, MemoryError) as error:
        raise MapError(f"{path.name} is too deeply nested or too large to be a map; export it again") from error


def schema() -> dict:
    """The JSON schema of the native format, `twc_env/floorplan-1`."""
    values = load_json(Path(__file__).parent / "floorplan.schema.json")
    assert isinstance(values, dict)
    return values


def _drawn_by_code(name: str) -> Floorplan | None:
    from twc_env.world.splits import generate_by_name
    from twc_env.world.twins import RADIO_TWINS, radio_twin

    return radio_twin(name) if name in RADIO_TWINS else generate_by_name(name)


def _file(name: str) -> tuple[Path | None, str | None]:
    """A file and the level asked for; (None, None) when there is no such file."""
    base, _, level = name.rpartition("#")
    for text, asked in ((name, None), (base, level)):
        try:
            if text and Path(text).is_file():
                return Path(text), asked
        except (OSError, ValueError):  # no file can have that name
            continue
    return None, None


def _is_folder(name: str) -> bool:
    try:
        return Path(name).is_dir() and bool(name)
    except (OSError, ValueError):  # nothing can have that name
        return False


def _in_folder(folder: Path) -> str:
    try:
        files = sorted(path.name for path in folder.iterdir() if path.suffix in _SUFFIXES and path.is_file())
    except OSError as error:
        return f"{folder} is a folder that cannot be read: {error.strerror}; name a map file"
    found = f"it holds {', '.join(files[:5])}{' ...' if len(files) > 5 else ''}" if files else "it holds none"
    return f"{folder} is a folder: name a map file in it; {found}"


def _unknown(name: str) -> str:
    from twc_env.world.splits import is_of_split

    names, lower = map_names(), name.lower()
    split, _, number = lower.partition("/")
    drawn = [recipe for recipe in (lower, f"{split}/{number:0>4}") if is_of_split(recipe) or recipe.startswith("gen:")]
    near = drawn or difflib.get_close_matches(lower, names, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return (
        f"no map named {name!r} and no such file; {hint}bundled maps: {', '.join(names)}; "
        "generated ones: gen:office:800:7, train/0007"
    )


def _bundled() -> dict[str, Path]:
    return {path.stem: path for path in bundled_folder().glob("*.json")}


@lru_cache(maxsize=32)
def _read_native(path: Path, modified: int) -> Floorplan:
    return read_floorplan(path)


def _written(path: Path) -> tuple[int, ...]:
    """When a file, and what may be read with it, was written last: the size of a floor, or the picture of a ROS map."""
    beside = [path.with_name("floor_info.json")]
    if path.suffix.lower() in (".yaml", ".yml"):
        beside = sorted(path.parent.glob("*.p[gn][mg]*"))
    return tuple(each.stat().st_mtime_ns for each in (path, *beside) if each.is_file())


@lru_cache(maxsize=8)
def _read_file(path: Path, modified: tuple[int, ...], seed: int, level: str | None) -> Floorplan:
    suffixes = [suffix.lower() for suffix in path.suffixes if suffix.lower() != ".gz"]
    suffix = suffixes[-1] if suffixes else ""
    if suffix in (".json", ".geojson"):
        return _read_json(path, seed, level)
    if level is not None:
        raise MapError(f"{path.name}#{level}: only .geojson maps have levels; leave #{level} out")
    if suffix in (".yaml", ".yml"):
        from twc_env.datasets.ros_map import read_ros_map

        return read_ros_map(path, seed)
    if suffix in (".png", ".pgm"):
        from twc_env.datasets.picture import read_picture

        return read_picture(path, seed)
    raise MapError(f"{path.name}: unknown map format {suffix!r}; use .json, .yaml, .png, .pgm or .geojson (.gz)")


def _read_json(path: Path, seed: int, level: str | None) -> Floorplan:
    values = load_json(path)
    if isinstance(values, dict) and values.get("type") in ("FeatureCollection", "Feature", "Polygon", "MultiPolygon"):
        from twc_env.datasets.geojson import geojson_plan

        return geojson_plan(values, path, seed, "0" if level is None else level)
    if level is not None:
        raise MapError(f"{path.name}#{level}: only .geojson maps have levels; leave #{level} out")
    if isinstance(values, dict) and "verts" in values:
        from twc_env.datasets.house_expo import house_expo_plan

        return house_expo_plan(values, path.name, seed)
    return validate(floorplan_from_values(values, path.name))
