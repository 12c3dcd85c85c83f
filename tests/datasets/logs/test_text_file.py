"""Files of text that are packed, cut off or no text: read whole, or refused with one kind of error."""

import gzip
import lzma

import numpy as np
import pytest

from twc_env.datasets.logs.pose_graph_file import read_pose_graph
from twc_env.datasets.logs.scan_log import read_carmen_log, read_relations, read_scan_log
from twc_env.datasets.logs.text_file import read_text
from twc_env.datasets.logs.tum import read_tum
from twc_env.datasets.surveys.fingerprints import read_table
from twc_env.errors import DataError

READERS = [
    read_tum,
    read_pose_graph,
    read_scan_log,
    read_carmen_log,
    lambda path: read_relations(path, None),
    read_table,
]


@pytest.mark.parametrize(("name", "pack"), [("a.txt", bytes), ("a.txt.gz", gzip.compress), ("a.txt.xz", lzma.compress)])
def test_text_is_unpacked_by_its_name_and_loses_its_byte_order_mark(tmp_path, name, pack):
    (tmp_path / name).write_bytes(pack("\ufeffZürich\n".encode()))
    assert read_text(tmp_path / name) == "Zürich\n"


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("rest", [b"", b"\xff" * 3000], ids=["cut off", "damaged"])
def test_a_broken_archive_is_a_data_error(tmp_path, read, rest):
    numbers = np.random.default_rng(0).random(2000).tobytes().hex().encode()
    (tmp_path / "a.gz").write_bytes(gzip.compress(numbers)[:5000] + rest)
    with pytest.raises(DataError, match=r"cannot read .*a\.gz"):
        read(tmp_path / "a.gz")


@pytest.mark.parametrize("read", [read_tum, read_scan_log, read_table])
def test_text_in_another_encoding_is_named_with_the_remedy(tmp_path, read):
    (tmp_path / "a.txt").write_bytes("Zürich\n".encode("latin-1"))
    with pytest.raises(DataError, match=r"a\.txt is not UTF-8 text: .*; save it as UTF-8"):
        read(tmp_path / "a.txt")
