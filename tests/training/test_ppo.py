import csv
import importlib.util
import json
import math
import os
import shutil
import subprocess
import sys
import zipfile
from dataclasses import replace

import pytest

from training.__main__ import main
from twc_env.command_line import alone_in
from twc_env.errors import DataError, MapError

HAS_TORCH = all(importlib.util.find_spec(name) is not None for name in ("torch", "stable_baselines3"))
needs_torch = pytest.mark.skipif(
    not HAS_TORCH and "CI" not in os.environ, reason="needs torch and stable-baselines3: pip install 'twc_env[train]'"
)


def small_task():
    from training.run_folder import Task

    return Task(
        area_m2=100.0, buildings=2, max_cycles=80, overrides={"lidar.beam_count": 60, "action.decision_max_s": 2.0}
    )


def small_settings():
    from training.ppo import Settings

    return Settings(seed=3, environments=2, workers=0, rollout_steps=16, batch_size=32, epochs=2)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A folder with 128 decisions of training in it."""
    from training.ppo import train

    folder = tmp_path_factory.mktemp("ppo")
    train(small_task(), small_settings(), 128, folder, show_progress=False)
    return folder


def metrics_of(folder):
    with (folder / "metrics.csv").open() as file:
        return list(csv.DictReader(file))


def test_continuous_integration_has_torch_so_that_training_is_tested():
    assert HAS_TORCH or "CI" not in os.environ


@needs_torch
def test_a_short_training_leaves_a_complete_run_folder(run):
    assert {path.name for path in run.iterdir()} == {"config.json", "metrics.csv", "model.zip", "tensorboard"}
    record = json.loads((run / "config.json").read_text())
    assert record["settings"]["seed"] == 3
    assert record["environment"]["lidar"]["beam_count"] == 60
    assert len(record["config_digest"]) == 12
    rows = metrics_of(run)
    assert [int(row["steps"]) for row in rows] == [64, 128]
    assert 2 <= int(rows[-1]["episodes"]) <= 32
    assert math.isfinite(float(rows[-1]["mean_return"]))


@needs_torch
def test_tensorboard_shows_the_learning_curve_and_every_update_at_the_decisions_it_learnt_from(run):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    (folder,) = (run / "tensorboard").iterdir()
    events = EventAccumulator(str(folder))
    events.Reload()
    curve = {tag: [(event.step, event.value) for event in events.Scalars(tag)] for tag in events.Tags()["scalars"]}
    for tag, column, digits in (("rollout/ep_rew_mean", "mean_return", 4), ("rollout/ep_len_mean", "mean_length", 1)):
        shown = [(step, f"{value:.{digits}f}") for step, value in curve[tag]]
        assert shown == [(int(row["steps"]), row[column]) for row in metrics_of(run)]
    assert curve["train/learning_rate"] == [(64, pytest.approx(5e-4)), (128, 0.0)]
    assert {tag: [step for step, _ in values] for tag, values in curve.items() if tag.startswith("train/")} == {
        tag: [64, 128] for tag in curve if tag.startswith("train/")
    }


@needs_torch
def test_the_step_size_falls_to_nothing_and_no_further():
    from training.ppo import falling

    assert [falling(1e-3, left) for left in (1.0, 0.25, 0.0, -0.01)] == [1e-3, 2.5e-4, 0.0, 0.0]


@needs_torch
def test_a_trained_model_is_evaluated_against_random_actions(run, tmp_path, capsys):
    figures = tmp_path / "figures.json"
    assert main(["evaluate", "--model", str(run / "model.zip"), "--seeds", "0-1", "--json", str(figures)]) == 0
    table = capsys.readouterr().out.splitlines()
    written = json.loads(figures.read_text())
    assert set(written) == {"trained", "random", "nearest", "nearest-frontier"}
    assert all(f"{of['means']['coverage']:+.3f}" in line for of, line in zip(written.values(), table[1:], strict=True))
    assert [line.split()[0] for line in table] == ["policy", "trained", "random", "nearest", "nearest-frontier"]
    assert all(math.isfinite(float(line.split()[1])) for line in table[1:])


@needs_torch
def test_a_trained_team_is_filmed_and_plays_as_it_does_unseen(run, tmp_path):
    pytest.importorskip("PIL", reason="needs the extra 'viz'")
    from training.evaluate import evaluate

    plain, filmed = (evaluate(run / "model.zip", [0, 1], False, films) for films in (None, tmp_path / "films"))
    assert sorted(path.name for path in (tmp_path / "films").iterdir()) == ["episode-0.gif", "episode-1.gif"]
    assert filmed.episodes == plain.episodes


@needs_torch
def test_what_a_team_covers_does_not_depend_on_how_it_is_paid():
    from training.evaluate import _choosing, _nearest, _scripted

    team = replace(small_task(), robots=3, max_cycles=60)
    alone = replace(team, overrides={**team.overrides, "reward.sharing": "individual"})
    for play in (lambda task: _choosing(task, 1, _nearest), lambda task: _scripted(task, 1)):
        assert play(alone) == play(team)


@needs_torch
def test_going_on_with_another_number_of_processes_is_going_on(tmp_path):
    from training.ppo import train

    train(small_task(), small_settings(), 32, tmp_path, show_progress=False)
    train(small_task(), replace(small_settings(), workers=1), 64, tmp_path, resume=True, show_progress=False)
    assert int(metrics_of(tmp_path)[-1]["steps"]) == 64


@needs_torch
def test_the_same_seed_learns_the_same_weights(run, tmp_path):
    import torch
    from stable_baselines3 import PPO

    from training.ppo import train

    again = train(small_task(), small_settings(), 128, tmp_path, show_progress=False)
    first, second = (PPO.load(path, device="cpu").policy.state_dict() for path in (run / "model.zip", again))
    assert all(torch.equal(first[name], second[name]) for name in first)


@needs_torch
def test_training_resumes_where_it_stopped_and_keeps_the_learning_curve(tmp_path):
    from training.ppo import train

    train(small_task(), small_settings(), 64, tmp_path, show_progress=False)
    train(small_task(), small_settings(), 128, tmp_path, resume=True, show_progress=False)
    assert [int(row["steps"]) for row in metrics_of(tmp_path)] == [64, 128]
    episodes = [int(row["episodes"]) for row in metrics_of(tmp_path)]
    assert 0 < episodes[0] < episodes[1]


@needs_torch
def test_a_run_folder_that_was_moved_keeps_its_curves_together_when_it_resumes(tmp_path):
    from training.ppo import train

    train(small_task(), small_settings(), 64, tmp_path / "first", show_progress=False)
    (tmp_path / "first").rename(tmp_path / "moved")
    before = list((tmp_path / "moved").rglob("events.*"))
    train(small_task(), small_settings(), 128, tmp_path / "moved", resume=True, show_progress=False)
    assert not (tmp_path / "first").exists()
    assert len(list((tmp_path / "moved").rglob("events.*"))) == len(before) + 1


@needs_torch
def test_an_interrupted_training_says_so_on_a_line_of_its_own(tmp_path, monkeypatch, capsys):
    from twc_env.sb3 import TeamVecEnv

    def interrupt(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(TeamVecEnv, "step_wait", interrupt)
    assert main(["ppo", "--workers", "0", "--area", "100", "--max-cycles", "60", "--out", str(tmp_path)]) == 130
    *_, last = capsys.readouterr().err.splitlines()
    assert last == "interrupted; --resume goes on from the last model that was saved, if any"


@needs_torch
def test_a_line_ahead_of_its_model_is_dropped_when_a_killed_training_resumes(tmp_path):
    from training.ppo import train

    train(small_task(), small_settings(), 64, tmp_path, show_progress=False)
    with (tmp_path / "metrics.csv").open("a") as file:
        file.write("128,9,0.5,3.0,100.0\n160,1")  # killed before the model was saved, and within a line
    train(small_task(), small_settings(), 128, tmp_path, resume=True, show_progress=False)
    rows = metrics_of(tmp_path)
    assert [int(row["steps"]) for row in rows] == [64, 128]
    assert rows[1]["steps_per_s"] != "100.0"


@needs_torch
def test_a_model_that_is_broken_or_of_another_task_is_named(run, tmp_path, capsys):
    from stable_baselines3 import PPO

    from training.run_folder import write_settings

    shutil.copy(run / "config.json", tmp_path)
    sound, model = (run / "model.zip").read_bytes(), tmp_path / "model.zip"
    bent = bytearray(sound)
    bent[len(bent) // 2] ^= 255
    with zipfile.ZipFile(tmp_path / "foreign.zip", "w") as file:
        file.writestr("hello", "")
    PPO("MlpPolicy", "CartPole-v1", device="cpu").save(tmp_path / "other.zip")
    foreign = [(tmp_path / name).read_bytes() for name in ("foreign.zip", "other.zip")]
    for content in (sound[:1000], bytes(bent), b"", *foreign):
        model.write_bytes(content)
        assert main(["evaluate", "--model", str(model), "--seeds", "0"]) == 2
        assert f"cannot read the model {model}" in capsys.readouterr().err
    model.write_bytes(sound)
    task = small_task()
    write_settings(tmp_path, "ppo", replace(task, overrides={**task.overrides, "observation.sign_slots": 2}), {})
    assert main(["evaluate", "--model", str(model), "--seeds", "0"]) == 2
    assert "was trained to see or choose something else" in capsys.readouterr().err
    model.unlink()
    assert main(["evaluate", "--model", str(model), "--seeds", "0"]) == 2
    assert "there is no model" in capsys.readouterr().err


@pytest.mark.parametrize("change", ['{"kindz": 1}', "3", '{"kinds": [], "area_m2": "big"}'])
def test_settings_of_a_run_that_are_no_settings_are_named(change, tmp_path):
    from training.run_folder import read_settings

    (tmp_path / "config.json").write_text(f'{{"task": {change}, "settings": {{}}, "config_digest": ""}}')
    with pytest.raises(DataError, match="holds a task of another form"):
        read_settings(tmp_path)
    (tmp_path / "config.json").write_text("[]")
    with pytest.raises(DataError, match="lacks config_digest"):
        read_settings(tmp_path)


@needs_torch
def test_a_wrong_map_leaves_no_run_folder(tmp_path):
    from training.ppo import train
    from training.run_folder import Task

    with pytest.raises(MapError, match="no map named 'twin-3'"):
        train(Task("twin-3"), small_settings(), 128, tmp_path / "run")
    assert not (tmp_path / "run").exists()


@needs_torch
def test_resuming_with_another_task_is_refused(run):
    from training.ppo import train
    from training.run_folder import Task

    with pytest.raises(DataError, match="trained with another task"):
        train(Task("twin-02"), small_settings(), 512, run, resume=True)


@needs_torch
def test_two_trainings_do_not_share_a_folder(tmp_path):
    from training.ppo import train

    (tmp_path / "run").mkdir()
    with (
        alone_in(tmp_path / "run"),
        pytest.raises(DataError, match=r"another command writes to .*run: wait for its end"),
    ):
        train(small_task(), small_settings(), 128, tmp_path / "run")
    assert not list((tmp_path / "run").iterdir())


@needs_torch
def test_a_finished_run_is_not_overwritten(run):
    from training.ppo import train

    with pytest.raises(DataError, match="already holds a model; go on with --resume"):
        train(small_task(), small_settings(), 128, run)


@needs_torch
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["evaluate", "--model", "nowhere/model.zip"], "nowhere holds no training run"),
        (["evaluate", "--seeds", "a-b"], "seeds must be numbers and ranges"),
        (["ppo", "--steps", "0"], "--steps must be at least 1; got 0"),
        (["ppo", "--set", "lidar.beam_count"], "--set takes KEY=VALUE"),
        (["ppo", "--set", "lidar.beam_cuont=9"], "did you mean 'beam_count'?"),
        (["ppo", "--resume"], "holds no training run"),
        (["ppo", "--seed", "-1"], "--seed must be 0 to"),
        (
            ["ppo", "--out", "/dev/null/run"],
            "cannot write to the folder /dev/null/run: /dev/null is a file; choose another",
        ),
    ],
)
def test_a_wrong_command_ends_in_one_line_that_names_the_remedy(arguments, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and message in error
    assert error.count("\n") == 1


def test_without_torch_the_error_names_what_to_install():
    code = "import sys; sys.modules['torch'] = None; from training.__main__ import main; sys.exit(main(['ppo']))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2
    assert "training needs torch; install it with: pip install 'twc_env[train]'" in done.stderr


@needs_torch
def test_a_choice_that_the_mask_rules_out_is_never_taken(run):
    import numpy as np
    from stable_baselines3 import PPO

    from training.run_folder import read_settings, task_of

    model = PPO.load(run / "model.zip", device="cpu")
    observation = {
        name: np.zeros((1, *space.shape), space.dtype) for name, space in model.observation_space.spaces.items()
    }
    assert task_of(read_settings(run)) == small_task()
    for only in range(observation["action_mask"].shape[1]):
        observation["action_mask"][:] = 0
        observation["action_mask"][0, only] = 1
        for deterministic in (True, False):
            assert model.predict(observation, deterministic=deterministic)[0].tolist() == [only]


@needs_torch
def test_another_kind_of_action_or_observation_is_refused(tmp_path, capsys):
    for setting in ("action.kind=velocity", "observation.kind=flat"):
        assert main(["ppo", "--steps", "8", "--out", str(tmp_path / "run"), "--set", setting]) == 2
        assert "action.kind=frontier" in capsys.readouterr().err
    for block in ("pose", "team"):
        assert main(["ppo", "--out", str(tmp_path / "run"), "--set", f"observation.{block}=false"]) == 2
        assert "leave observation.pose=true and observation.team=true" in capsys.readouterr().err


@needs_torch
def test_the_policy_scores_each_choice_by_its_own_figures_and_never_takes_a_masked_one(run):
    import numpy as np
    import torch
    from stable_baselines3 import PPO

    policy = PPO.load(run / "model.zip", device="cpu").policy
    seen = {k: np.zeros((1, *s.shape), s.dtype) for k, s in policy.observation_space.items()}
    random = np.random.default_rng(0)
    seen["frontiers"] = random.uniform(-1, 1, seen["frontiers"].shape).astype(np.float32)
    seen["action_mask"][0, [0, 2, 5, -1]] = 1

    def chances(seen):
        tensors, _ = policy.obs_to_tensor(seen)
        return policy.get_distribution(tensors).distribution.probs[0].detach()

    first = chances(seen)
    assert first[[0, 2, 5, -1]].sum() == pytest.approx(1.0)
    swapped = {**seen, "frontiers": seen["frontiers"].copy()}
    swapped["frontiers"][0, [0, 5]] = seen["frontiers"][0, [5, 0]]
    assert torch.allclose(chances(swapped)[[5, 0]], first[[0, 5]], atol=1e-6)


@needs_torch
def test_who_chooses_does_not_know_what_was_gained_but_the_value_does(run):
    import numpy as np
    import torch
    from stable_baselines3 import PPO

    policy = PPO.load(run / "model.zip", device="cpu").policy
    seen = {k: np.zeros((1, *s.shape), s.dtype) for k, s in policy.observation_space.items()}
    seen["action_mask"][:] = 1
    poor, rich = (policy.obs_to_tensor({**seen, "gained": np.array([[x]], np.float32)})[0] for x in (0.0, 0.8))
    logits = [policy.get_distribution(tensors).distribution.logits for tensors in (poor, rich)]
    assert torch.equal(*logits)
    assert not torch.equal(policy.predict_values(poor), policy.predict_values(rich))
