"""Progress on terminals of any width and in logs, remarks with --quiet and --verbose."""

import ast
import logging
import os
import sys
from pathlib import Path

import pytest

from twc_env.__main__ import main
from twc_env.kernels import compilation
from twc_env.running import terminal
from twc_env.running.terminal import Bar, bar_line, logging_to_terminal, show_line, tell

TEXTS = [
    "900/2000 steps on twin-01, seed 0, 54.5% mapped correctly, 0:12 left at most",
    "900/2000 steps, 54.5% mapped correctly, 0:12 left", "900/2000 steps, 54.5% mapped, 0:12 left",
    "900/2000, 0:12 left", "900/2000",
]  # fmt: skip


@pytest.mark.parametrize("width", [1, 5, 20, 30, 40, 50, 60, 80, 100, 200])
def test_a_bar_fits_a_terminal_of_any_width_and_keeps_the_time_left(width):
    line = bar_line(0.45, TEXTS, width)
    assert len(line) < max(width, 1) or (width == 1 and line == "")
    if width >= 30:
        assert "900/2000" in line and line.endswith("0:12 left" if width < 100 else TEXTS[0])
    if width >= 50:
        assert "54.5% mapped" in line and ("seed" in line) == (width >= 100)
    if width >= 60:
        assert line.count("#") == pytest.approx(0.45 * (line.count("-") + line.count("#")), abs=1)
        assert line.count("#") >= 3


@pytest.fixture
def on_terminal(monkeypatch):
    """A function that makes stderr a terminal of 70 characters."""

    def become():
        monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
        monkeypatch.setattr(sys.stderr, "fileno", lambda: 2, raising=False)
        monkeypatch.setattr(os, "get_terminal_size", lambda *_: os.terminal_size((70, 20)))

    yield become
    terminal._progress.update(is_open=False, shown=0)


def test_a_shorter_line_covers_the_one_before_it(on_terminal, capsys):
    on_terminal()
    show_line("a long line of progress")
    show_line("short")
    assert capsys.readouterr().err == "\ra long line of progress\rshort" + " " * (len("a long line of progress") - 5)


def test_a_remark_begins_below_the_line_of_progress(on_terminal, capsys):
    on_terminal()
    with logging_to_terminal():
        show_line("half")
        tell("something")
    assert capsys.readouterr().err == "\rhalf\nsomething\n"


def test_a_bar_tells_how_long_it_will_take_at_the_present_rate(on_terminal, capsys, monkeypatch):
    on_terminal()
    clock = iter([0.0, 100.0, *(100.0 + k for k in range(1, 40))])  # a slow beginning, then one count per second
    monkeypatch.setattr(terminal.time, "monotonic", lambda: next(clock))
    bar = Bar(100, "steps")
    for done in range(1, 31):
        bar.show(done, "20 % mapped")
    assert "30/100 steps, 20 % mapped, 1:10 left at most" in capsys.readouterr().err


def test_every_table_that_a_command_prints_is_folded_to_a_width():
    root, unfolded = Path(terminal.__file__).parents[1], []
    for path in (*root.glob("commands/*.py"), *root.glob("running/*.py"), *root.glob("reproduce/*.py")):
        for call in ast.walk(ast.parse(path.read_text())):
            if isinstance(call, ast.Call) and getattr(call.func, "id", "") in ("aligned", "aligned_text"):
                unfolded += [f"{path.name}:{call.lineno}"] * (len(call.args) < 2)
    assert unfolded == []


def test_a_narrow_terminal_shows_a_bar_and_no_map(on_terminal, capsys, monkeypatch):
    on_terminal()
    clock = iter([0.0, *(k / 32 for k in range(1, 40))])
    monkeypatch.setattr(terminal.time, "monotonic", lambda: next(clock))
    bar = Bar(60, "steps", "on gen-office-800-7, seed 0")
    for done in range(1, 31):
        bar.show(done, "20.0% mapped correctly", "20.0% mapped")
    last = capsys.readouterr().err.rpartition("\r")[2]
    assert last.startswith("[####") and last.endswith("] 30/60 steps, 20.0% mapped correctly, 0:01 left")


def test_a_first_count_that_waited_for_kernels_tells_nothing_about_the_time_left(on_terminal, capsys, monkeypatch):
    on_terminal()
    clock = iter([0.0, 400.0, 402.0])
    monkeypatch.setattr(terminal.time, "monotonic", lambda: next(clock))
    bar = Bar(2000, "steps", every=20)
    bar.show(20)
    assert "left" not in capsys.readouterr().err
    bar.show(40)
    assert "left at most" in capsys.readouterr().err


def test_a_log_gets_no_bar_and_a_line_per_minute(capsys, monkeypatch):
    clock = [1000.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: clock[0])
    monkeypatch.setitem(terminal._progress, "logged_s", 1000.0)
    bar = Bar(100, "steps")
    for done in range(1, 61):
        clock[0] += 3
        bar.show(done)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3 and all("[" not in line and "steps" in line for line in lines)


def test_quiet_drops_progress_and_remarks_but_not_warnings(on_terminal, capsys):
    on_terminal()
    with logging_to_terminal(is_quiet=True):
        show_line("half")
        tell("something")
        logging.getLogger("twc_env.slam").warning("careful")
        compilation._LOG.handle(
            compilation._LOG.makeRecord("twc_env", 30, compilation.__file__, 1, "a while", (), None)
        )
    assert capsys.readouterr().err == "careful\n"
    with logging_to_terminal(is_verbose=True):
        logging.getLogger("twc_env.slam").debug("inside")
    assert capsys.readouterr().err == "inside\n"
    logging.getLogger("twc_env.slam").debug("after the command")
    assert capsys.readouterr().err == ""


COMMANDS = (
    "explore, watch, compare, benchmark, evaluate, record, replay, settings, bench, warm-up, maps show, "
    "ocr show, reproduce solver, train ppo"
)


@pytest.mark.parametrize("command", COMMANDS.split(", "))
def test_every_command_has_quiet_and_verbose(command, capsys):
    with pytest.raises(SystemExit):
        main([*command.split(), "--help"])
    text = capsys.readouterr().out
    assert "--quiet" in text and "--verbose" in text


def test_settings_are_written_to_a_file_and_quiet_says_nothing(tmp_path, capsys):
    assert main(["settings", "lidar", "--out", str(tmp_path / "a.toml"), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert (tmp_path / "a.toml").read_text().startswith("#")
    assert main(["settings", "lidar", "--out", str(tmp_path / "b.toml")]) == 0
    assert capsys.readouterr().err == f"written: {tmp_path / 'b.toml'}\n"
