"""Evaluation of trained teams in held-out buildings, with recording."""

import json
import math
import shutil
from dataclasses import replace

import pytest

from twc_env.__main__ import main

pytestmark = pytest.mark.usefixtures("torch")


def test_a_trained_model_is_evaluated_against_random_actions(run, tmp_path, capsys):
    figures = tmp_path / "figures.json"
    asked = ["evaluate", "--model", str(run / "model.safetensors"), "--seeds", "0-1", "--out", str(tmp_path / "out")]
    assert main([*asked, "--json", str(figures)]) == 0
    table = capsys.readouterr().out.splitlines()
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {
        "evaluation.json",
        "evaluation.csv",
        "evaluation.tex",
    }
    written = json.loads(figures.read_text())
    assert set(written) == {"trained", "random", "nearest", "nearest-frontier"}
    assert all(f"{of['means']['coverage']:.3f}" in line for of, line in zip(written.values(), table[1:], strict=True))
    assert [line.split()[0] for line in table] == ["policy", "trained", "random", "nearest", "nearest-frontier"]
    assert all(math.isfinite(float(line.split()[1])) for line in table[1:])


def test_recording_a_trained_team_does_not_affect_the_episode(run, tmp_path):
    pytest.importorskip("PIL", reason="needs the extra 'viz'")
    from twc_env.suite.evaluation import evaluate

    plain = evaluate(run, [0, 1], False)  # a run folder instead of a model file
    filmed = evaluate(run / "model.safetensors", [0, 1], False, tmp_path / "films")
    films = sorted(path.name for path in (tmp_path / "films").iterdir())
    assert len(films) == 2 and films[0].endswith("-seed0.gif") and films[1].endswith("-seed1.gif")
    assert filmed.episodes == plain.episodes
    assert evaluate(run, [0, 1], False, where=(2, None)).episodes == plain.episodes, "in two processes"


def test_coverage_does_not_depend_on_the_reward_of_training(task):
    from twc_env.suite.evaluation import _nearest, _played, _team, scripted

    team = replace(task, robots=3, max_cycles=60)
    alone = replace(team, overrides={**team.overrides, "reward.sharing": "individual"})
    for play in (
        lambda task: _played(task, 1, _team(task), _nearest),
        lambda task: scripted(task, "nearest-frontier", 1),
    ):
        assert play(alone) == play(team)


def test_the_coverage_of_a_wrong_merge_is_that_whose_mean_is_taken(task, monkeypatch):
    from twc_env.exploration.assessment import map_scores
    from twc_env.exploration.assessment.rewards import Standing
    from twc_env.suite.evaluation import scripted

    monkeypatch.setattr(map_scores, "standing", lambda *_: Standing([0.0] * 3, [[0.0] * 3]))
    played = scripted(replace(task, max_cycles=20), "nearest-frontier", 0)
    assert (played.coverage, played.mean_coverage, played.curve[-1]) == (0.0, 0.0, 0.0)


def test_the_error_of_a_model_of_another_view_names_what_to_do(task, run, tmp_path, capsys):
    from twc_env.training.run_folder import write_settings

    model = tmp_path / "model.safetensors"
    shutil.copy(run / "model.safetensors", tmp_path)
    write_settings(tmp_path, "ppo", replace(task, overrides={**task.overrides, "observation.gains": False}), {})
    assert main(["evaluate", "--model", str(model), "--seeds", "0"]) == 2
    assert "does not fit the settings in config.json" in capsys.readouterr().err
    model.unlink()
    assert main(["evaluate", "--model", str(model), "--seeds", "0"]) == 2
    assert "there is no model" in capsys.readouterr().err


def test_a_model_is_played_by_the_name_of_its_folder_and_refuses_other_observations(task, run):
    from twc_env.training.trained_policy import chooser_of

    import twc_env
    from twc_env.errors import DataError

    env = twc_env.parallel_env(config=task.config)
    seen, _ = env.reset(seed=0)
    assert set(chooser_of(run, env, 0)(seen, 0)) == set(env.agents)
    with pytest.raises(DataError, match="make the environment with the settings of its run"):
        chooser_of(run, twc_env.parallel_env(), 0)
    with pytest.raises(DataError, match="or the environment has others: it has another shape"):
        chooser_of(run, twc_env.parallel_env(config={"action.kind": "frontier"}), 0)


def test_one_building_is_printed_without_a_spread():
    from twc_env.suite.evaluation import POLICIES, Episode, Evaluation  # needs torch

    one = {name: (Episode(0.9, 0.5, 2, 0),) for name in POLICIES}
    rows = Evaluation((0,), one).table.splitlines()[1:]
    assert [row.split() for row in rows[:2]] == [
        ["trained", "0.900", "0.500", "2.00", "0"], ["random", "0.900", "0.500", "+0.000", "2.00", "0"]
    ]  # fmt: skip


@pytest.mark.filterwarnings("ignore")
def test_a_ray_cluster_evaluates_the_same_episodes(run, task, tmp_path):
    pytest.importorskip("ray", reason="needs the extra 'ray'")
    from twc_env.suite.evaluation import evaluate
    from twc_env.suite.references import references

    assert evaluate(run, [0, 1], False, where=(1, "auto")) == evaluate(run, [0, 1], False)
    assert references(task, tmp_path, 1, False, "auto") == references(task, tmp_path / "b", 1, False)
