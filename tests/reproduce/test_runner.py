import argparse
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from twc_env.__main__ import main as command
from twc_env.errors import DataError
from twc_env.reproduce.runner import TABLES, Runner, data_folder, main, seeds_argument, table_module
from twc_env.running import terminal
from twc_env.running.terminal import aligned, logging_to_terminal


def test_finished_parts_are_read_back_after_an_interruption(tmp_path):
    done = []

    def work(part):
        if part == 2 and len(done) == 2:
            raise KeyboardInterrupt
        done.append(part)
        return {"value": np.float64(part)}

    with pytest.raises(KeyboardInterrupt):
        Runner("table", tmp_path, {"a": 1}).each(range(4), work)
    rows = Runner("table", tmp_path, {"a": 1}).each(range(4), lambda part: work(part) if part != 2 else {"value": 2.0})
    assert rows == [{"value": 0.0}, {"value": 1.0}, {"value": 2.0}, {"value": 3.0}]
    assert done == [0, 1, 3]


def test_more_seeds_take_the_parts_that_are_there_again(tmp_path):
    done = []

    def rows(options, runner):
        return runner.each(options.seeds, lambda seed: done.append((seed, options.noise)) or {"seed": seed})

    for seeds, noise in (([0, 1], 1.0), ([0, 1, 2], 1.0), ([1], 1.0), ([1], 2.0)):
        options = argparse.Namespace(seeds=seeds, noise=noise, json=None, cache=tmp_path)
        main("toy", SimpleNamespace(rows=rows, CHOOSES=("seeds",)), options)
    assert done == [(0, 1.0), (1, 1.0), (2, 1.0), (1, 2.0)]


def test_parts_depend_on_the_code_of_the_packages_that_a_table_names(tmp_path, monkeypatch):
    from twc_env.running import finished_parts

    asked, digest = [], finished_parts.code_digest
    monkeypatch.setattr(finished_parts, "code_digest", lambda *names: asked.append(names) or digest())
    for packages in ({}, {"PACKAGES": ("twc_env.training",)}):
        table = SimpleNamespace(rows=lambda options, runner: [{"folder": runner.folder.parent}], **packages)
        main("toy", table, argparse.Namespace(json=None, cache=tmp_path))
    assert asked == [(), ("twc_env.training",)]


def _plays(module: str) -> bool:
    """Whether a module of tables lets teams play, itself or through another table's module."""
    source = Path(sys.modules[module].__file__).read_text()
    others = re.findall(r"^from (twc_env\.reproduce\.\w+\.\w+) import", source, re.MULTILINE)
    return "twc_env.agents " in source or "twc_env.suite.player " in source or any(map(_plays, others))


def test_tables_in_which_teams_play_depend_on_the_code_of_the_teams():
    """It stands beside the package in a clone, so the package's own digest does not hold it."""
    modules = [table_module(name) for name in TABLES]
    playing = [module.__name__ for module in modules if _plays(module.__name__)]
    assert len(playing) == 6
    assert [m.__name__ for m in modules if "twc_env.agents" in getattr(m, "PACKAGES", ())] == playing
    learned = [m.__name__ for m in modules if "twc_env.training" in getattr(m, "PACKAGES", ())]
    assert [name.rpartition(".")[2] for name in learned] == ["ablation", "transfer"]


def test_the_list_of_tables_says_which_need_real_data():
    readers = "data_folder", "intel_log", "corrected_log"
    reads = {name: any(hasattr(table_module(name), reader) for reader in readers) for name in TABLES}
    assert [name for name, table in TABLES.items() if reads[name] != table.needs_data] == ["ocr"]


@pytest.mark.parametrize("name", TABLES)
def test_options_that_choose_parts_are_options_of_the_table(name):
    module, parser = table_module(name), argparse.ArgumentParser()
    module.add_arguments(parser)
    assert set(getattr(module, "CHOOSES", ())) <= set(vars(parser.parse_args([])))


@pytest.mark.parametrize("name", TABLES)
def test_a_table_with_seeds_plays_several_by_default(name):
    parser = argparse.ArgumentParser()
    table_module(name).add_arguments(parser)
    assert len(getattr(parser.parse_args([]), "seeds", (0, 1))) > 1


def test_rows_are_printed_in_aligned_columns():
    lines = aligned([{"method": "twc", "recall": 0.987654}, {"method": "a longer name", "recall": None}]).splitlines()
    assert lines[0].index("recall") == lines[1].index("0.9877") == lines[2].index("-")


def test_seeds_mean_the_same_as_in_all_commands():
    assert seeds_argument("3") == [3] and seeds_argument("4-6") == [4, 5, 6]
    assert seeds_argument("3,5") == [3, 5] and seeds_argument("0-1,7") == [0, 1, 7]


@pytest.mark.parametrize("scenes", (["01"], ["#01"]))
def test_scenes_are_named_without_the_sign_that_begins_a_comment_in_a_shell(scenes, parsed):
    assert parsed(table_module("twc-table1"), "--scenes", *scenes).scenes == ["#01"]


def test_names_are_words_or_a_list_with_commas(parsed):
    solver, bare = table_module("solver"), table_module("bare-places")
    for words in (["intel", "MIT"], ["intel,MIT"], ["intel, MIT"], ["intel,", "MIT,intel"]):
        assert parsed(solver, "--datasets", *words).datasets == ["intel", "MIT"]
    assert (
        parsed(solver).datasets == ["intel", "MIT", "M3500", "ringCity"] == parsed(solver, "--datasets", ",").datasets
    )
    assert parsed(bare, "--scenes", "corridor 2 m, numbers", "hall").scenes == ["corridor 2 m, numbers", "hall"]


def test_a_missing_data_folder_is_named(monkeypatch):
    monkeypatch.delenv("TWC_DATA", raising=False)
    with pytest.raises(DataError, match=r"set the environment variable TWC_DATA .*it is not set.*real_data\.md"):
        data_folder()


def square(part):
    return part * part


def test_several_processes_give_the_same_rows_in_the_same_order(tmp_path):
    alone, together = (
        Runner("squares", tmp_path / str(count), {}).each([3, 1, 2], square, processes=count) for count in (1, 2)
    )
    assert alone == together == [9, 1, 4]


def test_parts_of_another_code_are_not_taken(tmp_path, monkeypatch, capsys):
    Runner("table", tmp_path, {}).each([0], lambda _: 1)
    monkeypatch.setattr("twc_env.running.finished_parts.code_digest", lambda: "other")
    capsys.readouterr()
    with logging_to_terminal():
        assert Runner("table", tmp_path, {}).each([0], lambda _: 2) == [2]
    assert "1 finished parts were computed by other code" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["5-1", "-1", "1.5", "", "many"])
def test_no_seeds_at_all_are_refused(text):
    with pytest.raises(argparse.ArgumentTypeError, match="seeds must be numbers and ranges"):
        seeds_argument(text)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("intel --seeds x", "seeds must be numbers and ranges such as 0-9 or 1,4,7-9; got 'x'"),
        ("intel --robots 0", "must be a whole number of at least 1; got '0'"),
        ("merging --buildings 0", "must be a whole number of at least 1; got '0'"),
        ("merging --seed -1", "must be a whole number of at least 0; got '-1'"),
        ("radio-table1 --jobs 0", "must be a whole number of at least 1; got '0'"),
        ("radio-table1 --share nan", "must be a number from 0.01 to 1; got 'nan'"),
        ("radio-scale --length -1", "must be a number from 100 to 1e+06; got '-1'"),
        ("ocr --hidden 2", "must be a number from 0 to 0.95; got '2'"),
        ("odometry --drift wide", "must be a number from 0 to 10; got 'wide'"),
        ("matching --points many", "must be a whole number of at least 1; got 'many'"),
        ("real-radio --floors uw_floor,B1", "unknown choice 'B1'; choose from site1_B1, site2_F6, uw_floor"),
        ("radio-table1 --methods ours", "unknown choice 'ours'; choose from odometry"),
        ("sfw-table1 --experiments E9", "unknown choice 'E9'; choose from 1, 2, 3, 4, 5, 6"),
        ("solver --datasets intel,x", "unknown choice 'x'; choose from intel, MIT, M3500, ringCity"),
        ("robustness --methods best", "unknown choice 'best'; choose from plain"),
        ("twc-table1 --scenes #03", "unknown choice '#03'; choose from #01, #02"),
        ("stress --conditions nomral", "; did you mean 'normal'?"),
    ],
)
def test_numbers_and_names_that_make_no_table_are_refused_by_the_command_line(arguments, message, capsys):
    with pytest.raises(SystemExit):
        command(["reproduce", *arguments.split()])
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("merging --set robots", "--set takes KEY=VALUE"),
        ("merging --set robbots=3", "there is no setting robbots; did you mean 'robots'?"),
        ("merging --cache {file}", "file is a file; choose another folder"),
        ("sfw-table1 --out {file}", "file is a file; choose another folder"),
        ("robustness --shares 0,1", "a share of false closures lies in 0..1 (without 1); got 1"),
        ("robustness --shares ,", "--shares takes numbers like 0,0.5; got ','"),
        ("merging --buildings 101", "the test split holds 100 buildings; got 101"),
        ("stress --buildings 101", "the test split holds 100 buildings; got 101"),
        ("intel --robots 1 3 --scans 2", "3 robots need 3 scans or more; got 2"),
        ("sfw-houseexpo", "holds no plans"),
    ],
)
def test_what_cannot_be_done_is_said_before_the_first_part(arguments, message, tmp_path, refusal, monkeypatch):
    monkeypatch.setenv("TWC_DATA", str(tmp_path))
    file = tmp_path / "file"
    file.write_text("")
    texts = arguments.format(file=file).split()
    cache = [] if "--cache" in texts else ["--cache", str(tmp_path / "parts")]
    assert message in refusal(command, ["reproduce", *texts, *cache])
    assert file.read_text() == ""


def test_an_error_in_a_part_stands_on_a_line_of_its_own(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)

    def rows(options, runner):
        return runner.each([1, 2], lambda part: 1 / (part - 2))

    with pytest.raises(ZeroDivisionError):
        main("toy", SimpleNamespace(rows=rows), argparse.Namespace(json=None, cache=tmp_path))
    assert capsys.readouterr().err.endswith("\n")


def test_a_log_has_a_line_each_minute_of_how_far_a_table_is(tmp_path, capsys, monkeypatch):
    clock = iter(range(0, 10_000, 10))
    monkeypatch.setitem(terminal._progress, "logged_s", 0.0)
    monkeypatch.setattr(terminal, "time", SimpleNamespace(monotonic=lambda: float(next(clock))))
    Runner("toy", tmp_path, {}).each(range(30), lambda part: part)
    lines = capsys.readouterr().err.splitlines()
    assert 2 <= len(lines) <= 6 and all("/30" in line and "\r" not in line for line in lines)


@pytest.mark.parametrize("name", ["sfw-ble", "radio-table1"])
def test_help_says_which_tables_draw_beside_their_rows(name, capsys):
    with pytest.raises(SystemExit):
        command(["reproduce", name, "--help"])
    assert ("and pictures beside" in " ".join(capsys.readouterr().out.split())) == (name == "radio-table1")
