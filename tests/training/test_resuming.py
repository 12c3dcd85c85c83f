"""Runs that are killed and resumed, or played by other processes, end with the bytes of one that was not."""

import csv
import multiprocessing
import os
import random
import shutil
import time
from dataclasses import replace

import pytest

pytestmark = pytest.mark.usefixtures("torch")
KILLS = int(os.environ.get("TWC_KILLS", "1"))


@pytest.fixture(scope="module", params=["mappo", "ppo", "es"])
def tiny(torch, request):
    """A function that trains, and settings of five updates."""
    from twc_env.training import evolution, mappo, ppo

    teams = {"seed": 3, "environments": 2, "workers": 0}
    sizes = {**teams, "epochs": 2, "hidden_size": 8}
    if request.param == "mappo":
        algorithm, settings = mappo, mappo.Settings(**sizes, steps=120, rollout_steps=8, minibatches=2)
    elif request.param == "es":
        algorithm, settings = evolution, evolution.Settings(**teams, steps=300)
    else:
        algorithm, settings = ppo, ppo.Settings(**sizes, steps=240, rollout_steps=12, batch_size=16)

    def play(task, settings, folder, resume=False, ray=None):
        return algorithm.train(task, settings, folder, resume, show_progress=False, ray=ray)

    return play, settings


@pytest.fixture(scope="module")
def whole(task, tiny, tmp_path_factory):
    """A run that was not interrupted."""
    play, settings = tiny
    folder = tmp_path_factory.mktemp("whole")
    play(task, settings, folder)
    return folder


def model_of(folder):
    return (folder / "model.safetensors").read_bytes()


def curve_of(folder):
    with (folder / "metrics.csv").open() as file:
        return [row[:-1] for row in csv.reader(file)]  # without the speed


def test_the_result_does_not_depend_on_the_number_of_processes(task, tiny, whole, tmp_path):
    play, settings = tiny
    play(task, replace(settings, workers=2), tmp_path)
    assert model_of(tmp_path) == model_of(whole)


def test_a_finished_run_that_is_resumed_says_that_there_is_nothing_to_train(task, tiny, whole, tmp_path, caplog):
    play, settings = tiny
    again = shutil.copytree(whole, tmp_path / "again")
    with caplog.at_level("INFO"):
        play(task, replace(settings, steps=10), again, resume=True)
    done = curve_of(whole)[-1][0]
    assert f"nothing to train: {again} has {done} decisions, --steps asks for 10" in caplog.text
    assert model_of(again) == model_of(whole) and curve_of(again) == curve_of(whole)


def test_a_run_that_is_resumed_ends_like_one_that_was_never_interrupted(task, tiny, whole, tmp_path, monkeypatch):
    from twc_env.training.learning_curve import LearningCurve

    note, noted, (play, settings) = LearningCurve.note, [], tiny

    def stop(self, *arguments):
        note(self, *arguments)
        noted.append(arguments)
        if len(noted) == 3:
            raise KeyboardInterrupt  # the row is written, the model is not

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(LearningCurve, "note", stop)
        play(task, settings, tmp_path)
    assert model_of(tmp_path) != model_of(whole)
    play(task, settings, tmp_path, resume=True)
    assert model_of(tmp_path) == model_of(whole)
    assert curve_of(tmp_path) == curve_of(whole)


def test_a_run_killed_at_random_moments_ends_like_one_that_was_never_interrupted(task, tiny, whole, tmp_path):
    """TWC_KILLS=20 in docs/learning.md; few by default, to be quick."""
    context, chance, folder, (play, settings) = (
        multiprocessing.get_context("fork"), random.Random(0), tmp_path / "run", tiny
    )  # fmt: skip
    began = time.perf_counter()
    process = context.Process(target=play, args=(task, settings, tmp_path / "timed"))
    process.start()
    process.join()
    duration_s, kills, finished = time.perf_counter() - began, 0, 0
    while kills < KILLS or not finished:
        resume = (folder / "model.safetensors").exists()
        process = context.Process(target=play, args=(task, settings, folder, resume))
        process.start()
        process.join(chance.uniform(0.0, duration_s) if kills < KILLS else None)
        if process.exitcode is None:
            process.kill()
            process.join()
            kills += 1
            continue
        assert process.exitcode == 0
        assert model_of(folder) == model_of(whole) and curve_of(folder) == curve_of(whole)
        shutil.rmtree(folder)
        finished += 1


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("accident", [False, True])
def test_a_ray_cluster_trains_the_same_bytes_also_if_a_worker_is_lost(
    task, tiny, whole, tmp_path, accident, monkeypatch
):
    ray = pytest.importorskip("ray", reason="needs the extra 'ray'")
    from twc_env.vector.ray_pool import RayPool

    play, settings = tiny
    submit, sent = RayPool.submit, []

    def losing(self, *arguments):
        submit(self, *arguments)
        sent.append(self)
        if accident and len(sent) == 9:
            ray.kill(self._actors[1])

    monkeypatch.setattr(RayPool, "submit", losing)
    play(task, replace(settings, workers=2), tmp_path, ray="auto")
    assert sent[0].workers == 2 and sent[0]._losses == accident
    assert model_of(tmp_path) == model_of(whole) and curve_of(tmp_path) == curve_of(whole)
