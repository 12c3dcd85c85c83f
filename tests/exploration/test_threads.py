"""One environment in several threads: a line that says so, and an episode that is not changed by it."""

import pickle
import threading

import numpy as np
import pytest

import twc_env
from twc_env.errors import TwcError
from twc_env.vector import VectorTeams

SMALL = {"robots": 2, "max_cycles": 40, "lidar.beam_count": 60}


def ahead(env) -> dict:
    return dict.fromkeys(env.agents, np.array([0.6, 0.2], np.float32))


def test_a_second_thread_is_refused_and_the_episode_goes_on_as_if_it_had_not_tried():
    env, alone = (twc_env.parallel_env(config=SMALL) for _ in range(2))
    for each in (env, alone):
        each.reset(seed=1)
    is_inside, may_go_on = threading.Event(), threading.Event()

    def stop() -> None:
        is_inside.set()
        assert may_go_on.wait(30)

    moment = env.snapshot()
    env.watch(stop)
    stepping = threading.Thread(target=lambda: env.step(ahead(env)))
    stepping.start()
    assert is_inside.wait(30)
    for call in (lambda: env.step(ahead(env)), lambda: env.reset(seed=2), lambda: env.restore(moment)):
        with pytest.raises(TwcError, match="at work in another thread: make one for each thread"):
            call()
    may_go_on.set()
    stepping.join(30)
    alone.step(ahead(alone))
    for _ in range(5):
        env.step(ahead(env))
        alone.step(ahead(alone))
        assert env.state().tolist() == alone.state().tolist()
    assert env.result().figures == alone.result().figures


def test_threads_that_take_turns_or_have_environments_of_their_own_are_not_refused():
    env = twc_env.parallel_env(config=SMALL)
    seen = []

    def play() -> None:
        env.reset(seed=3)
        for _ in range(5):
            env.step(ahead(env))
        seen.append(env.state().tolist())

    for _ in range(2):
        thread = threading.Thread(target=play)
        thread.start()
        thread.join(60)
    assert seen[0] == seen[1]
    assert pickle.loads(pickle.dumps(env)).reset(seed=3)


def test_an_error_or_an_interruption_within_a_step_leaves_the_environment_usable():
    env = twc_env.parallel_env(config=SMALL)
    env.reset(seed=1)

    def interrupt() -> None:
        raise KeyboardInterrupt

    env.watch(interrupt)
    with pytest.raises(KeyboardInterrupt):
        env.step(ahead(env))
    env.close()
    with pytest.raises(TwcError, match="needs a dict"):
        env.step(None)
    thread = threading.Thread(target=lambda: env.step(ahead(env)))
    thread.start()
    thread.join(60)
    assert env.episode.steps >= 1


def test_vector_teams_refuse_a_second_thread():
    teams = VectorTeams(2, SMALL)
    teams.reset(0)
    refused = []

    def step() -> None:
        try:
            teams.recv()
        except TwcError as error:
            refused.append(str(error))

    inner = teams._runner._envs[0]
    inner.watch(lambda: (thread.start(), thread.join(30)))
    thread = threading.Thread(target=step)
    teams.step(np.zeros((2, 2, 2)))
    assert refused == ["VectorTeams is at work in another thread: make one for each thread, or share a lock"]
    inner.close()
    teams.step(np.zeros((2, 2, 2)))
