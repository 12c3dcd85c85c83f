"""Files of text that are packed, cut off or no text: read whole, or refused with one kind of error."""

import gzip
import lzma
import tracemalloc

import numpy as np
import pytest

from tests.real_data import DATA, needs_data
from twc_env.datasets.logs.carmen_log import read_carmen_log
from twc_env.datasets.logs.pose_graph_file import read_pose_graph
from twc_env.datasets.logs.scan_log import read_relations, read_scan_log
from twc_env.datasets.logs.text_file import TextLines, read_text
from twc_env.datasets.logs.tum import read_tum
from twc_env.datasets.surveys.fingerprints import read_table
from twc_env.errors import DataError
from twc_env.records import input_file

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


@pytest.mark.parametrize("text", ["", "a", "a\nb", "a\r\n\rb\n\n", "Z\u2028x\n"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_lines_are_those_of_the_text_whatever_ends_them_and_as_often_as_asked(tmp_path, text, encoding):
    (tmp_path / "a.txt").write_bytes(text.encode(encoding))
    lines = TextLines(tmp_path / "a.txt")
    plain = text.replace("\r\n", "\n").replace("\r", "\n").removesuffix("\n")
    assert list(lines) == list(lines) == (plain.split("\n") if text else [])


@pytest.mark.parametrize(("name", "pack"), [("a.log.gz", gzip.compress), ("a.log.xz", lzma.compress)])
def test_a_packed_text_may_not_be_far_larger_than_its_file(tmp_path, monkeypatch, name, pack):
    monkeypatch.setattr(input_file, "PACKED_BYTES_FREE", 1_000_000)
    (tmp_path / name).write_bytes(pack(b"ab\n" * 900_000))
    with pytest.raises(DataError, match=r"holds more than 1 MB of text in \d+ kB, as no log does; unpack it if you"):
        read_text(tmp_path / name)
    noise = np.random.default_rng(0).random(20_000).tobytes().hex().encode()  # halved by packing
    (tmp_path / name).write_bytes(pack(noise * 20))
    assert len(read_text(tmp_path / name)) == 20 * len(noise) > 6_000_000


@needs_data
def test_every_real_text_is_within_the_limits():
    packed = [path for path in DATA.rglob("*.gz") if ".pgm" not in path.name]
    assert len(packed) > 50
    for path in packed:
        assert read_text(path, errors="replace") or path.stat().st_size < 100


@pytest.mark.parametrize(
    ("read", "end"),
    [(read_pose_graph, "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"), (read_carmen_log, "FLASER 1 1.0 0 0 0 0 0 0 1 h 1\n")],
)
def test_short_lines_take_no_more_room_than_their_text(tmp_path, read, end):
    (tmp_path / "a.log").write_text("ab\n" * 200_000 + end)
    tracemalloc.start()
    try:
        read(tmp_path / "a.log")
        assert tracemalloc.get_traced_memory()[1] < 3_000_000
    finally:
        tracemalloc.stop()
