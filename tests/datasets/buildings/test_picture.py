from pathlib import Path

import numpy as np
import pytest

from tests.real_data import DATA, needs_data
from twc_env.config import EnvConfig
from twc_env.datasets.buildings.picture import read_picture
from twc_env.errors import MapError
from twc_env.maps import load_map
from twc_env.world.world import World

IPA_M2 = {
    "Freiburg101_scan": 680, "Freiburg52_scan": 338, "Freiburg79_scan": 290, "NLB": 1163, "lab_d_scan": 518,
    "lab_f_scan": 910, "lab_intel": 726, "lab_ipa": 286, "office_a": 1464, "office_b": 1076, "office_d": 832,
}  # fmt: skip


def write_pgm(path: Path, free: np.ndarray) -> Path:
    rows, columns = free.shape
    path.write_bytes(b"P5\n%d %d\n255\n" % (columns, rows) + (255 * free).astype(np.uint8).tobytes())
    return path


def two_rooms() -> np.ndarray:
    """Two rooms of 4 x 4 m and 4 x 2 m, side by side, joined by a door; 0.1 m per pixel."""
    free = np.zeros((44, 66), bool)
    free[2:42, 2:42] = free[2:42, 43:63] = True
    free[18:28, 42] = True
    return free


def test_rooms_come_from_the_picture_beside_that_cuts_them_apart(tmp_path):
    path = write_pgm(tmp_path / "floor.pgm", two_rooms())
    cut = two_rooms()
    cut[18:28, 42] = False
    write_pgm(tmp_path / "floor_gt_segmentation.pgm", cut)
    rooms = read_picture(path, resolution_m=0.1).rooms
    assert [room.name for room in rooms] == ["room 1", "room 2"]
    spans = [np.ptp(room.polygon_m, axis=0).round(6).tolist() for room in rooms]
    assert spans == [[4.0, 4.0], [2.0, 4.0]]
    assert rooms[0].polygon_m.min(axis=0).round(6).tolist() == [0.2, 0.2]


def test_without_such_a_picture_there_are_no_rooms(tmp_path):
    assert read_picture(write_pgm(tmp_path / "floor.pgm", two_rooms()), resolution_m=0.1).rooms == ()


def test_rooms_drawn_on_another_picture_are_refused(tmp_path):
    path = write_pgm(tmp_path / "floor.pgm", two_rooms())
    write_pgm(tmp_path / "floor_gt_segmentation.pgm", two_rooms()[:-1])
    with pytest.raises(MapError, match="same picture"):
        read_picture(path, resolution_m=0.1)


@needs_data
@pytest.mark.parametrize("name", IPA_M2)
def test_every_real_room_map_loads_with_its_rooms_and_runs(name):
    plan = load_map(DATA / f"maps/ipa/{name}.png")
    assert plan.cells().free.sum() * 0.01 == pytest.approx(IPA_M2[name], rel=0.02)
    inside = [plan.cells().is_free(room.polygon_m.mean(axis=0)[None])[0] for room in plan.rooms]
    assert len(inside) >= 10 and np.mean(inside) > 0.8
    assert name != "office_b" or 30 <= len(plan.access_points) <= 40
    world = World(EnvConfig(), plan)
    world.reset(0)
    world.step(np.ones((3, 2)))
    assert all(0 < frame.ranges_m.min() < 10.0 for frame in world.sense())
