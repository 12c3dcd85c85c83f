"""Downloads from a local server: resumed, checked, and kept only if they are what was expected."""

import gzip
import hashlib
import re
import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from twc_env.__main__ import main
from twc_env.datasets.public import catalogue as shelf
from twc_env.datasets.public.catalogue import DataFile, DataSet, catalogue
from twc_env.datasets.public.download import fetch
from twc_env.errors import DataError

CONTENT = bytes(range(256)) * 2000


@contextmanager
def served(body: bytes, cut: int | None = None, has_ranges: bool = True):
    """A server of one file, and the ranges that were asked for; cut: bytes after which the first transfer ends."""
    asked: list[str | None] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            told = self.headers.get("Range")
            asked.append(told)
            begin = int(told.split("=")[1].rstrip("-")) if told and has_ranges else 0
            if begin >= len(body):
                self.send_error(416)
                return
            self.send_response(206 if begin else 200)
            self.send_header("Content-Length", str(len(body) - begin))
            self.end_headers()
            end = cut if cut is not None and len(asked) <= 3 else len(body)
            self.wfile.write(body[begin : max(end, begin)])

        def log_message(self, *arguments):
            pass

    server = HTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/data.bin", asked
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def data_file(url: str | None, place: str = "a/b.bin", content: bytes = CONTENT) -> DataFile:
    return DataFile(place, url, len(content), hashlib.sha256(content).hexdigest())


def test_a_file_comes_to_its_place_once(tmp_path):
    seen = []
    with served(CONTENT) as (url, asked):
        assert fetch(data_file(url), tmp_path, lambda done, total: seen.append((done, total)))
        assert not fetch(data_file(url), tmp_path)
    assert (tmp_path / "a" / "b.bin").read_bytes() == CONTENT
    assert seen[-1] == (len(CONTENT), len(CONTENT))
    assert asked == [None]
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["b.bin"]


def test_an_interrupted_download_goes_on_where_it_broke_off(tmp_path):
    with served(CONTENT, cut=100_000) as (url, asked):
        with pytest.raises(DataError, match="100000 bytes are kept, fetch again to go on"):
            fetch(data_file(url), tmp_path)
        assert not (tmp_path / "a" / "b.bin").exists()
        assert fetch(data_file(url), tmp_path)
    assert asked[0] is None
    assert asked[-1] == "bytes=100000-"
    assert (tmp_path / "a" / "b.bin").read_bytes() == CONTENT


def test_a_server_without_ranges_sends_all_again(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "b.bin.part").write_bytes(b"x" * 500)
    with served(CONTENT, has_ranges=False) as (url, _):
        assert fetch(data_file(url), tmp_path)
    assert (tmp_path / "a" / "b.bin").read_bytes() == CONTENT


def test_a_whole_part_needs_no_more(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "b.bin.part").write_bytes(CONTENT)
    with served(CONTENT) as (url, _):
        assert fetch(data_file(url), tmp_path)


def test_another_content_is_not_kept(tmp_path):
    with served(CONTENT[::-1]) as (url, _), pytest.raises(DataError, match=r"has SHA-256 \w+\.\.\., expected"):
        fetch(data_file(url), tmp_path)
    assert list((tmp_path / "a").iterdir()) == []


def test_far_too_much_is_another_file(tmp_path):
    with served(CONTENT) as (url, _), pytest.raises(DataError, match="it is another file"):
        fetch(data_file(url, content=b"small"), tmp_path)


def test_texts_are_packed_on_the_way_to_their_places(tmp_path):
    with served(CONTENT) as (url, _):
        fetch(data_file(url, "a/b.bin.gz"), tmp_path)
        assert not fetch(data_file(url, "a/b.bin.gz"), tmp_path)
    assert gzip.decompress((tmp_path / "a" / "b.bin.gz").read_bytes()) == CONTENT


def test_only_web_addresses_are_fetched(tmp_path):
    with pytest.raises(DataError, match="is no web address"):
        fetch(data_file("file:///etc/passwd"), tmp_path)
    with pytest.raises(DataError, match="get it from the source by hand"):
        fetch(data_file(None), tmp_path)


def test_the_catalogue_names_licence_place_and_checksum_of_all_sets():
    for name, each in catalogue().items():
        assert each.licence, name
        assert each.source, name
        for file in each.files:
            assert len(file.sha256) == 64
            assert not file.place.startswith("/")
            assert ".." not in file.place
            assert file.url is None or file.url.startswith("https://")


def test_tables_that_need_a_set_exist():
    from twc_env.reproduce.runner import TABLES

    assert {table for each in catalogue().values() for table in each.tables} <= set(TABLES)


def test_the_page_of_real_data_names_the_same_files_and_tables():
    page = Path(__file__).parents[2].joinpath("docs/real_data.md").read_text(encoding="utf-8")
    rows = page.partition("| folder and files below")[2].split("\n\n")[0].splitlines()[2:]
    for name, each in catalogue().items():
        for file in each.files:
            (row,) = [row for row in rows if any(
                file.place.startswith(place.rstrip("*.json"))
                for place in re.findall(r"`([^`]+/[^`]*)`", row.partition(" | ")[0])
            )]  # fmt: skip
            assert set(re.findall(r"`([a-z0-9-]+)`", row.rpartition(" | ")[2])) == set(each.tables), name


def test_the_command_lists_and_fetches(tmp_path, monkeypatch, capsys):
    assert main(["data", "list"]) == 0
    assert "houseexpo" in capsys.readouterr().out
    assert main(["data", "list", "carmen"]) == 0
    assert "aces-corrected.log.gz" in capsys.readouterr().out
    monkeypatch.delenv("TWC_DATA", raising=False)
    assert main(["data", "fetch", "carmen"]) == 2
    assert "set TWC_DATA to the folder of the data, or give --out FOLDER" in capsys.readouterr().err
    assert main(["data", "fetch", "carmem"]) == 2
    assert "did you mean 'carmen'?" in capsys.readouterr().err
    with served(CONTENT) as (url, _):
        small = DataSet("small", "", "MIT", "here", (), (data_file(url), data_file(None, "a/hand.bin")))
        monkeypatch.setattr(shelf, "catalogue", lambda: {"small": small})
        assert main(["data", "fetch", "small", "--out", str(tmp_path)]) == 1
    assert (tmp_path / "a" / "b.bin").read_bytes() == CONTENT
    assert "to be got by hand" in capsys.readouterr().out
