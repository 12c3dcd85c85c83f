import io

import pytest

pytest.importorskip("tqdm")
from twc_env.training import progress
from twc_env.training.progress import progress_bar


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_on_a_terminal_progress_is_a_bar(monkeypatch):
    shown = Terminal()
    monkeypatch.setattr("sys.stderr", shown)
    bar = progress_bar(total=1000, miniters=1, file=shown)
    before = shown.getvalue().count("\r")
    bar.last_print_t -= 1.0  # as if a second had passed
    bar.update(1)
    assert shown.getvalue().count("\r") > before
    bar.close()


@pytest.mark.parametrize(("interval_s", "lines"), [(60.0, 0), (1e-9, 4)])
def test_in_a_log_progress_is_whole_lines_at_an_interval(interval_s, lines, monkeypatch):
    shown = io.StringIO()
    monkeypatch.setattr("sys.stderr", shown)
    monkeypatch.setattr(progress, "LOG_INTERVAL_S", interval_s)
    for _ in progress_bar(range(3), miniters=1, unit=" buildings"):
        pass
    said = shown.getvalue()
    assert "\r" not in said and "|" not in said and said.count("\n") == len(said.splitlines()) <= lines
    if lines:
        assert "3/3 buildings, 00:00 so far, 00:00 left" in said
