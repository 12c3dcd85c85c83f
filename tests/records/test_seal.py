import hashlib
import zipfile

import numpy as np
import pytest

from twc_env.datasets.logs.arrays_file import read_arrays, write_arrays
from twc_env.errors import DataError
from twc_env.records.seal import is_unbroken, seal


def written(path):
    random = np.random.default_rng(1)
    write_arrays(path, format=np.array("f-1"), ranges_m=random.normal(size=300), robot=np.arange(40))
    return path.read_bytes()


def test_a_flipped_byte_anywhere_in_a_file_of_arrays_is_refused_in_one_line(tmp_path):
    path = tmp_path / "frames.npz"
    sound, random = written(path), np.random.default_rng(0)
    assert set(read_arrays(path, "log", "f-1", ("robot",), "record it again")) == {"format", "ranges_m", "robot"}
    for place in [*random.integers(len(sound), size=200), *range(len(sound) - 130, len(sound))]:
        bent = bytearray(sound)
        bent[place] ^= int(random.integers(1, 256))
        path.write_bytes(bent)
        with pytest.raises(DataError, match="record it again") as error:
            read_arrays(path, "log", "f-1", ("robot",), "record it again")
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("kept", [0, 20, 400, -1, -70, -71, -72])
def test_a_file_of_arrays_that_is_cut_off_is_refused(kept, tmp_path):
    path = tmp_path / "frames.npz"
    path.write_bytes(written(path)[:kept])
    with pytest.raises(DataError, match="record it again"):
        read_arrays(path, "log", "f-1", (), "record it again")


def test_archives_of_other_programs_have_no_checksum_and_are_read(tmp_path):
    path = tmp_path / "frames.npz"
    np.savez(path, format=np.array("f-1"))
    assert is_unbroken(path) and read_arrays(path, "log", "f-1", (), "")


def test_the_checksum_is_that_of_all_other_bytes_and_no_program_is_disturbed_by_it(tmp_path):
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data", "hello")
    seal(path)
    content = path.read_bytes()
    assert content[-71:] == b"sha256:" + hashlib.sha256(content[:-71]).hexdigest().encode()
    with zipfile.ZipFile(path) as archive:
        assert archive.read("data") == b"hello" and archive.testzip() is None
