"""Policies that come with the package."""

import pytest

from twc_env.suite.entries import entries
from twc_env.suite.models import model_for, model_in_task

pytestmark = pytest.mark.usefixtures("torch")


@pytest.mark.parametrize(
    ("name", "rival"), [("ExploreQuick-v1", "nearest-frontier"), ("ExplorePeers-v1", "information-gain")]
)
def test_the_team_learned_plays_the_policy_of_the_task_which_is_small_and_has_a_card(caplog, name, rival):
    from twc_env.training.shipped import FOLDER

    assert (FOLDER / name / "model.safetensors").stat().st_size < 2_000_000
    card = (FOLDER / name / "card.md").read_text()
    assert f"twc/{name}" in card.splitlines()[0] and rival in card
    entry = entries([f"twc/{name}"], ["learned"], "test", 1)[0]
    with caplog.at_level("INFO"):
        env, act = model_in_task(entry)
    assert model_for(entry)[0].parent == FOLDER / name
    seen, _ = env.reset(seed=0)
    assert set(act(seen)) == set(env.agents) and "no policy of its own" not in caplog.text


def test_in_a_task_without_a_policy_of_its_own_learned_plays_another_and_says_so_once(caplog):
    of_ward = entries(["twc/ExploreWard-v1"], ["learned"], "test", 2)
    with caplog.at_level("INFO"):
        assert [model_for(entry)[0].parent.name for entry in of_ward] == ["ExploreQuick-v1"] * 2
    said = "learned: twc/ExploreWard-v1 has no policy of its own; it plays the one for ExploreQuick-v1"
    assert caplog.text.count(said) == 1


def test_the_team_learned_explores_any_map_with_velocities_and_says_which_policy_it_is(caplog):
    from twc_env.agents.compare import explore

    from twc_env.config import override
    from twc_env.errors import ConfigError
    from twc_env.tasks import task_config

    config = override(task_config("twc/ExploreOffice-v0"), {"robots": 2, "max_cycles": 300, "map": "twin-01"})
    with caplog.at_level("INFO"):
        learned = explore(config, "learned", 0)
    assert "the shipped policy for ExploreQuick-v1" in caplog.text and "here 2 robots in twin-01" in caplog.text
    assert learned == explore(config, "learned", 0)
    assert learned.coverage_mean > explore(config, "random", 0).coverage_mean + 0.1
    with pytest.raises(ConfigError, match=r"remove failure"):
        explore(override(config, {"failure.robots": 1}), "learned", 0)


def test_the_shipped_policy_of_a_task_suits_its_settings_best(tmp_path, monkeypatch):
    from twc_env.training import shipped

    from twc_env.tasks import task_config

    for name in ("Quick", "Entrance", "Peers"):
        (tmp_path / f"Explore{name}-v1").mkdir()
        (tmp_path / f"Explore{name}-v1" / shipped.FILE_NAME).touch()
    monkeypatch.setattr(shipped, "FOLDER", tmp_path)
    for task, name in (
        ("Quick", "Quick"),
        ("Entrance", "Entrance"),
        ("Office", "Entrance"),
        ("Mall", "Entrance"),
        ("Peers", "Peers"),
    ):
        assert shipped.shipped_for(task_config(f"twc/Explore{task}-v1")).name == f"Explore{name}-v1"


def test_a_run_folder_is_a_team_in_every_command(tmp_path, caplog, refusal):
    from twc_env.agents import make_policy
    from twc_env.agents.explore import explore, origin_of
    from twc_env.training.shipped import FOLDER

    from twc_env.__main__ import main
    from twc_env.config import EnvConfig, override
    from twc_env.errors import ConfigError

    run = str(FOLDER / "ExploreQuick-v1")
    config = override(EnvConfig(), {"robots": 2, "max_cycles": 150, "map": "twin-02"})
    with caplog.at_level("INFO"):
        found = [explore(config, agent, 0).result.figures for agent in (run, f"{run}/model.safetensors", "learned")]
    assert found[0] == found[1] == found[2]
    assert f"{run}: a policy, trained with 3 robots" in caplog.text
    assert origin_of(config, run)["agent_digest"] and "agent_digest" not in origin_of(config, "learned")
    compared = ["compare", "--agents", "random", run, "--maps", "twin-02", "--steps", "20", "--out", str(tmp_path)]
    assert main([*compared, "--no-pictures"]) == 0
    assert "there is no model" in refusal(main, ["explore", "--agent", f"{run}/other.safetensors", "--steps", "5"])
    for name in (str(tmp_path), "x" * 300, "a\0b", 5):
        with pytest.raises(ConfigError, match=r"your own is FILE\.py:CLASS or a run folder of train"):
            make_policy(name, config)


def test_a_policy_that_is_told_of_other_maps_is_told_by_every_command(tmp_path, monkeypatch):
    """Teams with velocities get beliefs from their caller, and goals from an environment of their own."""
    from dataclasses import replace

    from twc_env.agents.compare import explore
    from twc_env.training import shipped
    from twc_env.training.checkpoint import save
    from twc_env.training.encoder import Actor
    from twc_env.training.run_folder import read_settings, task_of, write_settings
    from twc_env.training.team_notes import TeamNotes
    from twc_env.training.weights import arrays_of

    from twc_env.config import EnvConfig, override
    from twc_env.exploration.environment import ExplorationEnv
    from twc_env.exploration.observation.observations import ObservationBuilder

    record = read_settings(shipped.FOLDER / "ExploreQuick-v1")
    task = replace(task_of(record), overrides={"observation.other_maps": True})
    space = TeamNotes.space(ExplorationEnv(config=task.config).observation_space("robot_0"))
    write_settings(tmp_path, "es", task, record["settings"])
    save(tmp_path / shipped.FILE_NAME, arrays_of(Actor(space), "actor."), {"decisions": 0})
    told, build = [], ObservationBuilder.build

    def built(self, *given):
        seen = build(self, *given)
        told.extend(own["other_maps"].any() for own in seen if "other_maps" in own)
        return seen

    monkeypatch.setattr(ObservationBuilder, "build", built)
    explore(override(EnvConfig(), {"max_cycles": 200, "map": "gen:office:800:1"}), str(tmp_path), 0)
    assert any(told)
