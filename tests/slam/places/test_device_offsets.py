import numpy as np
import pytest

from twc_env.records.messages import Fingerprint
from twc_env.slam.places.device_offsets import DeviceOffsets, offset_of

MACS = np.arange(6)
SOUNDS = {
    name: -60.0 + 12.0 * np.cos(np.arange(6) * (k + 1)) for k, name in enumerate(("A101", "A102", "A103", "A104"))
}
"""RSSI of six transmitters at the place of each sign."""


def heard(name: str, offset_db: float = 0.0) -> Fingerprint:
    return Fingerprint(MACS, SOUNDS[name] + offset_db)


@pytest.fixture
def devices():
    made = DeviceOffsets()
    made.make_room(3)
    return made


def test_three_places_determine_the_offset_between_two_receivers(devices):
    told = []
    for name in ("A101", "A102", "A103", "A104"):
        assert devices.note(0, name, heard(name)) == []
        told.append(devices.note(2, name, heard(name, 10.0)))
    assert told == [[], [], [0], []]  # reported once, when the offset becomes known
    assert devices.offset_db[0, 2] == pytest.approx(10.0)
    assert devices.offset_db[2, 0] == pytest.approx(-10.0)
    assert not devices.offset_db[:, 1].any()


def test_small_offsets_are_treated_as_zero(devices):
    for name in SOUNDS:
        devices.note(0, name, heard(name))
        devices.note(1, name, heard(name, 4.0))
    assert not devices.offset_db.any()


def test_a_text_at_two_places_gives_no_offset(devices):
    for name, elsewhere in zip(SOUNDS, ("A103", "A104", "A101", "A102"), strict=True):
        devices.note(0, name, heard(name))
        devices.note(1, name, heard(elsewhere, 10.0))  # a sign with an equal text elsewhere
    assert devices.between(0, 1) == []
    assert not devices.offset_db.any()


def test_places_shared_with_a_third_robot_count_too(devices):
    for name in ("A101", "A102", "A103"):
        devices.note(0, name, heard(name))
        devices.note(1, name, heard(name, 1.0))
    devices.note(2, "A101", heard("A101", 10.0))
    assert not devices.offset_db.any()
    assert devices.note(2, "A102", heard("A102", 10.0)) == [0, 1]
    assert devices.offset_db[0, 2] == pytest.approx(10.0)
    assert devices.offset_db[1, 2] == pytest.approx(9.0, abs=1.01)
    devices.note(0, "A104", heard("A104"))
    devices.note(2, "A104", heard("A104", 10.0))
    assert devices.between(0, 2) == pytest.approx([10.0] * 3)  # now their common places are enough


def test_enlarging_the_table_keeps_the_offsets(devices):
    for name in ("A101", "A102", "A103"):
        devices.note(0, name, heard(name))
        devices.note(2, name, heard(name, -9.0))
    devices.make_room(6)
    assert devices.offset_db.shape == (6, 6)
    assert devices.offset_db[0, 2] == pytest.approx(-9.0)
    assert devices.faintest_dbm[[0, 2]] == pytest.approx([devices.faintest_dbm[2] + 9.0, devices.faintest_dbm[2]])
    for name in ("A101", "A102", "A103"):
        devices.note(5, name, heard(name))
    assert devices.offset_db[5, 2] == pytest.approx(-9.0)


@pytest.mark.parametrize(
    ("differences_db", "expected"),
    [([9.0, 10.0], 0.0), ([9.0, 10.0, 12.0], 10.0), ([-3.0, -3.0, 8.0, 9.0, 9.0], 0.0), ([-30.0, 8.0, 8.0, 9.0], 8.0)],
)
def test_the_median_is_used_if_half_of_the_places_agree(differences_db, expected):
    assert offset_of(differences_db) == expected
