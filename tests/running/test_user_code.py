"""An exception in a user's own class is told with the user's line first."""

import pytest

from twc_env.__main__ import main

MINE = """
from twc_env.agents import Policy

class Mine(Policy):
    def act(self, beliefs):
        return self.helper()

    def helper(self):
        return 1 / 0
"""


@pytest.fixture
def mine(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(MINE)
    return tmp_path / "mine.py"


EXPLORE = ["explore", "--map", "sfw-e1", "--robots", "1", "--steps", "3", "--no-pictures", "--agent", "mine.py:Mine"]
COMPARE = ["compare", "--maps", "sfw-e1", "test/0000", "--robots", "1", "--steps", "3", "--agents", "mine.py:Mine"]
COMPARE += ["--jobs", "2"]


@pytest.mark.parametrize("command", [EXPLORE, COMPARE], ids=["explore", "in a worker process"])
def test_the_line_of_the_user_comes_first(mine, command, capsys):
    assert main(command) == 1
    lines = [line for line in capsys.readouterr().err.splitlines() if "compiling kernels" not in line]
    assert lines[0] == f"error in your code: {mine}, line 9, in helper"
    assert lines[1:3] == ["    return 1 / 0", "ZeroDivisionError: division by zero"]
    assert lines[3] == f"called from {mine}, line 6, in act"
    assert lines[-1] == "--verbose shows the whole traceback" and not any("Traceback" in line for line in lines)


def test_a_comprehension_is_told_once(mine, capsys):
    mine.write_text(MINE.replace("return 1 / 0", "return [[k / 0 for k in range(2)] for _ in range(2)]"))
    assert main(EXPLORE) == 1
    lines = [line for line in capsys.readouterr().err.splitlines() if str(mine) in line]
    assert lines == [f"error in your code: {mine}, line 9, in helper", f"called from {mine}, line 6, in act"]


def test_a_module_that_is_missing_is_told_without_the_machinery_of_imports(mine, capsys):
    mine.write_text("import there_is_no_such_module\n")
    assert main(EXPLORE) == 1
    assert capsys.readouterr().err.splitlines() == [
        f"error in your code: {mine}, line 1, in <module>",
        "    import there_is_no_such_module",
        "ModuleNotFoundError: No module named 'there_is_no_such_module'",
        "--verbose shows the whole traceback",
    ]


def test_verbose_shows_the_whole_traceback_above(mine, capsys):
    assert main([*EXPLORE, "--verbose"]) == 1
    text = capsys.readouterr().err
    assert text.index("Traceback") < text.index("error in your code") and "agents/explore.py" in text


def test_a_file_that_is_not_python_is_told_by_its_line(mine, capsys):
    mine.write_text("class Mine(:\n    pass\n")
    assert main(EXPLORE) == 1
    assert capsys.readouterr().err.startswith(f"error in your code: {mine}, line 1\n    class Mine(:\nSyntaxError:")


def test_our_own_exceptions_are_not_called_the_users(monkeypatch):
    monkeypatch.setattr("twc_env.commands.settings._print", lambda options: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        main(["settings"])
