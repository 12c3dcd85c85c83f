"""Names of files that callers give."""

from pathlib import Path

import pytest

from twc_env.errors import DataError
from twc_env.records.whole_file import file_path


@pytest.mark.parametrize("name", ["a.log", Path("b") / ("x" * 255), "\ud800.log"])
def test_a_name_of_a_file_becomes_its_path(name):
    assert file_path(name) == Path(name)


@pytest.mark.parametrize(
    ("name", "message"),
    [("x" * 256, "at most 255 bytes"), (f"b/{'ä' * 128}/c", "at most 255 bytes"), ("a\x00", "null"), (3, "got 3")],
)
def test_what_is_no_name_of_a_file_is_refused(name, message):
    with pytest.raises(DataError, match=message):
        file_path(name)
