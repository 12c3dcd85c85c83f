import copy
import dataclasses
import io
import pickle
import subprocess
import sys

import numpy as np
import pytest

import twc_env
from twc_env.errors import ConfigError, DataError, TwcError
from twc_env.exploration.snapshot import Snapshot
from twc_env.records.whole_copy import SharingPickler

KINDS = ["velocity", "waypoint", "frontier"]


def settings(kind: str) -> dict:
    return {"lidar.beam_count": 90, "action.kind": kind, "action.decision_max_s": 3.0, "radio.scan_period_s": 0.3}


def actions_of(env, observations, rng) -> dict:
    if env.config.action.kind == "frontier":
        return {a: int(rng.choice(np.flatnonzero(o["action_mask"]))) for a, o in observations.items()}
    return {agent: rng.uniform(-1, 1, 2).astype(np.float32) for agent in observations}


def go_on(env, observations, steps: int) -> list:
    rng = np.random.default_rng(4)
    seen = []
    for _ in range(steps):
        observations, rewards, *_, infos = env.step(actions_of(env, observations, rng))
        seen.append((observations, rewards, {a: i["reward_terms"] for a, i in infos.items()}))
    return seen


def started(kind: str, steps: int):
    env = twc_env.parallel_env(map="twin-02", max_cycles=4000, config=settings(kind))
    observations, _ = env.reset(seed=2, options={"starts": "map"})
    seen = go_on(env, observations, steps)
    return env, seen[-1][0]


@pytest.mark.parametrize(
    ("kind", "before", "after"), [("velocity", 220, 120), ("waypoint", 12, 5), ("frontier", 12, 5)]
)
def test_an_episode_continues_exactly_from_a_snapshot(kind, before, after, same_steps):
    env, observations = started(kind, before)
    moment = env.snapshot()
    first = go_on(env, observations, after)
    figures = env.result().figures
    seen, infos = env.restore(moment)
    assert same_steps([(seen, {}, {})], [(observations, {}, {})])
    assert ("is_deciding" in infos["robot_0"]) == (kind != "velocity")
    assert same_steps(go_on(env, observations, after), first)
    assert env.result().figures == figures
    assert kind == "velocity" or len(env.engine.team.closures) > 0, "the pose graph was no part of it"
    other = twc_env.parallel_env(map="twin-02", max_cycles=4000, config=settings(kind))
    other.restore(pickle.loads(pickle.dumps(moment)))
    assert same_steps(go_on(other, observations, after), first)


def test_an_episode_continues_exactly_from_a_snapshot_of_a_restored_one(same_steps):
    env, observations = started("velocity", 20)
    moment = env.snapshot()
    first = go_on(env, observations, 40)
    figures = env.result().figures
    for _ in range(3):
        env.restore(moment)
        moment = env.snapshot()
    env.restore(moment)
    assert same_steps(go_on(env, observations, 40), first)
    assert env.result().figures == figures


def test_views_share_memory_with_their_array_in_copies_of_copies():
    array = np.arange(20, dtype=np.int16).reshape(4, 5)
    held = {"array": array, "view": array.view(), "part": array[1:3, ::2]}
    held["view"].flags.writeable = False
    for _ in range(3):
        buffer = io.BytesIO()
        SharingPickler(buffer, pickle.HIGHEST_PROTOCOL).dump(held)
        held = pickle.loads(buffer.getvalue())
        held["array"][1, 0] += 100
        assert held["view"][1, 0] == held["part"][0, 0] == held["array"][1, 0]
        assert not held["view"].flags.writeable


@pytest.mark.parametrize(("robots", "stopped", "steps"), [(1, 0, 60), (3, 0, 60), (3, 1, 60), (3, 1, 30)])
def test_robots_in_contact_continue_exactly_from_a_snapshot(robots, stopped, steps):
    failure = {"failure.robots": stopped, "failure.robots_step": 40}
    env = twc_env.parallel_env(map="sfw-e1", robots=robots, config={"slam.mode": "off", **failure})
    env.reset(seed=1)
    ahead = dict.fromkeys(env.agents, np.array([1.0, 0.05], np.float32))
    for _ in range(steps):
        env.step(ahead)
    moment, seen = env.snapshot(), [[], [], []]
    for own in seen:  # the first run continues without a restore
        for _ in range(40):
            env.step(ahead)
            own.append(env.state().tolist())
        assert env.episode.record.contact_count > 0
        env.restore(moment)
    assert seen[0] == seen[1] == seen[2]


def test_another_process_continues_exactly_from_a_snapshot(tmp_path, same_steps):
    env, observations = started("velocity", 60)
    (tmp_path / "moment").write_bytes(pickle.dumps((env.snapshot(), observations)))
    code = (
        "import pickle, sys; sys.path.insert(0, sys.argv[2])\n"
        "from test_snapshot import go_on, settings\n"
        "import twc_env\n"
        "moment, observations = pickle.load(open(sys.argv[1] + '/moment', 'rb'))\n"
        "env = twc_env.parallel_env(map='twin-02', max_cycles=4000, config=settings('velocity'))\n"
        "env.restore(moment)\n"
        "pickle.dump(go_on(env, observations, 30), open(sys.argv[1] + '/seen', 'wb'))\n"
    )
    here = str(__import__("pathlib").Path(__file__).parent)
    subprocess.run([sys.executable, "-c", code, str(tmp_path), here], check=True)
    assert same_steps(pickle.loads((tmp_path / "seen").read_bytes()), go_on(env, observations, 30))


def test_a_snapshot_of_another_config_or_version_is_rejected(monkeypatch):
    env, _ = started("velocity", 3)
    moment = env.snapshot()
    other = twc_env.parallel_env(map="twin-02", config={**settings("velocity"), "lidar.beam_count": 60})
    with pytest.raises(ConfigError, match="configuration"):
        other.restore(moment)
    monkeypatch.setattr("twc_env.exploration.snapshot.__version__", "0.0.0")
    with pytest.raises(ConfigError, match=r"version .* this environment has 0\.0\.0"):
        env.restore(moment)


@pytest.mark.parametrize("broken", [None, {}, b"content", 100, 0], ids=str)
def test_an_invalid_snapshot_is_rejected_and_the_episode_continues(broken):
    env = twc_env.parallel_env(map="twin-01", robots=1, max_cycles=5)
    env.reset(seed=0)
    whole = env.snapshot()
    if isinstance(broken, int):
        broken = dataclasses.replace(whole, content=whole.content[:broken])
    with pytest.raises(TwcError, match=r"takes what snapshot\(\) gave|is damaged") as error:
        env.restore(broken)
    assert "\n" not in str(error.value)
    env.step({"robot_0": np.zeros(2)})
    env.restore(whole)


def test_a_flipped_byte_of_a_snapshot_is_never_used():
    env = twc_env.parallel_env(map="twin-01", robots=1, max_cycles=50, config={"lidar.beam_count": 60})
    env.reset(seed=0)
    whole, random = env.snapshot(), np.random.default_rng(0)
    for place in random.integers(len(whole.content), size=200):
        content = bytearray(whole.content)
        content[place] ^= int(random.integers(1, 256))
        with pytest.raises(DataError, match="damaged") as error:
            env.restore(dataclasses.replace(whole, content=bytes(content)))
        assert "\n" not in str(error.value)
    for changed in ({"version": "0.0.0"}, {"config_digest": "0" * 12}, {"checksum": whole.checksum ^ 1}):
        with pytest.raises((DataError, ConfigError)):
            env.restore(dataclasses.replace(whole, **changed))


def test_a_flipped_byte_of_a_pickled_snapshot_is_never_used():
    env = twc_env.parallel_env(map="twin-01", robots=1, max_cycles=50, config={"lidar.beam_count": 60})
    env.reset(seed=0)
    sound, random, damaged = env.snapshot(), np.random.default_rng(0), 0
    whole = pickle.dumps(sound)
    for place in [*range(80), *random.integers(80, len(whole), size=200)]:
        bent = bytearray(whole)
        bent[place] ^= int(random.integers(1, 256))
        try:
            moment = pickle.loads(bytes(bent))
        except DataError as error:
            damaged += "damaged" in str(error)
        except Exception:  # of Python's own format around the snapshot
            continue
        else:
            assert not isinstance(moment, Snapshot) or moment.content == sound.content
    assert damaged > 190
    env.restore(pickle.loads(whole))


def test_the_filterpy_back_end_can_be_saved():
    env = twc_env.parallel_env(robots=1, config={"slam.odometry_filter.backend": "filterpy"})
    env.reset(seed=1)
    moment, seen = env.snapshot(), [[], []]
    for own in seen:
        for _ in range(5):
            env.step({"robot_0": np.array([1.0, 0.2], np.float32)})
            own.append(env.state().tolist())
        env.restore(pickle.loads(pickle.dumps(moment)))
    assert seen[0] == seen[1]


OWN = """
import threading

class Own:
    name = "lidar"
    def __init__(self, rule, range_max_m):
        self.kept = [self.propose, {"parts": PART}]
    def propose(self, keyframe, skipped_robots=()):
        return []
    def sparsify(self, is_held):
        pass
"""


@pytest.mark.parametrize(
    ("part", "named"),
    [
        (
            "threading.Lock()",
            r"^Own\.kept cannot be copied \(cannot pickle '_thread\.lock' object\): let Own\.__getstate__",
        ),
        ("__import__('ctypes').c_void_p(3)", r"^Own\.kept cannot be copied \(ctypes"),
        ("lambda: 0", r"^Own\.kept cannot be copied \(.*lambda.*\): let Own\.__getstate__"),
    ],
)
def test_the_error_of_a_recogniser_that_cannot_be_copied_names_the_attribute(part, named, tmp_path):
    (tmp_path / "own.py").write_text(OWN.replace("PART", part))
    env = twc_env.parallel_env(config={"slam.place_recognition.recogniser": f"{tmp_path / 'own.py'}:Own"})
    env.reset(seed=0)
    for attempt in (env.snapshot, lambda: copy.deepcopy(env.engine), lambda: pickle.dumps(env.engine)):
        with pytest.raises(TwcError, match=named):
            attempt()


def test_a_recogniser_with_getstate_is_saved_with_the_episode(tmp_path):
    code = OWN.replace("PART", "threading.Lock()") + "    def __getstate__(self):\n        return {}\n"
    (tmp_path / "own.py").write_text(code)
    env = twc_env.parallel_env(config={"slam.place_recognition.recogniser": f"{tmp_path / 'own.py'}:Own"})
    env.reset(seed=0)
    moment, drive = env.snapshot(), dict.fromkeys(env.agents, np.full(2, 0.5, np.float32))
    first = env.step(drive)[0]
    env.restore(moment)
    again = env.step(drive)[0]
    assert all(np.array_equal(again[agent][name], first[agent][name]) for agent in first for name in first[agent])
    assert not np.array_equal(env.step(drive)[0]["robot_0"]["lidar"], again["robot_0"]["lidar"])


def test_views_and_turns_continue_exactly_from_a_snapshot(same_steps):
    own = {"action.goals": "views", "action.timing": "in-turn", "action.decision_max_s": 0.5, "observation.gains": True}
    env = twc_env.parallel_env(map="twin-02", max_cycles=4000, config={**settings("frontier"), **own})
    observations, _ = env.reset(seed=2)
    observations = go_on(env, observations, 40)[-1][0]
    moment = env.snapshot()
    first = go_on(env, observations, 20)
    seen, _ = env.restore(moment)
    assert same_steps([(seen, {}, {})], [(observations, {}, {})])
    assert same_steps(go_on(env, seen, 20), first)


def test_in_turns_an_episode_goes_on_from_a_snapshot_with_the_first_robot():
    """The turns kept the observations, rewards and end of the episode before."""
    action = np.array([0.5, 0.1], np.float32)
    env = twc_env.env(robots=2, max_cycles=3, config={"lidar.beam_count": 36})
    env.reset(seed=0)
    moment, first = env.unwrapped.snapshot(), env.observe("robot_0")
    for _ in range(5):
        env.step(action)
    env.unwrapped.restore(moment)
    assert env.agents == ["robot_0", "robot_1"] and env.agent_selection == "robot_0"
    assert all(np.array_equal(first[name], block) for name, block in env.observe("robot_0").items())
    for _ in range(6):
        assert env.last()[1:4] == (0.0, False, False) or env.unwrapped.episode.steps > 0
        env.step(action)
    over = env.unwrapped.snapshot()
    assert env.last()[2:4] == (False, True)
    env.unwrapped.restore(over)
    assert not env.agents


def test_a_trace_notes_each_step_of_one_episode_once(tmp_path):
    env = twc_env.parallel_env(robots=2, config={"lidar.beam_count": 36})
    env.reset(seed=0)
    moment, trace = env.snapshot(), twc_env.EpisodeTrace(env)
    still = dict.fromkeys(env.agents, np.zeros(2, np.float32))
    with pytest.raises(TwcError, match=r"steps 0 to 0 of seed 0, and the .* at step 0: note each step once"):
        trace.note()
    trace.note(env.step(still)[1])
    for back in (lambda: env.restore(moment), lambda: env.reset(seed=1)):
        back()
        with pytest.raises(TwcError, match=f"the episode of seed {env.episode.seed} is at step 0: .* another trace"):
            trace.note()
    env.step(still)
    env.step(still)
    with pytest.raises(TwcError, match="steps 0 to 1 of seed 0, and the episode of seed 1 is at step 2"):
        trace.note()
    env.restore(moment)
    env.step(still)
    env.step(still)
    trace.note()
    trace.write(tmp_path / "trace.npz")
    assert len(np.load(tmp_path / "trace.npz")["estimated_poses"]) == 3
