"""One mapper per robot (`link.topology = "peer"`): limited range, message forwarding, scans on request."""

import pickle
from itertools import combinations

import numpy as np
import pytest

import twc_env
from twc_env.config import override
from twc_env.exploration.episode import Episode
from twc_env.exploration.macro_actions import CandidateSearch
from twc_env.exploration.observation.observations import ObservationBuilder
from twc_env.slam.engine import CooperativeSlam
from twc_env.slam.matching.loop_verification import LoopVerifier

STEPS = 350
PEERS = {"link.topology": "peer", "link.range_max_m": 6.0, "link.scan_on_request": True, "link.loss_probability": 0.3}


@pytest.fixture(scope="module")
def played(explore):
    """Log, frames and contacts of a team of peers, and the scans that each verification used."""
    env = twc_env.parallel_env(robots=3, config=PEERS, max_cycles=STEPS)
    looked_at = []
    verify = LoopVerifier.verify

    def watched(self, candidate, target_path, source_path):
        looked_at.append((self, self.scans_needed(candidate, target_path, source_path)))
        return verify(self, candidate, target_path, source_path)

    frames, contacts = [], []
    think = Episode._think

    def recording(self, now):
        think(self, now)
        frames.append(pickle.loads(pickle.dumps(now)))
        contacts.append(self.contacts)

    Episode._think, LoopVerifier.verify = recording, watched
    try:
        log = explore(STEPS, env=env)
    finally:
        Episode._think, LoopVerifier.verify = think, verify
    return log, frames, contacts, looked_at


def test_replayed_frames_and_contacts_give_the_same_observations(played):
    log, frames, contacts, _ = played
    engine = CooperativeSlam(log.env.config, 3)
    builder = ObservationBuilder(log.env.config)
    for step, (now, heard) in enumerate(zip(frames, contacts, strict=True)):
        engine.update(now, heard)
        if step == STEPS:
            engine.finish()
        builder.notice(now, [engine.belief(frame.robot) for frame in now])
        for agent, built in zip(log.env.possible_agents, builder.build(), strict=True):
            assert all(np.array_equal(built[key], log.observations[step][agent][key]) for key in built)


def test_the_last_contact_is_the_last_step_in_which_one_robot_heard_the_other_itself(played):
    log, _, contacts, _ = played
    last = np.where(contacts[0].heard, 0, -1)
    for step, (now, beliefs) in enumerate(zip(contacts[1:], log.beliefs, strict=True), start=1):
        last[now.heard] = step
        assert [b.contact_steps for b in beliefs] == [
            {other: last[robot, other] for other in range(3) if other != robot} for robot in range(3)
        ]
    silent = STEPS - last[~np.eye(3, dtype=bool)]
    assert silent.min() < 10 < silent.max(), "all pairs are in contact, or none"


def test_verification_uses_only_scans_that_have_arrived(played):
    log, _, _, looked_at = played
    engine = log.env.engine
    home_of = {id(mapper._search._verifier): robot for robot, mapper in enumerate(engine.mappers)}
    foreign = 0
    for verifier, keys in looked_at:
        home = home_of[id(verifier)]
        for key in keys:
            assert key[0] == home or key in engine._exchange._scans[home]
            foreign += key[0] != home
    assert foreign > 0


def test_robots_that_met_share_a_group_but_each_holds_its_own_map(played):
    log = played[0]
    engine = log.env.engine
    views = engine.views()
    assert [view.viewers for view in views] == [(0,), (1,), (2,)]
    assert max(len(view.robots) for view in views) >= 2
    known = [[len(path) for path in mapper.keyframes] for mapper in engine.mappers]
    own = [len(engine.mapper_of(r).keyframes[r]) for r in range(3)]
    assert all(counts[r] == own[r] for r, counts in enumerate(known))
    assert any(counts[r] < own[r] for counts in known for r in range(3)), "somebody lags behind"


def test_robots_of_one_group_plan_on_their_own_maps(played):
    beliefs, known, search = played[0].beliefs[-1], {}, CandidateSearch(played[0].env.config)
    assert any({b.robot, *b.teammates} == {c.robot, *c.teammates} for b, c in combinations(beliefs, 2))
    for belief in beliefs:
        planned, alone = search.terrain(known, belief), search.terrain({}, belief)
        assert np.array_equal(planned.origin_m, alone.origin_m) and np.array_equal(planned.kind, alone.kind)


def test_the_report_evaluates_peers_like_a_team_with_a_central_mapper(played):
    figures = played[0].env.result().figures
    assert figures["merged_robots"] >= 2 and figures["wrong_merges"] == 0
    assert figures["team_ate_m"] < 0.1
    assert 0.05 < figures["coverage_correct"] <= 1.0
    assert figures["bytes_by_kind"]["inventory"] > 0 and figures["bytes_by_kind"]["request"] > 0
    assert sum(rewards["robot_0"] for rewards in played[0].rewards) > 0.05


def test_robots_that_never_meet_know_only_themselves(explore):
    log = explore(60, robots=3, config={"link.topology": "peer", "link.range_max_m": 0.0})
    assert log.env.episode.bytes_sent == 0
    for robot, agent in enumerate(log.env.possible_agents):
        assert log.env.belief(agent).teammates == {}
        assert [len(path) > 0 for path in log.env.engine.mappers[robot].keyframes] == [r == robot for r in range(3)]


def test_scans_on_request_save_bytes_before_the_first_merge(explore):
    sent = {}
    for on_request in (False, True):
        config = override(twc_env.EnvConfig(), {"link.scan_on_request": on_request})
        log = explore(120, robots=3, config={"link.scan_on_request": on_request})
        assert log.env.config.link == config.link
        sent[on_request] = log.env.engine.bytes_sent
    assert sent[True]["fingerprint"] == sent[False]["fingerprint"] > 0
    assert sent[True]["scan"] < 0.8 * sent[False]["scan"]
