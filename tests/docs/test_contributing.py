"""What CONTRIBUTING says of rooms is so."""

import re
from pathlib import Path

from tests.test_architecture import ALLOWED, LEAVES

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "CONTRIBUTING.md").read_text()
OFF_THE_WAY = {"slam/saved_maps", "slam/graph_optimisation"}
"""Rooms of the engine that no frame enters."""


def rooms_in(folder: str) -> set[str]:
    return {path.parent.name for path in (ROOT / folder).glob("*/__init__.py")}


def test_the_way_of_a_frame_names_each_room_of_the_engine_once():
    section = TEXT.split("## One frame")[1].split("\n## ")[0]
    items = re.findall(r"^(\d+)\. `([a-z_/]+)/`:", section, re.MULTILINE)
    rooms = [room for _, room in items]
    assert [int(number) for number, _ in items] == list(range(1, len(items) + 1))
    assert len(set(rooms)) == len(rooms)
    assert {f"slam/{room}" for room in rooms_in("twc_env/slam")} - OFF_THE_WAY <= set(rooms)
    assert all((ROOT / "twc_env" / room).is_dir() for room in rooms)


def test_the_table_of_folders_names_every_room():
    table = TEXT.split("## Code layout")[1].split("\n\n")[1]
    named = {name.removeprefix("twc_env/") for name in re.findall(r"`([a-z_/]+)/`", table)}
    assert rooms_in("twc_env") <= named


def test_the_table_of_the_engine_says_what_each_room_may_import():
    rows = re.findall(r"^\| `slam/(\w+)/` \| .* \| (.+) \|$", TEXT, re.MULTILINE)
    assert {room for room, _ in rows} == rooms_in("twc_env/slam")
    for room, others in rows:
        allowed = {f"twc_env.slam.{name}" for name in re.findall(r"`(\w+)`", others)}
        assert ALLOWED[f"twc_env.slam.{room}"] - LEAVES == allowed, room
