"""Help texts of all commands: the meaning of each option, its default, and examples that can be parsed."""

import argparse
import importlib
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from twc_env.agents.policy import policy_names
from twc_env.agents.roster import display_name

import twc_env.__main__
from twc_env.commands.completion import Completer
from twc_env.commands.train import MODULES
from twc_env.running.argument_parser import Paragraphs

PROGRAMS = {"twc-env": twc_env.__main__}
HELP_MAX_S = 0.7
"""CPU time of a start with --help, which hardly depends on the load of the machine; most of it is numpy's."""
HEAVY = ("numba", "scipy", "pymunk", "matplotlib", "torch")


def parsers(parser):
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from parsers(below)


ALL = [below for program in PROGRAMS.values() for below in parsers(program._parser())]

NAMES = [parser.prog.removeprefix("twc-env").strip() for parser in ALL]
LIGHT = [name for name in NAMES if name != "maps generate" and not name.startswith("reproduce ")]
"""Commands whose help needs nothing heavy. That of `maps generate` lists kinds of buildings from where they are drawn;
options of a table stand beside the table."""
LIGHT_HELPS = f"""
import contextlib, io, sys
from twc_env.__main__ import main
for name in {LIGHT!r}:
    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()):
        main([*name.split(), "--help"])
    if found := [part for part in {HEAVY!r} if part in sys.modules]:
        sys.exit(f"twc-env {{name}} --help imports {{found}}")
"""


def options(parser):
    return [a for a in parser._actions if not isinstance(a, argparse._SubParsersAction) and a.dest != "help"]


@pytest.mark.parametrize("parser", ALL, ids=lambda parser: parser.prog)
def test_the_help_of_every_option_explains_it_and_states_its_default(parser):
    for option in options(parser):
        name = (option.option_strings or [option.dest])[0]
        assert option.help, f"{name} is not explained"
        has_default = option.default is not None and option.default not in ([], "", argparse.SUPPRESS)
        is_switch = not option.option_strings or option.default is False
        said = parser.formatter_class(parser.prog)._get_help_string(option)
        assert is_switch or ("default" in said) >= has_default, f"{name} does not say its default"
        assert said.count("(default:") <= 1, f"{name} says its default twice"


@pytest.mark.parametrize("name", ["mappo", "es", "ppo"])
def test_the_help_of_a_learner_states_the_defaults_of_its_settings(name):
    for module in ("torch", "stable_baselines3"):
        pytest.importorskip(module, reason="needs the extra 'train'")
    settings = importlib.import_module(f"twc_env.training.{MODULES[name]}").Settings()
    (parser,) = (parser for parser in ALL if parser.prog == f"twc-env train {name}")
    (tuned,) = (group for group in parser._action_groups if group.title == "hyperparameters")
    assert len(tuned._group_actions) >= 2
    for option in tuned._group_actions:
        said = re.search(r"\(default: (.+)\)$", option.help)
        assert float(said[1].replace("_", "")) == getattr(settings, option.dest)


COMPLETIONS = [("agent", "minp", "minpos"), ("map", "twin-0", "twin-01"), ("task", "ExploreQ", "ExploreQuick-v1"),
               ("config", "twc/ExploreH", "twc/ExploreHard-v0"), ("set", "odometry.d", "odometry.drift=")]  # fmt: skip


@pytest.mark.parametrize(("option", "typed", "meant"), COMPLETIONS)
def test_the_shell_completes_names_beside_files(option, typed, meant, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path(f"{typed.rpartition('/')[2]}.py").touch()
    complete = Completer()
    found = complete(typed, argparse.Action([f"--{option}"], option))
    assert meant in found and all(name.startswith(typed) for name in found)
    assert complete("nothing-of-this-name", argparse.Action([f"--{option}"], option)) == []


@pytest.mark.parametrize("parser", ALL, ids=lambda parser: parser.prog)
def test_defaults_and_paths_have_one_form_in_all_help_texts(parser):
    for option in options(parser):
        name = (option.option_strings or [option.dest])[0]
        assert "(default " not in option.help, f"{name} writes (default X), others (default: X)"
        assert option.type is not Path or option.metavar, f"{name} does not say whether it is a file or a folder"


def test_a_missing_command_is_an_error_that_refers_to_the_help(capsys):
    with pytest.raises(SystemExit):
        twc_env.__main__.main([])
    assert "twc-env --help says more" in capsys.readouterr().err


def test_an_unknown_option_is_an_error_of_one_line_and_a_lacking_argument_one_with_the_usage(capsys):
    with pytest.raises(SystemExit):
        twc_env.__main__.main(["reproduce", "solver", "--walks", "1"])
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("twc-env reproduce solver: error: unrecognized arguments: --walks 1; twc-env reproduce")
    with pytest.raises(SystemExit):
        twc_env.__main__.main(["optimise"])
    assert capsys.readouterr().err.startswith("usage: twc-env optimise")


@pytest.mark.parametrize(
    ("arguments", "near"),
    [
        ("explor", "'explore'"),
        ("compare --bulidings 5", "'--buildings'"),
        ("compare --bulidings=5", "'--buildings'"),
    ],
)
def test_the_error_of_a_misspelt_command_or_option_suggests_the_nearest(arguments, near, capsys):
    with pytest.raises(SystemExit):
        twc_env.__main__.main(arguments.split())
    assert f"; did you mean {near}?" in capsys.readouterr().err


@pytest.mark.parametrize("parser", ALL, ids=lambda parser: parser.prog)
def test_the_examples_of_every_command_can_be_parsed(parser):
    whole = parser.format_help().replace(" \\\n      ", " ")  # as a shell joins lines that were folded
    examples = [line.split("   ")[0] for line in whole.splitlines() if line.startswith("  twc-env ")]
    assert examples
    for example in examples:
        name, *arguments = shlex.split(example.split(" > ")[0])
        PROGRAMS[name]._parser().parse_args(arguments)


def test_paragraphs_are_filled_and_examples_are_kept():
    parser = argparse.ArgumentParser(
        formatter_class=lambda prog: Paragraphs(prog, width=32),
        description="One two three four five six seven eight.\n\nNine\nten:\n  an example\n  of lines",
    )
    text = parser.format_help()
    assert "One two three four five six\nseven eight.\n\nNine ten:\n  an example\n  of lines\n" in text


def test_lines_of_examples_that_are_too_long_are_folded():
    lines = "  twc-env explore --map twin-01 --out run    # a remark\n  name  a text that is longer"
    text = Paragraphs("twc-env", width=28)._fill_text(f"examples:\n{lines}", 26, "")
    assert text.splitlines()[1:] == [
        "  # a remark",
        "  twc-env explore --map \\",
        "      twin-01 --out run",
        "  name  a text that is",
        "        longer",
    ]


@pytest.mark.parametrize("columns", [50, 80])
def test_no_help_is_wider_than_the_terminal(monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    for parser in ALL:
        wide = [line.strip(" \\") for line in parser.format_help().splitlines() if len(line) > columns]
        assert [line for line in wide if " " in line and not line.startswith(("[", "--"))] == [], parser.prog


def test_the_points_of_a_list_are_filled_one_by_one():
    parser = argparse.ArgumentParser(
        formatter_class=lambda prog: Paragraphs(prog, width=32),
        description="Two points:\n\n- one two three four five six seven\n  eight\n- nine\n  ten",
    )
    text = parser.format_help()
    assert "Two points:\n\n- one two three four five six\n  seven eight\n- nine ten\n" in text


def test_the_help_of_agents_lists_every_team():
    text = twc_env.__main__._parser().format_help()
    assert all(f"\n  {display_name(name)}  " in text for name in [*policy_names(), "FILE.py:CLASS"])
    assert "informed (oracle)" in text


@pytest.mark.parametrize("name", PROGRAMS)
def test_every_program_prints_its_version(name, capsys):
    with pytest.raises(SystemExit) as stop:
        PROGRAMS[name].main(["--version"])
    assert (stop.value.code, capsys.readouterr().out) == (0, f"twc_env {twc_env.__version__}\n")


SETS = [(parser, option) for parser in ALL for option in options(parser) if option.option_strings == ["--set"]]


@pytest.mark.parametrize(("parser", "option"), SETS, ids=[parser.prog for parser, _ in SETS])
def test_the_help_of_set_names_the_settings_command(parser, option):
    assert "twc-env settings" in option.help


def test_no_help_imports_what_only_the_command_needs():
    subprocess.run([sys.executable, "-c", LIGHT_HELPS], check=True)


def test_help_starts_within_its_limit():
    resource = pytest.importorskip("resource")  # not on Windows

    def start_s() -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, "-m", "twc_env", "explore", "--help"], check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    assert min(start_s() for _ in range(3)) < HELP_MAX_S


def test_every_command_has_a_module_and_every_module_of_commands_a_command():
    modules = {path.stem for path in Path(twc_env.__file__).parent.glob("commands/*.py")}
    commands = {name.replace("-", "_") for name in twc_env.__main__.COMMANDS}
    assert commands == modules - {"__init__", "team_options", "completion"}


@pytest.mark.parametrize(
    ("typed", "offered"),
    [("twc-env exp", "explore"), ("twc-env maps generate --co", "--count"), ("twc-env train ppo --wor", "--workers")],
)
def test_words_are_completed_also_those_of_commands_that_are_not_imported_yet(tmp_path, typed, offered):
    words = tmp_path / "words"
    asked = {"_ARGCOMPLETE": "1", "COMP_LINE": typed, "COMP_POINT": str(len(typed))}
    env = os.environ | asked | {"_ARGCOMPLETE_STDOUT_FILENAME": str(words)}
    subprocess.run([sys.executable, "-m", "twc_env"], env=env, check=True)
    assert words.read_text().strip() == offered


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["explore", "--no-gif"], "--no-gif: it is --no-film;"),
        (["explore", "--max-cycles", "60"], "--max-cycles 60: it is --steps;"),
        (
            ["evaluate", "--films", "runs/films"],
            "--films takes no value now, they are written to films in --out FOLDER",
        ),
        (["explore", "--format", "none"], "for no pictures say --no-pictures"),
        (["replay", "sample", "--format", "png,pdf"], "must be one of png, pdf, svg; got 'png,pdf'"),
    ],
)
def test_an_option_of_earlier_times_is_refused_with_the_one_of_now(arguments, told, capsys):
    with pytest.raises(SystemExit) as error:
        twc_env.__main__.main(arguments)
    assert error.value.code == 2 and told in (said := capsys.readouterr().err) and said.count("\n") == 1


def test_pictures_have_the_same_options_in_every_command_that_draws_them():
    asked = {"--format", "--dpi"}
    drawing = {
        parser.prog: {name for option in options(parser) for name in option.option_strings}
        for parser in ALL
        if asked & {name for option in options(parser) for name in option.option_strings}
    }
    assert {f"twc-env {name}" for name in ("explore", "replay", "compare", "benchmark", "evaluate")} <= set(drawing)
    assert {prog for prog, names in drawing.items() if not asked <= names} == set()
    assert all("--no-pictures" in drawing[f"twc-env {name}"] for name in ("explore", "replay", "compare", "evaluate"))


def test_a_folder_of_results_is_named_by_out_alone():
    named = {
        (parser.prog, option.option_strings[0])
        for parser in ALL
        for option in options(parser)
        if option.option_strings and option.metavar == "FOLDER"
    }
    assert {option for _, option in named} == {"--out", "--cache"}, named  # a cache keeps finished parts
