import io

import pytest

pytest.importorskip("tqdm")
from twc_env.training.progress import progress_bar


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(("stream", "moves"), [(Terminal, True), (io.StringIO, False)])
def test_progress_is_a_bar_on_a_terminal_and_few_lines_in_a_log(stream, moves, monkeypatch):
    shown = stream()
    monkeypatch.setattr("sys.stderr", shown)
    bar = progress_bar(total=1000, miniters=1, file=shown)
    before = shown.getvalue().count("\r")
    bar.last_print_t -= 1.0  # as if a second had passed
    bar.update(1)
    assert (shown.getvalue().count("\r") > before) is moves
    bar.close()
