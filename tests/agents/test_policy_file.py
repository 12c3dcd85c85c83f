"""Custom team policies, named by their file."""

import json
import pickle

import numpy as np
import pytest
from twc_env.agents import compare
from twc_env.agents.explore import explore
from twc_env.agents.policy import is_finished, make_policy

from twc_env import ConfigError, EnvConfig
from twc_env.__main__ import main
from twc_env.errors import ActionError
from twc_env.records.class_file import digest_of

MINE = """
import numpy as np
from twc_env.agents import Policy
from beside import SPEED

class Mine(Policy):
    def act(self, beliefs):
        return {agent: np.array([SPEED, 0.5], np.float32) for agent in beliefs}

class Half:
    def act(self, beliefs):
        return {}
"""

ODD = f"""{MINE}
class Bare(Mine):
    def __init__(self):
        pass

class Actless(Policy):
    pass

class Alone(Mine):
    def act(self):
        return {{}}

class Odd(Mine):
    def act(self, beliefs):
        return None
"""


@pytest.fixture
def mine(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "beside.py").write_text("SPEED = 0.25\n")
    (tmp_path / "null.py").write_bytes(b"class Mine:\0 pass")
    (tmp_path / "latin.py").write_bytes("# caf\u00e9".encode("latin-1"))
    (tmp_path / "empty.py").touch()
    (tmp_path / "odd.py").write_text(ODD)
    return "mine.py:Mine"


def test_the_error_of_a_file_without_a_class_shows_how_it_is_named(mine):
    with pytest.raises(ConfigError, match=r"^mine\.py names a file and no class in it; write mine\.py:CLASS"):
        make_policy("mine.py")


def test_a_custom_policy_with_act_only_can_be_compared_with_ours(mine, tmp_path, capsys):
    arguments = ["compare", "--agents", "random", mine, "--maps", "sfw-e1", "--robots", "1", "--steps", "30"]
    assert main([*arguments, "--jobs", "2", "--json", "figures.json"]) == 0
    found = json.loads((tmp_path / "figures.json").read_text())
    assert set(found) == {"random", mine}
    assert 0.0 < found[mine]["episodes"][0]["path_m"] <= 0.25 * 3.0
    assert mine in capsys.readouterr().out


def test_policy_files_of_equal_name_are_separate_and_import_from_their_folders(mine, tmp_path):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine.py").write_text(MINE)
    (tmp_path / "other" / "beside.py").write_text("SPEED = 0.75\n")
    policies = [pickle.loads(pickle.dumps(make_policy(name))) for name in (mine, f"other/{mine}", mine)]
    assert [policy.act({"robot_0": None})["robot_0"][0] for policy in policies] == [0.25, 0.75, 0.25]
    assert pickle.dumps(make_policy(mine))


@pytest.mark.parametrize("is_regular", [False, True])
def test_policy_files_in_two_folders_each_import_the_package_of_their_folder(tmp_path, is_regular):
    names = []
    for folder, speed in (("first", 0.25), ("second", 0.75)):
        package = tmp_path / folder / "parts"
        package.mkdir(parents=True)
        (package / "pace.py").write_text(f"SPEED = {speed}\n")
        if is_regular:
            (package / "__init__.py").touch()
        (tmp_path / folder / "mine.py").write_text(MINE.replace("from beside", "from parts.pace"))
        names.append(f"{tmp_path / folder / 'mine.py'}:Mine")
    assert [make_policy(name).act({"robot_0": None})["robot_0"][0] for name in names] == [0.25, 0.75]


def test_what_a_policy_file_imports_late_is_of_its_folder_too(tmp_path):
    names, speeds = [], (0.25, 0.75)
    for speed in speeds:
        folder = tmp_path / str(speed)
        folder.mkdir()
        (folder / "late.py").write_text(f"SPEED = {speed}\n")
        late = "        from late import SPEED\n        return {agent"
        text = MINE.replace("from beside import SPEED\n", "").replace("        return {agent", late)
        (folder / "mine.py").write_text(text)
        names.append(f"{folder / 'mine.py'}:Mine")
    for name, speed in zip(names * 2, speeds * 2, strict=True):
        assert make_policy(name).act({"robot_0": None})["robot_0"][0] == speed


def test_the_digest_of_a_policy_file_tells_its_packages_and_nothing_that_it_cannot_import(mine, tmp_path):
    before = digest_of(mine)
    (tmp_path / "no-package").mkdir()
    (tmp_path / "no-package" / "pace.py").write_text("SPEED = 0.5\n")
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "pace.txt").write_text("0.5\n")
    assert digest_of(mine) == before
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "pace.py").write_text("SPEED = 0.5\n")
    first = digest_of(mine)
    (tmp_path / "parts" / "pace.py").write_text("SPEED = 0.75\n")
    assert before != first != digest_of(mine)


def test_a_report_names_its_policy_file_and_a_changed_file_is_run_again(mine, tmp_path, capsys):
    explore = ["--agent", mine, "--robots", "1", "--steps", "3", "--no-pictures"]
    assert main(["explore", "--map", "sfw-e1", *explore]) == 0
    (folder,) = (tmp_path / "runs").glob("sfw-e1-Mine-seed0*")
    report = json.loads((folder / "report.json").read_text())
    assert (report["agent"], report["agent_digest"]) == (mine, digest_of(mine))
    benchmark = ["benchmark", "--maps", "sfw-e1", "--seeds", "0", *explore, "--out", "out"]
    assert main(benchmark) == 0 and main(benchmark) == 0
    assert "(reused)" in capsys.readouterr().err
    (tmp_path / "beside.py").write_text("SPEED = 0.5\n")
    assert main(benchmark) == 0
    assert "(reused)" not in capsys.readouterr().err


def test_a_report_names_the_policy_file_as_it_was_when_the_episode_began(mine, tmp_path):
    changing = "    def act(self, beliefs):\n        open('later.py', 'w').close()\n"
    (tmp_path / "mine.py").write_text(MINE.replace("    def act(self, beliefs):\n", changing, 1))
    told, run = digest_of(mine), explore(EnvConfig(map="sfw-e1", robots=1, max_cycles=2), mine, 0)
    assert run.report["agent_digest"] == told != digest_of(mine)


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("mine.py:Main", r"no class 'Main' in .*mine\.py; it has Mine$"),
        ("other.py:Mine", "there is no file other.py"),
        ("mine.py:Half", r"has no reset and no finished: derive it from twc_env.agents\.Policy"),
        ("mine", "your own is FILE.py:CLASS"),
        ("odd.py:Bare", "odd.py:Bare, when it is made, cannot be called as twc_env.agents.Policy says: too many"),
        ("odd.py:Alone", "odd.py:Alone.act cannot be called as twc_env.agents.Policy says: too many positional"),
        ("odd.py:Actless", r"odd.py:Actless has no act: derive it from twc_env.agents\.Policy, or add what lacks"),
        ("latin.py:Mine", r"latin.py is no text: .*; save it as UTF-8"),
        ("empty.py:Mine", r"there is no class 'Mine' in .*empty.py: derive it from twc_env.agents\.Policy"),
        ("null.py:Mine", "null.py is no Python file, since it holds null characters; name another"),
    ],
)
def test_the_error_of_an_invalid_policy_names_the_remedy(mine, name, remedy):
    with pytest.raises(ConfigError, match=remedy):
        make_policy(name, EnvConfig())


class Env:
    """Refuses every action."""

    agents = possible_agents = ("robot_0",)

    def __init__(self, **_):
        self.reset = self.belief = lambda *_, **__: None

    def step(self, actions):
        raise ActionError(f"got {actions!r}; give an action per robot")


def test_answers_that_are_no_actions_are_refused_by_the_environment(mine, monkeypatch):
    monkeypatch.setattr("twc_env.parallel_env", Env)
    with pytest.raises(ActionError, match="got None"):
        compare.explore(EnvConfig(), "odd.py:Odd", 0)


@pytest.mark.parametrize("told", [np.ones(2), iter(()), "no"])
def test_a_team_that_says_neither_yes_nor_no_is_refused(told):
    class Team:
        def finished(self, beliefs):
            return told

    with pytest.raises(ConfigError, match=r"Team.finished must return True or False; got"):
        is_finished(Team(), {})


@pytest.mark.parametrize(("told", "expected"), [(True, True), (np.False_, False), (None, False), (1, True)])
def test_a_team_is_finished_if_it_says_so(told, expected):
    class Team:
        def finished(self, beliefs):
            return told

    assert is_finished(Team(), {}) is expected
