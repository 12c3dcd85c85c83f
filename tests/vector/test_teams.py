import contextlib
import multiprocessing
import os
import signal
from pathlib import Path

import numpy as np
import pytest

import twc_env
from twc_env.config import override
from twc_env.errors import ActionError, ConfigError, DataError, MapError, TwcError, WorkerError
from twc_env.tasks import task_config
from twc_env.vector.teams import VectorTeams

SMALL = {"lidar.beam_count": 60, "robots": 2, "max_cycles": 25, "observation.map_cells": 36}
CHOICES = {**SMALL, "action.kind": "frontier", "max_cycles": 60}


def play(teams: VectorTeams, steps: int, seed: int = 5) -> list:
    rng = np.random.default_rng(0)
    blocks = teams.reset(seed)
    seen: list = [blocks]
    for _ in range(steps):
        if "action_mask" in blocks:
            actions = blocks["action_mask"].argmax(axis=-1)
        else:
            actions = rng.uniform(-1, 1, (teams.count, teams.robots, 2)).astype(np.float32)
        seen.append(teams.step(actions))
        blocks = seen[-1][0]
    teams.close()
    return seen


def same(a, b) -> bool:
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return bool(np.array_equal(np.asarray(a), np.asarray(b)))


@pytest.mark.parametrize("config", [SMALL, CHOICES], ids=["velocity", "frontier"])
def test_worker_processes_give_the_same_numbers_as_this_process(config):
    alone = play(VectorTeams(3, config), 30)
    shared = play(VectorTeams(3, config, workers=2), 30)
    assert same(alone, shared)


def test_each_environment_plays_as_it_would_alone():
    teams = VectorTeams(2, SMALL)
    observations = teams.reset(7)
    env = twc_env.parallel_env(config=SMALL)
    alone = env.reset(seed=8)[0]
    for step in range(25):
        action = np.array([0.7, 0.2 * np.sin(step)], np.float32)
        for name, block in observations.items():
            assert np.array_equal(block[1, 0], alone["robot_0"][name]), name
        observations, rewards, ended, infos = teams.step(np.broadcast_to(action, (2, 2, 2)))
        alone, paid, *_, alone_infos = env.step(dict.fromkeys(env.agents, action))
        assert rewards[1].tolist() == pytest.approx(list(paid.values()))
    assert ended.all()
    assert same(infos[1][0]["final_observation"], alone["robot_0"])
    assert infos[1][0]["coverage_correct"] == alone_infos["robot_0"]["coverage_correct"]
    assert not same({k: v[1, 0] for k, v in observations.items()}, alone["robot_0"]), "a new episode has begun"


@pytest.mark.parametrize("workers", [0, 2])
def test_last_observations_name_their_blocks_in_the_order_of_the_others(workers):
    *_, (observations, _, ended, infos) = play(VectorTeams(2, {**SMALL, "max_cycles": 2}, workers), 2)
    assert ended.all()
    assert all(list(info["final_observation"]) == list(observations) for team in infos for info in team)


@pytest.mark.parametrize("workers", [0, 2])
def test_centralised_critics_get_the_state_of_each_environment_and_that_in_which_an_episode_ended(workers):
    teams = VectorTeams(3, SMALL, workers=workers)
    teams.reset(7)
    env = twc_env.parallel_env(config=SMALL)
    env.reset(seed=9)
    assert teams.states().shape == (3, 12)
    action = np.array([0.7, 0.2], np.float32)
    for _ in range(25):
        assert np.array_equal(teams.states()[2], env.state())
        *_, infos = teams.step(np.broadcast_to(action, (3, 2, 2)))
        env.step(dict.fromkeys(env.agents, action))
    assert np.array_equal(infos[2][1]["final_state"], env.state())
    env.reset(seed=12)
    assert np.array_equal(teams.states()[2], env.state())
    teams.close()


def test_teams_play_a_standard_task_with_other_settings_of_the_caller():
    with VectorTeams(1, {"max_cycles": 7}, task="twc/ExploreQuick-v1") as teams:
        assert teams.config == override(task_config("twc/ExploreQuick-v1"), {"max_cycles": 7})
    with pytest.raises(ConfigError, match="did you mean 'twc/ExploreQuick-v1'"):
        VectorTeams(1, task="twc/ExploreQick-v1")


def test_episodes_change_buildings():
    names = ("gen:office:100:1", "gen:ring:100:2")
    teams = VectorTeams(2, SMALL, buildings=names)
    teams.reset(0)
    maps = [env.floorplan.name for env in teams._runner._envs.values()]
    assert maps == list(names)
    assert VectorTeams(1, SMALL, buildings="train").reset(3)["lidar"].any()


def test_what_a_caller_holds_is_not_changed_by_the_next_step():
    teams = VectorTeams(1, SMALL)
    held = teams.reset(0)
    copies = {name: block.copy() for name, block in held.items()}
    teams.step(teams.sample())
    assert same(held, copies)


@pytest.mark.parametrize("config", [SMALL, CHOICES], ids=["velocity", "frontier"])
def test_random_actions_follow_from_the_seed_of_the_reset(config):
    def told(seed):
        with VectorTeams(2, config) as teams:
            teams.reset(seed)
            return [teams.sample() for _ in range(9)]

    assert same(told(3), told(3)) and not same(told(3), told(4))


def test_errors_reach_the_caller_and_name_what_was_expected():
    with pytest.raises(ConfigError, match="workers"):
        VectorTeams(2, SMALL, workers=3)
    for workers in (0, 2):
        teams = VectorTeams(2, SMALL, workers=workers)
        teams.reset(0)
        with pytest.raises(ActionError, match="shape"):
            teams.step(np.zeros((2, 3, 2)))
        with pytest.raises(ActionError, match="finite"):
            teams.step(np.full((2, 2, 2), np.nan))
        teams.step(np.zeros((2, 2, 2)))  # nothing is broken by it
        teams.close()
        with pytest.raises(TwcError, match="closed"):
            teams.reset(0)
    with pytest.raises(MapError, match="nowhere"):
        VectorTeams(1, SMALL, workers=1, buildings=["nowhere"]).reset(0)


@pytest.mark.parametrize(
    ("actions", "words"),
    [
        (None, r"numbers of shape \(2, 2, 2\); got NoneType None"),
        ("forward", r"numbers of shape \(2, 2, 2\); got str 'forward'"),
        ([[[0.1, 0.2]], [[0.1, 0.2], [0.3, 0.4]]], r"numbers of shape \(2, 2, 2\); got list \[\[\[0.1"),
        ({"robot_0": 1}, r"numbers of shape \(2, 2, 2\); got dict"),
        (np.full((2, 2, 2), "a"), r"numbers of shape \(2, 2, 2\); got ndarray"),
        (np.ma.masked_array(np.zeros((2, 2, 2)), np.eye(2, dtype=bool)[None].repeat(2, 0)), "got MaskedArray"),
        (np.zeros((2, 2, 2), complex), "real numbers from -1.0 to 1.0; got complex128"),
        (np.zeros((2, 2, 2), bool), "real numbers from -1.0 to 1.0; got bool"),
    ],
    ids=["None", "text", "ragged", "dict", "array of text", "masked", "complex", "bool"],
)
def test_actions_that_are_no_array_of_numbers_are_named_in_one_line(actions, words):
    teams = VectorTeams(2, SMALL)
    teams.reset(0)
    with pytest.raises(ActionError, match=words) as caught:
        teams.step(actions)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 250
    teams.step(np.zeros((2, 2, 2)))


@pytest.mark.parametrize(
    "run",
    [
        lambda teams: teams.step(np.zeros((2, 2, 2))),
        lambda teams: (teams.send(np.zeros((2, 2, 2)), [0, 1]), teams.recv(2)),
        lambda teams: teams.states(),
        lambda teams: teams.reset(1),
    ],
    ids=["step", "recv", "states", "reset"],
)
def test_a_dead_worker_is_reported(run):
    teams = VectorTeams(2, SMALL, workers=2)
    teams.reset(0)
    teams._runner._workers[0]._process.kill()
    teams._runner._workers[0]._process.join()
    with pytest.raises(WorkerError, match="died"):
        run(teams)
    with pytest.raises(TwcError, match="closed"):
        teams.recv()


@pytest.mark.parametrize("workers", [0, 1, 2])
def test_this_process_is_the_first_worker(workers):
    before = set(multiprocessing.active_children())
    teams = VectorTeams(2, SMALL, workers=workers)
    own = set(multiprocessing.active_children()) - before
    assert len(own) == max(workers - 1, 0)
    teams.close()
    for process in own:
        process.join(30.0)  # on a busy machine a process takes a while to end
    assert not any(process.is_alive() for process in own)


def test_the_worker_processes_end_with_the_last_reference_or_with_a_with_block():
    before = set(multiprocessing.active_children())
    teams = VectorTeams(2, SMALL, workers=2)
    (worker,) = set(multiprocessing.active_children()) - before
    del teams
    worker.join(30.0)
    assert not worker.is_alive()
    with VectorTeams(2, SMALL, workers=2) as teams:
        (worker,) = set(multiprocessing.active_children()) - before
        teams.reset(0)
    worker.join(30.0)
    assert not worker.is_alive()
    teams.close()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_a_forked_process_that_drops_its_copy_ends_no_worker():
    teams = VectorTeams(2, SMALL, workers=2)
    child = os.fork()
    if child == 0:
        del teams
        os._exit(0)
    os.waitpid(child, 0)
    assert teams.reset(0)["lidar"].any()
    teams.close()


def test_a_process_that_may_start_no_others_is_told_to_use_no_workers(monkeypatch):
    monkeypatch.setitem(multiprocessing.current_process()._config, "daemon", True)
    with pytest.raises(ConfigError, match=r"workers=2: this process is itself a worker .* use 0"):
        VectorTeams(2, SMALL, workers=2)
    VectorTeams(2, SMALL, workers=1).close()


@pytest.mark.parametrize("workers", [0, 2])
def test_each_environment_may_be_given_its_own_seed(workers):
    with VectorTeams(2, {**SMALL, "max_cycles": 1}, workers) as teams, VectorTeams(1, SMALL) as alone:
        for seeds in ([9, 4], np.array([9, 4]), (np.int64(9), 4)):
            observations = teams.reset(seeds)
            for k, seed in enumerate((9, 4)):
                assert same({name: block[k] for name, block in observations.items()}, first(alone, seed))
        observations, *_ = teams.step(np.zeros((2, 2, 2)))
        for k, seed in enumerate((11, 6)):
            assert same({name: block[k] for name, block in observations.items()}, first(alone, seed))
        for wrong in ([1], [1, 2, 3], [1, -2], [1, "2"], "12", [[1, 2]], np.zeros((2, 1), int), [1, 2.0]):
            with pytest.raises(ConfigError, match="seed"):
                teams.reset(wrong)


def first(teams: VectorTeams, seed: int) -> dict:
    return {name: block[0] for name, block in teams.reset(seed).items()}


def act(config: dict, k: int, place: int, observations: dict) -> np.ndarray:
    """Of environment k in its step number `place`, from nothing but what it has returned."""
    if "action_mask" in observations:
        return observations["action_mask"].argmax(axis=-1)
    return np.random.default_rng((k, place)).uniform(-1, 1, (2, 2)).astype(np.float32)


@pytest.mark.parametrize(
    "config", [SMALL, CHOICES, {**SMALL, "observation.kind": "flat"}], ids=["dict", "masks", "flat"]
)
@pytest.mark.parametrize(("workers", "batch"), [(0, 1), (0, 2), (1, 2), (2, 1), (2, 2), (2, 3)])
def test_environments_sent_to_at_any_time_return_what_they_return_in_lockstep(config, workers, batch):
    count, steps = 3, 30
    wanted: dict[tuple[int, int], tuple] = {}
    with contextlib.closing(VectorTeams(count, config)) as teams:
        blocks = teams.reset(5)
        for place in range(steps):
            each = [{name: block[k] for name, block in blocks.items()} for k in range(count)]
            blocks, *rest = teams.step(np.stack([act(config, k, place, each[k]) for k in range(count)]))
            for k in range(count):
                wanted[k, place] = {name: block[k] for name, block in blocks.items()}, *(part[k] for part in rest)
    assert any(ended for _, _, ended, _ in wanted.values())
    places = [0] * count
    with contextlib.closing(VectorTeams(count, config, workers)) as teams:
        blocks, ids, pending = teams.reset(5), list(range(count)), 0
        while wanted:
            going = [(row, k) for row, k in enumerate(ids) if places[k] < steps]
            actions = [act(config, k, places[k], {name: b[row] for name, b in blocks.items()}) for row, k in going]
            if going:
                teams.send(np.stack(actions), [k for _, k in going])
            pending += len(going)
            ids, blocks, *rest = teams.recv(min(batch, pending))
            pending -= len(ids)
            for row, k in enumerate(ids.tolist()):
                got = {name: block[row] for name, block in blocks.items()}, *(part[row] for part in rest)
                assert same(got, wanted.pop((k, places[k]))), (k, places[k])
                assert {type(value) for info in got[3] for value in info["reward_terms"].values()} == {float}
                places[k] += 1


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="needs a process that can be stopped for a while")
def test_nobody_waits_for_the_slowest_environment():
    with contextlib.closing(VectorTeams(3, SMALL, workers=2)) as teams:
        teams.reset(0)
        slow = teams._runner._workers[0]._process.pid
        os.kill(slow, signal.SIGSTOP)
        os.waitid(os.P_PID, slow, os.WSTOPPED | os.WNOWAIT)
        try:
            teams.send(teams.sample(), range(3))
            for _ in range(4):
                ids = teams.recv(2)[0]
                assert sorted(ids) == [0, 2]
                teams.send(teams.sample()[ids], ids)
        finally:
            os.kill(slow, signal.SIGCONT)
        assert sorted(teams.recv()[0]) == [0, 1, 2]


@pytest.mark.parametrize("workers", [0, 2])
def test_states_and_masks_of_some_are_there_while_others_have_not_answered(workers):
    with contextlib.closing(VectorTeams(3, CHOICES, workers)) as teams:
        teams.reset(0)
        states, masks = teams.states(), teams.action_masks()
        teams.send(masks[[0, 2]].argmax(axis=-1), [0, 2])
        assert np.array_equal(teams.states([1]), states[1:2]) and np.array_equal(teams.action_masks([1]), masks[1:2])
        for ask in (teams.states, teams.action_masks, lambda: teams.action_masks([2]), teams.sample):
            with pytest.raises(ActionError, match=r"environment [02] has a step that was not yet received"):
                ask()
        assert sorted(teams.recv(2)[0]) == [0, 2]
        assert not np.array_equal(teams.states()[0], states[0])


@pytest.mark.parametrize("workers", [0, 2])
def test_what_cannot_be_sent_or_received_is_refused_and_nothing_is_started(workers):
    still = np.zeros((3, 2, 2))
    with contextlib.closing(VectorTeams(3, SMALL, workers)) as teams:
        teams.reset(0)
        with pytest.raises(TwcError, match="0 environments have actions"):
            teams.recv()
        teams.send(still[:1], [1])
        for ids, message in (
            ([0, 1], "environment 1 has a step that was not yet received"),
            ([3], "there is no environment 3; ids are 0 to 2"),
            ([-1], "there is no environment -1"),
            ([0, 0], "one action at a time"),
            ([0.0], "ids must be whole numbers from 0 to 2"),
            (0, "ids must be whole numbers from 0 to 2"),
        ):
            with pytest.raises(ActionError, match=message):
                teams.send(still[: len(np.atleast_1d(ids))], ids)
        with pytest.raises(ActionError, match=r"shape \(1, 2, 2\)"):
            teams.send(still, [2])
        with pytest.raises(ActionError, match="robot 0 in environment 2 must be finite"):
            teams.send(np.full((1, 2, 2), np.nan), [2])
        with pytest.raises(ActionError, match="environment 1 has a step"):
            teams.step(still)
        for count in (2, 5):
            with pytest.raises(TwcError, match=rf"1 environments have actions; recv\({count}\)"):
                teams.recv(count)
        with pytest.raises(ConfigError, match="count must be a whole number"):
            teams.recv(0)
        assert teams.recv()[0].tolist() == [1]
        teams.step(still)
    for use in (lambda: teams.send(still, range(3)), lambda: teams.step(still), teams.reset, teams.states):
        with pytest.raises(TwcError, match="closed"):
            use()


@pytest.mark.parametrize("workers", [0, 2])
def test_a_reset_drops_what_was_not_received(workers):
    with contextlib.closing(VectorTeams(3, SMALL, workers)) as teams:
        first = teams.reset(4)
        teams.send(teams.sample(), range(3))
        teams.recv(1)
        assert same(teams.reset(4), first)
        assert sorted((teams.send(np.zeros((2, 2, 2)), [0, 2]), teams.recv())[1][0]) == [0, 2]


@pytest.mark.parametrize("workers", [0, 2])
def test_an_error_of_an_environment_reaches_who_receives_it(workers, tmp_path):
    plan = tmp_path / "mine.json"
    plan.write_text((Path(__file__).parents[2] / "maps" / "twin-01.json").read_text())
    with contextlib.closing(VectorTeams(2, SMALL, workers, buildings=[str(plan)])) as teams:
        teams.reset(0)
        plan.unlink()
        with pytest.raises(MapError, match=r"mine\.json"):
            for _ in range(25):
                teams.step(np.zeros((2, 2, 2)))


FAULTY = """
class Unportable(Exception):
    def __init__(self, first, second):
        super().__init__(f"{first} and {second}")

class Faulty:
    name = "faulty"

    def __init__(self, config, range_max_m):
        pass

    def propose(self, keyframe, skipped_robots=()):
        raise ERROR

    def score(self, target, source):
        return 0.0

    def sparsify(self, is_held):
        pass
"""


@pytest.mark.parametrize("workers", [0, 2])
@pytest.mark.parametrize(
    ("raised", "caught", "message"),
    [
        ("ZeroDivisionError('mine')", ZeroDivisionError, "^mine$"),
        ("Unportable(1, 2)", Exception, "1 and 2"),
    ],
    ids=["portable", "unportable"],
)
def test_an_error_of_the_users_own_code_is_raised_as_without_workers(tmp_path, workers, raised, caught, message):
    (tmp_path / "faulty.py").write_text(FAULTY.replace("ERROR", raised))
    own = {**SMALL, "slam.place_recognition.recogniser": f"{tmp_path / 'faulty.py'}:Faulty"}
    with contextlib.closing(VectorTeams(2, own, workers)) as teams:
        if workers:  # the first environment is of this process, and its error would be raised first
            teams._runner._own.submit = lambda *_: None
            teams._runner._own.results = lambda count: iter([(0, [])] * count)
        with pytest.raises(caught, match=message) as told:
            teams.reset(0)
        if workers:
            assert "in propose" in str(told.value.__cause__), "the traceback of the worker process"
        assert not isinstance(told.value, TwcError)
        with pytest.raises(TwcError, match="closed"):
            teams.reset(0)


@pytest.mark.parametrize(("what", "least"), [("count", 1), ("workers", 0)])
@pytest.mark.parametrize("number", [-1, 0.5, "1", True, None])
def test_what_is_no_number_of_environments_or_workers_is_refused(what, least, number):
    for wrong in (number, least - 1):
        with pytest.raises(ConfigError, match=f"{what} must be a whole number of at least {least}; got {wrong!r}"):
            VectorTeams(**{"count": 2, what: wrong}, config=SMALL)


def test_numbers_of_numpy_count_environments_and_workers():
    with contextlib.closing(VectorTeams(np.int64(2), SMALL, workers=np.int32(0))) as teams:
        assert teams.reset(np.uint8(0))["lidar"].shape[:2] == (2, 2)


@pytest.mark.parametrize(
    ("buildings", "error"),
    [(None, ConfigError), (5, ConfigError), (["twin-01", 5], ConfigError), (["twin-01", "nowhere"], MapError)],
)
def test_buildings_that_do_not_exist_are_refused_before_the_first_episode(buildings, error):
    with pytest.raises(error, match=r"building|nowhere"):
        VectorTeams(1, SMALL, buildings=buildings)


def test_of_buildings_that_are_drawn_only_one_of_a_kind_is_drawn_beforehand(monkeypatch):
    drawn = []
    monkeypatch.setattr("twc_env.vector.teams.load_map", lambda name: drawn.append(name))
    kinds = ("office", "ring")
    names = [f"gen:{kinds[k % 2]}:100:{k}" for k in range(40)] + ["train/0003", "train/0004", "a:1.yaml", "b:2.yaml"]
    VectorTeams(1, SMALL, buildings=names)
    assert sorted(drawn) == ["a:1.yaml", "b:2.yaml", "gen:office:100:0", "gen:ring:100:1", "train/0003"]


@pytest.mark.parametrize("seed", [-1, 1.5, "3", True])
def test_seeds_that_are_none_are_refused(seed):
    with pytest.raises(ConfigError, match="seed must be a whole number"):
        VectorTeams(1, SMALL).reset(seed)


def test_after_an_interruption_no_stale_answer_is_taken(monkeypatch):
    teams = VectorTeams(2, SMALL)
    teams.reset(0)

    def interrupt(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(teams._runner, "results", interrupt)
    with pytest.raises(KeyboardInterrupt):
        teams.step(teams.sample())
    with pytest.raises(TwcError, match="closed"):
        teams.step(teams.sample())


def test_a_split_that_is_misspelt_is_answered_with_the_right_one():
    with pytest.raises(ConfigError, match=r"buildings are a split .* did you mean 'train'\?"):
        VectorTeams(1, SMALL, buildings="trian")


@pytest.mark.parametrize("workers", [0, 2])
def test_other_environments_go_on_from_a_snapshot_with_the_same_bytes(workers):
    config, random = {**CHOICES, "max_cycles": 60}, np.random.default_rng(0)

    def on(teams, steps):
        told = []
        for _ in range(steps):
            masks = teams.action_masks()
            seen, rewards, ended, _ = teams.step((random.random(masks.shape) * masks).argmax(-1))
            told.append(b"".join(block.tobytes() for block in (*seen.values(), rewards, ended, teams.states())))
        return told

    with VectorTeams(3, config) as first, VectorTeams(3, config, workers) as second:
        with pytest.raises(TwcError, match=r"only episodes that have begun"):
            first.snapshot()
        first.reset(4)
        on(first, 9)
        kept, random = first.snapshot(), np.random.default_rng(1)
        assert kept["seeds"].max() > 6, "an episode has ended"
        expected, random = on(first, 9), np.random.default_rng(1)
        second.restore(kept)
        assert on(second, 9) == expected
        with pytest.raises(DataError, match=r"no snapshot of 3 environments: 'actions.2' is missing"):
            second.restore({name: kept[name] for name in ("seeds", "actions.0", "actions.1")})
        before = second.snapshot()
        for other in (VectorTeams(3, {**config, "robots": 1}), VectorTeams(3, {**config, "action.kind": "velocity"})):
            with other, pytest.raises(DataError, match=r"actions.0 are int64 of shape .*, here they are"):
                other.restore(before)
        more = {**before, "seeds": np.append(before["seeds"], 7)}
        with pytest.raises(DataError, match=r"no snapshot of these 3 environments: it has 4 seeds"):
            second.restore(more)
        assert all(np.array_equal(before[name], block) for name, block in second.snapshot().items())
        first.send(first.sample(), range(3))
        with pytest.raises(TwcError, match=r"without pending steps"):
            first.snapshot()


def test_what_episodes_have_is_there_once_they_have_begun():
    with VectorTeams(1, {"robots": 1, "action.kind": "frontier"}) as teams:
        for asked in (teams.states, teams.action_masks, teams.sample):
            with pytest.raises(TwcError, match=r"no episode has started: call reset\(\) first"):
                asked()
        teams.reset(0)
        assert teams.action_masks().any() and teams.states().any()
    with pytest.raises(ConfigError, match=r"argument 'bulidings'; .* did you mean buildings"):
        VectorTeams(1, bulidings="train")
