import copy
import hashlib
import pickle
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import twc_env
from twc_env.config import EnvConfig, override
from twc_env.records.geometry import align_rigidly, between, compose
from twc_env.records.messages import Contacts
from twc_env.slam.engine import CooperativeSlam
from twc_env.world.world import World

REPLAY = """
import pickle, sys
with open(sys.argv[1], "rb") as file:
    config, frames = pickle.load(file)
from twc_env.slam.engine import CooperativeSlam
engine = CooperativeSlam(config, config.robots)
for step in frames:
    engine.update(step)
engine.finish()
truth = ("twc_env.world", "twc_env.records.random_streams", "pymunk")
loaded = sorted(name for name in sys.modules if name.startswith(truth))
print(",".join(loaded))
print(b"".join(engine.team.poses_of(robot).tobytes() for robot in range(config.robots)).hex())
"""


def replay(config, frames) -> CooperativeSlam:
    engine = CooperativeSlam(config, config.robots)
    for step in frames:
        engine.update(step)
    return engine


def digest_of(engine) -> str:
    """Digest of all poses and map cells."""
    robots = range(len(engine.robots))
    parts = [engine.poses_odom] + [engine.team.poses_of(r) for r in robots]
    for group in range(len(engine.team.groups)):
        grid = engine.team.grid_of(group)
        parts += [grid.log_odds, grid.origin_m]
    return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()


@pytest.fixture(scope="module")
def engine(recorded):
    config, frames, _ = recorded
    return replay(config, frames)


def test_replaying_the_frames_gives_the_same_poses_and_grids(recorded, engine):
    config, frames, _ = recorded
    assert digest_of(replay(config, frames)) == digest_of(engine)


def test_the_digest_changes_with_one_millimetre_in_one_frame(recorded, engine):
    config, frames, _ = recorded
    first, *others = frames[100]
    odometry = first.odometry + [0.001, 0.0, 0.0]
    changed = [*frames[:100], (replace(first, odometry=odometry), *others), *frames[101:]]
    assert digest_of(replay(config, changed)) != digest_of(engine)


@pytest.mark.parametrize("settings", [{}, {"slam.k_visibility.enabled": True, "link.topology": "peer"}])
def test_beliefs_do_not_depend_on_when_they_are_asked_for(record, settings):
    config = override(EnvConfig(map="twin-01", robots=3), settings)
    frames, _ = record(config, 450, seed=5)
    often, seldom = CooperativeSlam(config, 3), CooperativeSlam(config, 3)
    for k, step in enumerate(frames):
        often.update(step)
        seldom.update(step)
        often.beliefs()
        if k % 50 == 49:
            for belief, other in zip(often.beliefs(), seldom.beliefs(), strict=True):
                assert [s.text for s in belief.signs] == [s.text for s in other.signs]
                assert all(
                    np.array_equal(a.position_m, b.position_m) for a, b in zip(belief.signs, other.signs, strict=True)
                )
                if belief.radio_map is not None:
                    assert np.array_equal(belief.radio_map.log_odds, other.radio_map.log_odds)
                    assert np.array_equal(belief.transmitter_m, other.transmitter_m)


def test_replaying_does_not_modify_frames(recorded):
    config, frames, _ = recorded
    before = hashlib.sha256(pickle.dumps(frames[:150])).hexdigest()
    replay(config, frames[:150])
    assert hashlib.sha256(pickle.dumps(frames[:150])).hexdigest() == before


def test_the_engine_runs_in_a_process_that_never_loads_a_world(recorded, tmp_path):
    config, frames, _ = recorded
    path = tmp_path / "frames.pickle"
    path.write_bytes(pickle.dumps((config, frames[:200])))
    run = subprocess.run([sys.executable, "-c", REPLAY, str(path)], capture_output=True, text=True, check=True)
    loaded, poses = run.stdout.splitlines()
    here = replay(config, frames[:200])
    here.finish()
    assert loaded == ""
    assert poses == b"".join(here.team.poses_of(robot).tobytes() for robot in range(config.robots)).hex()


def test_a_front_end_does_not_depend_on_its_teammates(recorded):
    config, frames, _ = recorded
    alone = CooperativeSlam(config, 1)
    together = CooperativeSlam(config, 3)
    for step in frames[:200]:
        alone.track(step[:1])
        together.track(step[::-1])
        assert alone.poses_odom[0].tobytes() == together.poses_odom[0].tobytes()


def test_three_robots_merge_and_agree_with_ground_truth(recorded, engine):
    _, frames, true_poses = recorded
    merged = max((group.robots for group in engine.team.groups), key=len)
    assert len(merged) >= 2
    steps = [engine.team.keyframe_steps(r) for r in merged]
    true = np.concatenate([true_poses[s, r] for s, r in zip(steps, merged, strict=True)])
    estimated = np.concatenate([engine.team.poses_of(r) for r in merged])
    aligned = compose(align_rigidly(estimated[:, :2], true[:, :2]), estimated)
    assert np.hypot(*(aligned - true)[:, :2].T).max() < 0.5
    assert np.sqrt(((aligned - true)[:, :2] ** 2).sum(axis=1).mean()) < 0.2
    assert len(frames) == len(true_poses)


def test_robots_of_a_group_are_in_each_others_beliefs(engine):
    for robot in range(3):
        group = engine.team.groups[engine.team.group_index(robot)].robots
        belief = engine.belief(robot)
        assert set(belief.teammates) == set(group) - {robot}
        assert belief.pose_map_robot.tobytes() == engine.pose_map_robot(robot).tobytes()
        for teammate, pose in belief.teammates.items():
            assert pose.tobytes() == engine.pose_map_robot(teammate).tobytes()
            assert engine.belief(teammate).grid.log_odds is belief.grid.log_odds


def test_what_others_forward_is_no_contact_with_its_robot(recorded):
    config, frames, _ = recorded
    chain = np.array([[False, True, False], [True, False, True], [False, True, False]])
    engine = CooperativeSlam(override(config, {"link.topology": "peer"}), 3)
    for step in range(60):
        engine.update(frames[step], Contacts(chain, chain if step < 50 else chain & ~chain))
    assert len(engine.mappers[0].keyframes[2]) > 1
    steps = [belief.contact_steps for belief in engine.beliefs()]
    assert steps == [{1: 49, 2: -1}, {0: 49, 2: 49}, {0: -1, 1: 49}]


def test_earlier_beliefs_keep_their_steps_of_contact(recorded):
    config, frames, _ = recorded
    engine, before = CooperativeSlam(config, 3), []
    assert [belief.contact_steps for belief in engine.beliefs()] == [{}, {}, {}]
    heard = np.array([[True, True, False]])
    for step in range(20):
        engine.update(frames[step], Contacts(heard, heard))
        before.append(engine.beliefs())
    for step, beliefs in enumerate(before):
        assert [b.contact_steps for b in beliefs] == [{1: step, 2: -1}, {0: step, 2: -1}, {0: step, 1: step}]


def test_a_known_text_is_listed_once_per_place(engine):
    signs = engine.belief(0).signs
    assert len(signs) > 0
    for i, sign in enumerate(signs):
        assert all(s.text != sign.text or np.hypot(*(s.position_m - sign.position_m)) > 0.9 for s in signs[:i])


def test_before_the_first_frame_every_robot_is_its_own_group():
    engine = CooperativeSlam(EnvConfig(), 2)
    for robot in range(2):
        belief = engine.belief(robot)
        assert (belief.teammates, belief.signs, belief.grid.log_odds.size) == ({}, (), 0)
        assert belief.pose_map_robot.tolist() == [0.0, 0.0, 0.0]


def test_both_filters_give_the_same_poses(recorded):
    config, frames, _ = recorded
    engines = [
        replay(override(config, {"slam.odometry_filter.backend": backend}), [step[:1] for step in frames[:120]])
        for backend in ("compiled", "filterpy")
    ]
    first, second = (engine.team.poses_of(0) for engine in engines)
    assert len(first) > 5
    assert np.abs(between(first, second)).max() < 1e-6


def test_perfect_sensors_give_a_trajectory_without_drift(record):
    config = override(EnvConfig(robots=1), {"odometry.drift": 0.0, "lidar.range_noise_std_m": 0.0})
    frames, true_poses = record(config, 300)
    engine = CooperativeSlam(config, 1)
    for t, step in enumerate(frames):
        engine.track(step)
        error = between(between(true_poses[0, 0], true_poses[t, 0]), engine.poses_odom[0])
        assert np.hypot(error[0], error[1]) < 0.03
        assert abs(error[2]) < 0.005


def test_scan_matching_beats_dead_reckoning(recorded):
    config, frames, true_poses = recorded
    engine = CooperativeSlam(config, 3)
    reckoned = np.zeros((3, 3))
    for step in frames:
        engine.track(step)
        reckoned = compose(reckoned, np.array([frame.odometry for frame in step]))
    true = between(true_poses[0], true_poses[-1])
    matched = engine.poses_odom
    error_matched, error_reckoned = (np.hypot(*(p - true)[:, :2].T).mean() for p in (matched, reckoned))
    assert error_matched < 0.5 * error_reckoned


def test_a_robot_without_signs_or_radio_still_maps(recorded):
    config, frames, _ = recorded
    blind = [tuple(replace(frame, wifi=None, signs=()) for frame in step) for step in frames[:150]]
    engine = replay(config, blind)
    assert [group.robots for group in engine.team.groups] == [(0,), (1,), (2,)]
    assert engine.belief(0).signs == ()
    assert np.count_nonzero(engine.belief(0).grid.log_odds < 0) > 1000


def test_late_keyframes_give_the_same_map_of_one_robot(recorded):
    config, frames, _ = recorded
    prompt, late = CooperativeSlam(config, 1), CooperativeSlam(config, 1)
    in_touch, apart = (Contacts(np.array([[there]]), np.array([[there]])) for there in (True, False))
    for count, step in enumerate(frames[:150]):
        prompt.update(step[:1])
        late.update(step[:1], in_touch if count % 40 == 39 else apart)
    assert len(late.team.poses_of(0)) < len(prompt.team.poses_of(0))
    late.absorb(150, in_touch)
    for engine in (prompt, late):
        engine.finish()
    assert len(late.team.poses_of(0)) == len(prompt.team.poses_of(0))
    assert np.abs(between(prompt.team.poses_of(0), late.team.poses_of(0)))[:, :2].max() < 0.05


def test_the_pose_graph_has_one_chain_per_robot_and_every_accepted_closure(engine):
    graph, team = engine.team.graph(), engine.team
    counts = [len(team.keyframes[r]) for r in range(3)]
    kinds = graph["edges_kind"]
    assert len(graph["nodes"]) == sum(counts)
    assert np.array_equal(graph["node_robots"], graph["node_ids"]), "nobody was carried"
    for (robot, index), step, time_s in zip(graph["node_ids"], graph["node_steps"], graph["node_times_s"], strict=True):
        assert (step, time_s) == (team.keyframes[robot][index].step, team.keyframes[robot][index].time_s)
    assert kinds.count("odometry") == sum(count - 1 for count in counts)
    assert kinds.count("closure") == sum(c.status == "accepted" for c in team.closures)
    for kind, (a, b) in zip(kinds, graph["edges_ij"], strict=True):
        (robot_a, index_a), (robot_b, index_b) = graph["node_ids"][a], graph["node_ids"][b]
        assert kind == "closure" or (robot_a == robot_b and index_b == index_a + 1)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda engine: pickle.loads(pickle.dumps(engine))])
def test_a_copy_of_the_engine_continues_identically(copied):
    config = override(EnvConfig(), {"robots": 6, "lidar.beam_count": 60})
    world, random = World(config, twc_env.load_map("twin-01")), np.random.default_rng(1)
    world.reset(seed=1)
    engine = CooperativeSlam(config, 6)
    twin = None
    for step in range(140):
        heard = np.array([[True, step % 7 > 0, step < 30, step > 50, step < 10 or step > 30, False]])
        if step % 20 == 0:
            commands = np.column_stack([random.uniform(0.2, 0.8, 6), random.uniform(-0.8, 0.8, 6)])
        world.step(commands)
        frames = list(world.sense())
        for each in (engine, twin):
            if each is not None:
                each.update(frames, Contacts(heard, heard))
        if step == 20:
            twin = copied(engine)
    assert engine.team.closures, "there is something to optimise"
    for robot in range(6):
        assert np.array_equal(twin.belief(robot).pose_map_robot, engine.belief(robot).pose_map_robot)
        assert twin.belief(robot).contact_steps == engine.belief(robot).contact_steps


def test_an_engine_taken_out_of_an_episode_keeps_its_clock():
    env = twc_env.parallel_env(map="twin-01", robots=3)
    env.reset(seed=0)

    def go_on(steps):
        for step in range(steps):
            env.step({f"robot_{k}": np.array([0.8, 0.4 if step % 40 > 25 else 0.0], np.float32) for k in range(3)})
            yield env.frames, env.contacts

    list(go_on(80))
    taken = copy.deepcopy(env.engine)
    for frames, contacts in go_on(80):
        taken.update(list(frames), contacts)
    own, other = env.engine.belief(0), taken.belief(0)
    assert (other.contact_steps, other.step) == (own.contact_steps, own.step) == ({1: 160, 2: 160}, 160)
    assert digest_of(taken) == digest_of(env.engine)


def test_an_engine_goes_on_by_frames_of_single_robots_after_steps_of_a_caller(recorded):
    config, frames, _ = recorded
    engine = CooperativeSlam(config, 3)
    for step in range(30):
        engine.track(frames[step])
        engine.absorb(step)
    for step in range(30, 40):
        for frame in frames[step]:
            engine.update([frame])
        assert engine.belief(0).contact_steps == {1: step, 2: step}
