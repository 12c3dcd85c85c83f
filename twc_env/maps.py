"""Floor plans by name or by file: the one door through which buildings come in."""

from __future__ import annotations

import difflib
import json
from functools import lru_cache
from pathlib import Path

from twc_env.errors import MapError
from twc_env.world.floorplan import Floorplan, floorplan_from_values, read_floorplan, validate

_FOLDERS = (Path(__file__).parent / "maps", Path(__file__).parent.parent / "maps")
"""Where the bundled maps lie: in an installed package, and in a checkout."""


def map_names() -> tuple[str, ...]:
    """Names of the bundled maps."""
    return tuple(sorted(_bundled()))


def load_map(name_or_path: str | Path, seed: int = 0) -> Floorplan:
    """A bundled map by name, or a file: twc_env or HouseExpo .json, ROS .yaml, .png or .pgm (.gz) picture.

    Formats without signs and access points are furnished by `seed`. Plans are cached and shared: they are read-only.
    Raises MapError for an unknown name, an unknown suffix or a plan no robot can explore.
    """
    name = str(name_or_path)
    bundled = _bundled()
    if name in bundled:
        return _read_native(bundled[name], bundled[name].stat().st_mtime_ns)
    path = Path(name)
    if not path.is_file():
        near = difflib.get_close_matches(name, bundled, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise MapError(
            f"no map named {name!r} and no such file; {hint}bundled maps: {', '.join(sorted(bundled)) or 'none'}"
        )
    return _read_file(path, path.stat().st_mtime_ns, seed)


def _bundled() -> dict[str, Path]:
    folder = next((folder for folder in _FOLDERS if folder.is_dir()), None)
    return {path.stem: path for path in folder.glob("*.json")} if folder else {}


@lru_cache(maxsize=32)
def _read_native(path: Path, modified: int) -> Floorplan:
    return read_floorplan(path)


@lru_cache(maxsize=8)
def _read_file(path: Path, modified: int, seed: int) -> Floorplan:
    suffixes = [suffix.lower() for suffix in path.suffixes if suffix.lower() != ".gz"]
    suffix = suffixes[-1] if suffixes else ""
    if suffix == ".json":
        return _read_json(path, seed)
    if suffix in (".yaml", ".yml"):
        from twc_env.datasets.ros_map import read_ros_map

        return read_ros_map(path, seed)
    if suffix in (".png", ".pgm"):
        from twc_env.datasets.raster import read_picture

        return read_picture(path, seed)
    raise MapError(f"{path.name}: unknown map format {suffix!r}; use .json, .yaml, .png or .pgm (.gz)")


def _read_json(path: Path, seed: int) -> Floorplan:
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise MapError(f"{path} is not valid JSON: {error}; fix it or export it again") from error
    if isinstance(values, dict) and "verts" in values:
        from twc_env.datasets.house_expo import house_expo_plan

        return house_expo_plan(values, path.name, seed)
    return validate(floorplan_from_values(values, path.name))
