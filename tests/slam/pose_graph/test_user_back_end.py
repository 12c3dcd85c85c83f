"""Custom back ends, named by their file."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import twc_env
from twc_env import ConfigError, DataError
from twc_env.__main__ import main
from twc_env.config import PoseGraphConfig
from twc_env.records.class_file import digest_of
from twc_env.records.geometry import between
from twc_env.slam.pose_graph import robust_back_end as robust_backend
from twc_env.slam.pose_graph.solver import Graph
from twc_env.slam.pose_graph.user_back_end import OwnBackEnd

LIBRARY = Path(__file__).parents[3] / "docs/library.md"
OWN = "trimmed.py:Trimmed"
SETTING = "slam.pose_graph.robust"
FAULTY = """

class Half: ...


class Bare:
    def solve(self, *_): ...


class Fewer:
    def __init__(self, rule): ...

    def solve(self, poses, edges, measured): ...


class Answers:
    def __init__(self, rule): ...

    def solve(self, poses, edges, *_):
        return {answer}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working folder, with the back end of docs/library.md."""
    monkeypatch.chdir(tmp_path)
    text = LIBRARY.read_text().partition("### Your own back end")[2]
    (tmp_path / "trimmed.py").write_text(re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0])
    return tmp_path


def ring():
    """A graph along a ring with two true closures and a false one: true poses, and initial poses with its parts."""
    turn = np.linspace(0, 2 * np.pi, 40)
    true = np.stack([5 * np.cos(turn), 5 * np.sin(turn), turn + np.pi / 2], axis=1)
    edges = np.array([(k, k + 1) for k in range(39)] + [(0, 39), (1, 38), (5, 20)])
    measured = between(true[edges[:, 0]], true[edges[:, 1]])
    measured[-1] = 0.0
    information = np.tile(np.diag([400.0, 400.0, 2500.0]), (len(edges), 1, 1))
    start = true + np.random.default_rng(0).normal(0.0, 0.05, true.shape)
    return true, (start, edges, measured, information, np.arange(len(edges)) >= 39)


def test_a_custom_back_end_selects_the_closures(folder):
    true, graph = ring()
    result = robust_backend.solve(*graph, PoseGraphConfig(robust=OWN), fixed=3)
    assert np.flatnonzero(~result.accepted).tolist() == [41]
    assert [(r.edge, r.reason) for r in result.rejections] == [(41, f"refused by {OWN}")]
    assert np.array_equal(result.poses[3], graph[0][3])
    assert between(result.poses[0], result.poses) == pytest.approx(between(true[0], true), abs=1e-3)


def test_robots_are_merged_with_a_custom_back_end(folder, capsys):
    settings = ["--set", f"{SETTING}={OWN}", "--map", "twin-01", "--steps", "700", "--seed", "1"]
    assert main(["explore", "--no-pictures", *settings, "--out", "run"]) == 0
    report = json.loads(Path("run/report.json").read_text())
    assert report["merged_robots"] >= 2 and report["wrong_merges"] == 0 and report["team_ate_m"] < 0.1
    assert report["back_end_digest"] == digest_of(OWN)


def test_a_custom_back_end_gets_copies_and_cannot_reject_odometry(tmp_path):
    path = tmp_path / "faulty.py"
    path.write_text(FAULTY.format(answer="poses.fill(0.0) or edges.fill(0) or (poses, edges[:, 0] > 0)"))
    start, *parts = ring()[1]
    graph, poses = Graph(*(part.copy() for part in parts)), start.copy()
    answer, believed = OwnBackEnd(PoseGraphConfig(robust=f"{path}:Answers")).solve(poses, graph, 0)
    assert not answer.any() and np.array_equal(believed, ~parts[-1])
    assert np.array_equal(poses, start)
    assert all(np.array_equal(held, given) for held, given in zip(graph.parts, parts, strict=True))


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ("poses", "must answer with (poses, which edges it believes); got an array of (40, 3)"),
        ("poses.tolist()", "which edges it believes); got [["),
        ("(poses[:-1], edges[:, 0] >= 0)", "must answer with 40 finite poses; got float64 of (39, 3)"),
        ("(poses * float('nan'), edges[:, 0] >= 0)", "finite poses"),
        ("(poses, edges[:, 0])", "must say of 42 edges, by a bool each"),
    ],
)
def test_invalid_results_of_a_back_end_are_rejected(answer, message, tmp_path):
    path = tmp_path / "faulty.py"
    path.write_text(FAULTY.format(answer=answer))
    with pytest.raises(DataError) as error:
        robust_backend.solve(*ring()[1], PoseGraphConfig(robust=f"{path}:Answers"))
    assert message in str(error.value) and len(str(error.value)) < 300


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Half", "has no solve: a back end has"),
        ("Whole", "there is no class 'Whole'"),
        ("Bare", r"Bare, when it is made, cannot be called with the settings \(slam.pose_graph\): too many"),
        ("Fewer", r"Fewer\.solve cannot be called with \(poses, .*, fixed\): too many positional"),
    ],
)
def test_an_invalid_back_end_is_rejected_before_the_episode(name, message, tmp_path):
    path = tmp_path / "faulty.py"
    path.write_text(FAULTY.format(answer=None))
    env = twc_env.parallel_env(config={SETTING: f"{path}:{name}"})
    with pytest.raises(ConfigError, match=message):
        env.reset(seed=0)
