"""What may be read: files and folders, not devices, pipes or sockets, which may have no end."""

import os
import socket
from pathlib import Path

import pytest

from twc_env.config import from_dict, load
from twc_env.datasets.lasting_maps import prior_of, read_lasting_map
from twc_env.datasets.logs.carmen_log import read_any_log
from twc_env.datasets.logs.frame_log import read_frame_log
from twc_env.datasets.logs.pose_graph_file import read_pose_graph
from twc_env.datasets.logs.tum import read_tum
from twc_env.datasets.ros.bag_file import opened
from twc_env.errors import DataError, MapError, TwcError
from twc_env.records.input_file import input_path
from twc_env.replaying.inputs import Asked, read_input
from twc_env.world.building.floorplan_file import read_floorplan


@pytest.fixture
def pipe(tmp_path) -> Path:
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / "pipe"


def prior_named(path) -> None:
    prior_of(from_dict({"slam": {"prior": str(path)}}))


def replay(path) -> None:
    read_input([Path(path)], Asked())


READERS = [
    load, prior_named, read_any_log, read_floorplan, read_frame_log, read_lasting_map, read_pose_graph, read_tum,
    replay,
]  # fmt: skip


@pytest.mark.parametrize("read", READERS)
def test_no_reader_waits_for_a_pipe(pipe, read):
    with pytest.raises(TwcError, match="is a pipe, which may have no end; copy its content to a file and name that"):
        read(pipe)


@pytest.mark.parametrize("read", READERS)
def test_no_reader_reads_a_device(read):
    with pytest.raises(TwcError, match="/dev/zero is a device, which may have no end"):
        read("/dev/zero")


def test_no_bag_is_a_pipe(pipe):
    pytest.importorskip("rosbags")
    with pytest.raises(DataError, match="is a pipe"), opened(pipe):
        pass


def test_a_pipe_named_as_a_map_is_an_error_of_maps(pipe):
    with pytest.raises(MapError, match="is a pipe"):
        read_floorplan(pipe)


def test_a_socket_is_no_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # its name is short
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind("s")
        with pytest.raises(DataError, match="s is a socket"):
            input_path("s")


def test_files_folders_and_what_is_missing_are_left_to_the_reader(tmp_path):
    (tmp_path / "a").write_text("")
    for name in (tmp_path, tmp_path / "a", tmp_path / "b"):
        assert input_path(str(name)) == name
