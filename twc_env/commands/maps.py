"""Command line: twc-env maps list | show | generate | import | export | merge | check | schema."""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from twc_env.errors import MapError
from twc_env.records.json_values import check_writable, write_json
from twc_env.records.text_tables import aligned_text
from twc_env.running.argument_parser import Fill
from twc_env.running.options import add_folder, add_json, add_pictures, count, natural
from twc_env.running.terminal import show_count, terminal_width

if TYPE_CHECKING:
    from twc_env.world.building.floorplan import Floorplan

_FILES = (
    ".json (twc_env, HouseExpo), .yaml (ROS map_server), .png, .pgm, .geojson (indoor-location-competition-20 with "
    "floor_info.json beside it; OpenStreetMap, or IMDF units with opening.geojson beside them: FILE#LEVEL); .gz too"
)
_NAMES = f"""\
A MAP is
  a bundled name         twin-01, sfw-e3, radio-ntu ... (see: twc-env maps list)
  a generated building   gen:KIND:AREA:SEED, for example gen:office:800:7
  a building of a split  train/0000 ... train/0999, validation/0000 ..., test/0000 ... test/0099
  a file                 {_FILES}
"""


def add_arguments(maps: argparse.ArgumentParser) -> None:
    """Fill the parser of the command, which has commands of its own."""
    maps.description = "Floor plans: list, draw, generate, import, export and check them."
    maps.epilog = "examples:\n  twc-env maps list\n  twc-env maps show gen:ward:600:2\n\n" + _NAMES
    maps.set_defaults(run=_list, maps=[])
    parts = maps.add_subparsers(metavar="COMMAND")

    text = "list sizes and contents of the bundled maps, or of the given ones"
    listing = _part(parts, "list", _list, text, ["list twin-01 gen:office:800:7"])
    listing.add_argument("maps", nargs="*", metavar="MAP", help="default: all bundled maps")

    text = "draw a map: walls, rooms, signs, access points and signal strength"
    show = _part(parts, "show", _show, text, ["show test/0003 --out building.png"])
    show.add_argument("map", metavar="MAP", help="see below")
    show.add_argument(
        "--out", type=Path, metavar="FILE", help=".png, .pdf or .svg (default: the map's name in the current folder)"
    )
    add_pictures(show)
    show.add_argument("--no-signal", action="store_true", help="omit the signal-strength overlay")
    _seed(show)

    text = "generate buildings of a kind, area and seed, and write them as native JSON"
    more = "\nThe same building can be used without a file, as the map gen:office:800:7."
    _part(
        parts, "generate", _generate, text, ["generate office 800 --seed 7 --out office.json"], more, fill=_add_building
    )

    text = "convert a file of another format to native JSON, after checking it"
    more = "\nIf the format has no signs and access points, they are generated from --seed. The JSON can be edited."
    bring = _part(parts, "import", _import, text, ["import plan.png --resolution 0.02 --out plan.json"], more)
    bring.add_argument("map", metavar="FILE", help="a file, or FILE#LEVEL for one level of an OpenStreetMap building")
    bring.add_argument(
        "--resolution", type=float, metavar="M", help="metres per pixel of a .png or .pgm (default: 0.05)"
    )
    bring.add_argument("--out", type=Path, metavar="FILE.json", help="default: the file's stem in the current folder")
    _seed(bring)

    text = "write a map as .json (native), .yaml + .pgm (ROS map_server) or .png"
    more = "\nOnly .json keeps rooms, signs and access points."
    give = _part(parts, "export", _export, text, ["export twin-01 --out twin-01.yaml"], more)
    give.add_argument("map", metavar="MAP", help="see below")
    give.add_argument("file", type=Path, nargs="?", metavar="FILE", help="the same as --out FILE")
    give.add_argument("--out", type=Path, metavar="FILE", help="the suffix selects the format")
    give.add_argument(
        "--resolution", type=float, metavar="M", help="metres per pixel of a .yaml or .png (default: 0.05)"
    )
    _seed(give)

    text = "lay maps of one building over each other, without initial guess, and write one map of all"
    _part(parts, "merge", _merge, text, ["merge monday.yaml tuesday.yaml --out merged"], _MERGE_MORE, fill=_add_merge)

    text = "check that maps are valid and every room is reachable; exit status 2 if one is not"
    more = """

--splits generates all 1,300 buildings of the splits and compares their layouts, including rotated and mirrored
copies."""
    check = _part(parts, "check", _check, text, ["check mine.json", "check --splits"], more)
    check.add_argument("maps", nargs="*", metavar="MAP", help="default: all bundled maps, or none with --splits")
    check.add_argument(
        "--splits", action="store_true", help="check that the splits are disjoint, and print their digests"
    )
    add_json(check)
    _seed(check)

    text = "print the JSON schema of the native format"
    _part(parts, "schema", _schema, text, ["schema > floorplan.schema.json"])


_MERGE_MORE = """

Writes transforms.json, and for each group of maps that fit map.yaml + map.pgm (ROS map_server) and map.png, in the
frame of the group's first map. Maps stay apart, with the reason, where two placements explain the overlap about
equally, as in identical rooms, or where too little of it agrees. Exit status 1 if no maps were merged."""


def _add_merge(merge: argparse.ArgumentParser) -> None:
    merge.add_argument(
        "maps", nargs="+", metavar="MAP", help="two or more, see below; turns and resolutions may differ"
    )
    merge.add_argument(
        "--resolution", type=float, metavar="M", help="metres per pixel of a .png or .pgm without yaml (default: 0.05)"
    )
    add_folder(merge, "--out", "merged", "folder of the merged map")
    add_json(merge)


def _merge(options: argparse.Namespace) -> int:
    from twc_env.offline.map_merge import merge_files

    text, is_merged = merge_files(options.maps, options.resolution, options.out, options.json)
    print(text)
    return 0 if is_merged else 1


def _add_building(make: argparse.ArgumentParser) -> None:
    from twc_env.world.building.generate import AREA_MAX_M2, AREA_MIN_M2
    from twc_env.world.building.layouts import KINDS

    make.add_argument("kind", metavar="KIND", help=f"one of {', '.join(KINDS)}")
    make.add_argument("area", type=float, metavar="AREA", help=f"gross floor area, {AREA_MIN_M2} to {AREA_MAX_M2} m2")
    make.add_argument("--seed", type=natural, default=0, help="seed of the building")
    make.add_argument("--count", type=count, default=1, help="number of buildings, with consecutive seeds")
    make.add_argument(
        "--out", type=Path, metavar="FILE.json", help="default: KIND-AREA-SEED.json in the current folder"
    )


def _part(
    parts, name: str, run, text: str, examples: list[str], more: str = "", fill: Fill = lambda _: None
) -> argparse.ArgumentParser:
    lines = "".join(f"\n  twc-env maps {example}" for example in examples)
    names = "" if name in ("generate", "schema") else f"\n\n{_NAMES}"
    epilog = f"example{'s' if len(examples) > 1 else ''}:{lines}{more}{names}"

    def complete(parser: argparse.ArgumentParser) -> None:
        parser.set_defaults(run=run)
        fill(parser)

    return parts.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.", epilog=epilog, fill=complete)


def _seed(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--seed", type=natural, default=0, help="for generating signs and access points if a map has none"
    )


def _list(options: argparse.Namespace) -> None:
    from twc_env.maps import load_map, map_names

    print(_table([load_map(name) for name in options.maps or map_names()]))
    if not options.maps:
        from twc_env.world.building.layouts import KINDS
        from twc_env.world.building.splits import SPLITS

        splits = ", ".join(f"{split}/0000 ({count})" for split, count in SPLITS.items())
        print(f"\ngenerated: gen:KIND:AREA:SEED, with a KIND of {', '.join(KINDS)}\nsplits: {splits}")


def _table(plans: Sequence[Floorplan], mark: str = "") -> str:
    """Sizes and contents of maps, folded to the width of the terminal; mark: stands before each name."""
    rows = [[f"{'':{len(mark)}}map", "size", "floor", "walls", "rooms", "signs", "access points"]]
    for plan in plans:
        x0, y0, x1, y1 = plan.bounds_m
        counts = len(plan.walls_m), len(plan.rooms), len(plan.signs), len(plan.access_points)
        size, floor = f"{x1 - x0:.1f} x {y1 - y0:.1f} m", f"{plan.floor_area_m2:,.0f} m2"
        rows.append([f"{mark}{plan.name}", size, floor, *map(str, counts)])
    return aligned_text(rows, terminal_width())


def _show(options: argparse.Namespace) -> None:
    from twc_env.maps import load_map
    from twc_env.pictures.map_picture import draw_plan

    plan = load_map(options.map, options.seed)
    path = options.out or Path(f"{_file_stem(plan.name)}.{options.format}")
    check_writable(path)
    if not path.suffix:
        path = path.with_name(f"{path.name}.{options.format}")
    path = draw_plan(plan, path, not options.no_signal, options.dpi)
    print(f"{_table([plan])}\nwritten: {path}")


def _generate(options: argparse.Namespace) -> None:
    from twc_env.world.building.generate import generate

    for seed in range(options.seed, options.seed + options.count):
        plan = generate(options.kind, options.area, seed)
        path = options.out or Path(f"{options.kind}-{options.area:g}-{seed}.json")
        if options.out and options.count > 1:
            path = path.with_stem(f"{path.stem}-{seed}")
        _write(plan, path)


def _import(options: argparse.Namespace) -> None:
    from twc_env.maps import load_map

    if options.resolution is not None:
        plan = _picture(Path(options.map), options.seed, options.resolution)
    else:
        plan = load_map(options.map, options.seed)
    _write(plan, options.out or Path(f"{_file_stem(plan.name)}.json"))


def _picture(path: Path, seed: int, resolution_m: float) -> Floorplan:
    from twc_env.datasets.buildings.picture import read_picture

    if not {".png", ".pgm"} & {suffix.lower() for suffix in path.suffixes}:
        raise MapError(f"--resolution is for .png and .pgm; omit it for {path.name}")
    if not 0.005 <= resolution_m <= 10:
        raise MapError(f"--resolution must be 0.005 to 10 m per pixel; got {resolution_m:g}")
    return read_picture(path, seed, resolution_m)


def _export(options: argparse.Namespace) -> None:
    from twc_env.datasets.buildings.map_export import EXPORT_RESOLUTION_M, export_map, lost_in_export
    from twc_env.maps import load_map

    if (options.file is None) == (options.out is None):
        raise MapError("maps export writes one file: name it with --out FILE.json, .yaml or .png")
    options.out = options.out or options.file
    resolution_m = EXPORT_RESOLUTION_M if options.resolution is None else options.resolution
    if options.resolution is not None and options.out.suffix.lower() == ".json":
        raise MapError(f"--resolution is for .yaml and .png; a native map has no pixels: omit it for {options.out}")
    plan = load_map(options.map, options.seed)
    print(f"written: {export_map(plan, options.out, resolution_m)}")
    if remark := lost_in_export(plan, options.out):
        print(remark)


def _write(plan: Floorplan, path: Path) -> None:
    from twc_env.datasets.buildings.map_export import export_map

    if path.suffix != ".json":
        raise MapError(f"--out must end in .json; got {path.name}; use `maps export` for other formats")
    export_map(plan, path)
    print(f"{_table([plan])}\nwritten: {path}")


def _check(options: argparse.Namespace) -> None:
    from twc_env.maps import map_names

    findings: dict[str, object] = {}
    faults: list[str] = []
    if options.maps or not options.splits:
        faults += _check_maps(options.maps or map_names(), options.seed, findings)
    if options.splits:
        faults += _check_splits(findings)
    write_json(options.json, {**findings, "faults": faults})
    if faults:
        raise MapError("one check failed" if len(faults) == 1 else f"{len(faults)} checks failed")


def _check_maps(names: Sequence[str], seed: int, findings: dict[str, object]) -> list[str]:
    from twc_env.commands.team_options import tell_cut_off, tell_unused_starts
    from twc_env.maps import load_map
    from twc_env.world.building.generate import ROBOT_RADIUS_M, check_reachable

    faults: list[str] = []
    sound: dict[str, Floorplan] = {}
    for done, name in enumerate(names, 1):
        try:
            sound[name] = check_reachable(load_map(name, seed))
        except MapError as error:
            faults.append(str(error))
        show_count(done, len(names), " maps")
    if sound:
        print(_table(list(sound.values()), "sound  "))
    for name, plan in sound.items():
        tell_unused_starts(name, plan)
        tell_cut_off(name, plan, ROBOT_RADIUS_M)
    _tell(faults)
    findings["floor_m2"] = {name: round(plan.floor_area_m2, 2) for name, plan in sound.items()}
    return faults


def _check_splits(findings: dict[str, object]) -> list[str]:
    from twc_env.world.building.splits import SPLITS, digest_of_layouts, split_layouts

    faults: list[str] = []
    owner: dict[str, str] = {}
    digests = {}
    for split in SPLITS:
        layouts = split_layouts(split)
        digests[split] = digest_of_layouts(layouts)
        for number, layout in enumerate(layouts):
            name = f"{split}/{number:04d}"
            if layout in owner:
                faults.append(f"{name} repeats the layout of {owner[layout]}")
            owner.setdefault(layout, name)
        print(f"{split:<12} {len(layouts):>5} buildings, digest {digests[split]}")
    print(f"{len(owner)} different layouts (turned and mirrored copies count as one), {len(faults)} repeated")
    _tell(faults)
    findings["split_digests"] = digests
    findings["layouts"] = len(owner)
    return faults


def _tell(faults: Iterable[str]) -> None:
    for fault in faults:
        print(f"FAULT  {fault}")


def _schema(options: argparse.Namespace) -> None:
    from twc_env.maps import schema

    json.dump(schema(), sys.stdout, indent=2)
    print()


def _file_stem(name: str) -> str:
    return re.sub(r"[^\w.-]+", "-", name) or "map"
