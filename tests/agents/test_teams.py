"""Every scripted team in two small buildings: it explores, is not stuck, gives the same bytes, and knows no truth."""

import ast
import hashlib
import inspect
from functools import lru_cache
from importlib import import_module
from pathlib import Path

import pytest
from twc_env.agents import roster
from twc_env.agents.explore import commanded, commanded_stuck_share
from twc_env.agents.policy import begin, make_policy
from twc_env.agents.roster import TEAMS, display_name

import twc_env
from twc_env.records.messages import Belief

ROOT = Path(inspect.getfile(roster)).parent
BUILDINGS = ("twin-01", "gen:office:150:3")
PEER = {"lidar.range_max_m": 5.0, "link.topology": "peer", "link.range_max_m": 8.0, "link.wall_range_m": 3.0}
SIMPLE = ("random", "wall-follower", "radio-walk")
"""Lower references and single robots' surveys: they need not explore more than random."""
ORACLES = ["informed", "informed-no-merging", "informed-plan-only", "informed-poses-only"]
STEPS = 220


@lru_cache
def episode(name, building, steps=STEPS):
    """Digest of actions and poses, mapped share of the floor, path per robot [m] and share of the time stuck."""
    config = {**PEER, "slam.k_visibility.enabled": name.startswith("radio")}
    env = twc_env.parallel_env(map=building, robots=2, max_cycles=steps, config=config)
    env.reset(seed=2)
    policy = make_policy(name, env.config)
    begin(policy, name, env, 2)
    digest, commands = hashlib.sha256(), []
    while env.agents:
        beliefs = {agent: env.belief(agent) for agent in env.agents}
        if policy.finished(beliefs):
            break
        actions = policy.act(beliefs)
        commands.append(commanded(actions, env.possible_agents))
        for action in actions.values():
            digest.update(action.tobytes())
        env.step(actions)
    result = env.result()
    digest.update(result.true_poses.tobytes())
    figures = result.figures
    stuck = commanded_stuck_share(result, commands)
    return digest.hexdigest(), figures["coverage_true"], figures["path_length_m"] / 2, stuck


@pytest.mark.parametrize("building", BUILDINGS)
@pytest.mark.parametrize("name", [name for name in TEAMS if name not in SIMPLE])
def test_every_team_explores_more_than_random_and_is_not_stuck(name, building):
    _, coverage, path_m, stuck = episode(name, building)
    assert path_m > 6.0
    assert coverage > 1.2 * episode("random", building)[1]
    assert stuck <= 0.05


@pytest.mark.parametrize("name", ["random", "wall-follower"])
def test_simple_teams_move_and_are_not_stuck(name):
    for building in BUILDINGS:
        _, _, path_m, stuck = episode(name, building)
        assert path_m > 4.0
        assert stuck <= 0.05


@pytest.mark.parametrize("name", [name for name in TEAMS if not name.startswith("radio") and "blind" not in name])
def test_the_same_episode_gives_the_same_bytes(name):
    first = episode(name, "gen:office:150:3", 60)[0]
    episode.cache_clear()
    assert episode(name, "gen:office:150:3", 60)[0] == first


def test_a_blind_twin_is_the_class_from_which_a_team_aware_of_slam_derives():
    aware = {name: team.twin for name, team in TEAMS.items() if team.twin}
    assert len(aware) >= 4
    for name, twin in aware.items():
        assert type(make_policy(name)).__bases__ == (type(make_policy(twin)),), name


def test_only_oracles_are_given_the_truth(monkeypatch):
    env = twc_env.parallel_env(map="twin-01", robots=2, max_cycles=3)
    env.reset(seed=0)
    for name, team in TEAMS.items():
        policy, given = make_policy(name, env.config), []
        monkeypatch.setattr(type(policy), "give_truth", lambda self, *truth, to=given: to.append(truth), raising=False)
        begin(policy, name, env, 0)
        assert bool(given) == team.is_oracle, name
        monkeypatch.undo()
    assert [name for name, team in TEAMS.items() if team.is_oracle] == ORACLES


def test_teams_without_truth_are_given_beliefs_only():
    """Policies get a dict of beliefs; their files import nothing that holds a world, a plan or an environment."""
    for path in sorted(ROOT.rglob("*.py")):
        room = path.relative_to(ROOT).parts[0]
        if room not in ("teams", "shared", "slam_aware"):
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            names = [node.module] if isinstance(node, ast.ImportFrom) and not node.level else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                allowed = ("twc_env.config", "twc_env.errors", "twc_env.planning", "twc_env.records")
                assert not name.startswith("twc_env") or name.startswith(allowed), f"{path.name} imports {name}"
    assert {"world", "floorplan", "true_pose"}.isdisjoint(field for field in Belief.__slots__)


def test_every_team_has_a_file_of_150_lines_at_most_that_names_its_source():
    for name, team in TEAMS.items():
        path = ROOT / (team.module.replace(".", "/") + ".py")
        assert len(path.read_text().splitlines()) <= 150, name
        assert team.source
        assert len(team.summary) < 100
        year = team.source.split()[-1]
        if year.isdigit() and name != "nearest-frontier":
            assert year in path.read_text(), f"{name} does not name {team.source}"


@pytest.mark.parametrize("name", TEAMS)
def test_a_team_that_has_not_begun_an_episode_says_so(name):
    """In the next episode it went on with the goals and failures of the one before, for less floor."""
    config = {"lidar.beam_count": 60, "slam.k_visibility.enabled": name.startswith("radio")}
    env = twc_env.parallel_env(map="gen:office:100:1", robots=2, config=config)
    team = make_policy(name, env.config)
    env.reset(seed=0)
    for told in ("it knows no 'robot_0'", "at step 0: it was at step 3 before"):
        with pytest.raises(twc_env.TwcError, match=f"has not begun the episode, .*{told}; call .*begin"):
            team.act({agent: env.belief(agent) for agent in env.agents})
        begin(team, name, env, 0)
        for _ in range(4):
            env.step(team.act({agent: env.belief(agent) for agent in env.agents}))
        env.reset(seed=1)


def test_an_oracle_is_marked_in_tables():
    assert display_name("informed") == "informed (oracle)"
    assert display_name("minpos") == "minpos"
    assert display_name("mine.py:Mine") == "mine.py:Mine"


def test_the_documentation_lists_every_team_with_its_source():
    text = (ROOT.parent / "docs" / "agents.md").read_text()
    for name, team in TEAMS.items():
        assert f"| `{name}`" in text, name
        assert team.source in text, name


def test_every_team_is_in_its_module():
    for team in TEAMS.values():
        assert hasattr(import_module(f"twc_env.agents.{team.module}"), team.class_name)
