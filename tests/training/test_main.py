"""Training commands: invalid input gives an error message of one line."""

import os
import signal
import subprocess
import sys

import pytest

from twc_env.__main__ import main


@pytest.mark.usefixtures("torch")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["evaluate", "--model", "nowhere/model.safetensors"], "nowhere holds no training run"),
        (["evaluate", "--model", "nowhere"], "nowhere holds no training run"),
        (["evaluate", "--seeds", "a-b"], "seeds must be numbers and ranges"),
        (["evaluate", "--seeds", "0-99999999999"], "a range holds at most 100000 seeds; got 0-99999999999"),
        (["evaluate", "--seeds", "3,99999999999999999999"], "--seeds must be 0 to 2147483647"),
        (["evaluate", "--ray", "auto", "--jobs", "2"], "a Ray cluster uses all of its cores; leave it out with --ray"),
        (["evaluate", "--ray", "auto", "--films"], "--films with --ray: machines of a cluster would keep them"),
        (["train", "ppo", "--set", "lidar.beam_count"], "--set takes KEY=VALUE"),
        (["train", "ppo", "--set", "lidar.beam_cuont=9"], "did you mean 'beam_count'?"),
        (["train", "mappo", "--task", "ExploreQick-v1"], "did you mean 'ExploreQuick-v1'?"),
        (["train", "mappo", "--task", "ExploreQuick-v1", "--map", "twin-01"], "leave one of them out"),
        (["train", "mappo", "--task", "ExploreQuick-v1", "--area", "300"], "--area 300: it is of generated buildings"),
        (["train", "mappo", "--map", "twin-01", "--area", "300"], "--area 300: it is of generated buildings"),
        (["train", "es", "--set", "robots=4"], "--set robots=4: use --robots"),
        (["train", "ppo", "--set", "max_cycles=50"], "--set max_cycles=50: use --max-cycles"),
        (["train", "mappo", "--task", "ExploreQuick-v1", "--set", "map=twin-01"], "--set map=twin-01: use --map"),
        (["benchmark", "--set", "map=twin-02"], "--set map: the maps are chosen with --maps"),
        (["evaluate", "--buildings", "3"], "--buildings 3: it needs --suite v1"),
        (["evaluate", "--agents", "minpos", "random"], "--agents minpos random: it needs --suite v1"),
        (["evaluate"], "there is no runs/ppo: name the folder of your run, for example --model runs/quick"),
        (["evaluate", "--suite", "v1"], "there is no runs/ppo: name the folder of your run"),
        (
            ["evaluate", "--model", "learned"],
            "--model learned: a policy is shipped for a task of the suite; add --suite v1",
        ),
        (["evaluate", "--suite", "v1", "--agents", "minpos", "learned"], "--agents learned: it is a trained model, no"),
        (["evaluate", "--suite", "v1", "--seeds", "0-3"], "--seeds 0-3: --suite v1 plays --buildings of its tasks"),
        (["evaluate", "--suite", "v1", "--no-pictures"], "--no-pictures: --suite v1 plays"),
        (["train", "mappo", "--hidden-size", "6"], "--hidden-size must be a multiple of the 4 heads"),
        (["train", "ppo", "--resume"], "holds no training run"),
        (["train", "ppo", "--set", "slam.mode=off"], "slam.mode=off has none: remove that setting"),
        (
            ["train", "ppo", "--out", "/dev/null/run"],
            "cannot write to the folder /dev/null/run: /dev/null is a file; choose another",
        ),
    ],
)
def test_the_error_of_a_wrong_command_is_one_line_with_the_remedy(arguments, message, tmp_path, refusal, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert message in refusal(main, arguments)


@pytest.mark.usefixtures("torch")
def test_one_environment_takes_one_worker_and_a_team_says_how_many_robots_it_has(tmp_path, monkeypatch):
    from twc_env.training import mappo

    asked = []
    monkeypatch.setattr(mappo, "train", lambda task, settings, *_: asked.append((task, settings)) or tmp_path)
    assert main(["train", "mappo", "--environments", "1", "--references", "0", "--set", "team=turtlebots"]) == 0
    ((task, settings),) = asked
    assert (settings.workers, settings.environments) == (1, 1)
    assert task.config.robots == len(task.config.robot) == 3


@pytest.mark.usefixtures("torch")
def test_what_is_kept_from_a_learner_is_an_option_and_stays_so_when_it_goes_on(tmp_path, monkeypatch):
    from dataclasses import asdict

    from twc_env.training import mappo
    from twc_env.training.run_folder import write_settings

    asked = []

    def train(task, settings, folder, *_):
        asked.append(settings)
        write_settings(folder, "mappo", task, asdict(settings))
        return folder

    monkeypatch.setattr(mappo, "train", train)
    words = ["train", "mappo", "--references", "0", "--out", str(tmp_path)]
    switches = ["--no-attention", "--no-privileged-critic", "--no-from-rule"]
    assert main([*words, "--blind", "signs", "map", *switches]) == main([*words, "--resume"]) == 0
    first, resumed = asked
    assert first == resumed and first.blind == ("signs", "map")
    assert not (first.attention or first.privileged_critic or first.from_rule)


@pytest.mark.usefixtures("torch")
@pytest.mark.parametrize(
    ("has_viz", "lacks"), [(True, "an episode that has ended"), (False, "pip install 'twc_env[viz]'")]
)
def test_a_curve_that_cannot_be_drawn_names_what_lacks(has_viz, lacks, tmp_path, monkeypatch, capsys):
    from twc_env.training import mappo

    from twc_env.commands import train
    from twc_env.suite import curve_picture, references

    monkeypatch.setattr(mappo, "train", lambda *_: tmp_path)
    monkeypatch.setattr(references, "references", lambda *_, **__: {})
    monkeypatch.setattr(curve_picture, "draw_curve", lambda *_: None)
    monkeypatch.setattr(
        train, "find_spec", lambda name, own=train.find_spec: own(name) if name != "matplotlib" else has_viz
    )
    assert main(["train", "mappo"]) == 0
    said = capsys.readouterr().err
    assert said.strip() == f"no picture of the learning curve: it needs {lacks}"


def test_without_torch_the_error_names_what_to_install():
    code = """
import sys

class WithoutTorch:
    def find_spec(self, name, path=None, target=None):
        if name == "torch":
            raise ModuleNotFoundError(name, name=name)

sys.meta_path.insert(0, WithoutTorch())
from twc_env.__main__ import main
sys.exit(main(["train", "ppo"]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2
    assert "training needs torch; install it with: pip install 'twc_env[train]'" in done.stderr


@pytest.mark.usefixtures("torch")
def test_another_kind_of_action_or_observation_is_rejected(tmp_path, capsys):
    for setting in ("action.kind=velocity", "observation.kind=flat"):
        assert main(["train", "ppo", "--steps", "8", "--out", str(tmp_path / "run"), "--set", setting]) == 2
        assert "action.kind=frontier" in capsys.readouterr().err
    for block in ("pose", "team"):
        assert main(["train", "ppo", "--out", str(tmp_path / "run"), "--set", f"observation.{block}=false"]) == 2
        assert "keep observation.pose=true and observation.team=true" in capsys.readouterr().err


@pytest.mark.usefixtures("torch")
def test_the_error_of_a_dead_worker_names_resume(tmp_path, monkeypatch, capsys):
    from twc_env.vector.sb3 import TeamVecEnv

    step = TeamVecEnv.step_wait

    def killing(self):
        self.teams._runner._workers[0]._process.kill()
        return step(self)

    monkeypatch.setattr(TeamVecEnv, "step_wait", killing)
    assert main(["train", "ppo", "--workers", "2", "--area", "100", "--max-cycles", "60", "--out", str(tmp_path)]) == 2
    *_, last = capsys.readouterr().err.splitlines()
    assert (
        last.startswith("error: a worker process has died") and "--resume continues from the last saved model" in last
    )


@pytest.mark.usefixtures("torch")
def test_an_interrupted_training_reports_it_on_a_new_line(tmp_path, monkeypatch, capsys):
    from twc_env.vector.sb3 import TeamVecEnv

    def interrupt(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(TeamVecEnv, "step_wait", interrupt)
    assert (
        main(["train", "ppo", "--workers", "0", "--area", "100", "--max-cycles", "60", "--out", str(tmp_path)]) == 130
    )
    *_, last = capsys.readouterr().err.splitlines()
    assert last == "interrupted; --resume continues from the last saved model, if any"


@pytest.mark.usefixtures("torch")
@pytest.mark.parametrize(("end", "status"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_a_training_ended_from_outside_keeps_its_last_model_and_resumes(
    end, status, tmp_path, monkeypatch, capsys, refusal
):
    from twc_env.training import ppo

    rollouts, saved = [], ppo.save_model

    def save(model, *rest):
        saved(model, *rest)
        rollouts.append(model.num_timesteps)
        if len(rollouts) == 2:
            assert signal.getsignal(signal.Signals[end]) is not signal.SIG_DFL
            os.kill(os.getpid(), signal.Signals[end])

    monkeypatch.setattr(ppo, "save_model", save)
    sizes = ["--environments", "2", "--rollout-steps", "16", "--batch-size", "32", "--references", "0"]
    train = ["train", "ppo", "--workers", "0", "--area", "100", "--max-cycles", "60", "--out", str(tmp_path), *sizes]
    assert main([*train, "--steps", "100000"]) == status
    assert capsys.readouterr().err.endswith("interrupted; --resume continues from the last saved model, if any\n")
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_file()) == [
        "config.json", "metrics.csv", "model.safetensors",
    ]  # fmt: skip
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    rollouts += [0] * 9
    again = ["train", "ppo", "--workers", "0", "--out", str(tmp_path), "--references", "0", "--resume"]
    assert "trained with --max-cycles 60 instead of 90; use the same" in refusal(main, [*again, "--max-cycles", "90"])
    of_other = refusal(main, ["train", "mappo", *again[2:]])
    assert of_other == f"error: {tmp_path} was trained with ppo instead of mappo; use the same, or name another --out\n"
    assert main([*again, "--steps", "192"]) == 0  # with the task and the settings of the run
    with (tmp_path / "metrics.csv").open() as file:
        assert [row.split(",")[0] for row in file] == ["decisions", "64", "128", "192"]
