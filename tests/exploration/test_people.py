"""Episodes among people, doors and furniture: the guards that hold without them hold with them."""

import numpy as np
import pytest

import twc_env
from tests.soak.observation_check import BLOCKS, EFFECTS, random_actions
from twc_env.config import EnvConfig, digest, override

STEPS = 100
CLUTTER = {
    "clutter.door_share": 1.0, "clutter.door_open_mean_s": 4.0, "clutter.furniture": 12, "clutter.hidden_share": 0.3,
    "clutter.moves_per_min": 10.0,
}  # fmt: skip
PEOPLE = {"people.count": 10, "failure.kidnap_step": 40, "signs.period_s": 0.2} | CLUTTER
MOTION = np.array([37.3, -81.9, 1.1])


@pytest.fixture(scope="module")
def log(explore):
    return explore(STEPS, config=PEOPLE)


def test_settings_of_people_are_in_the_digest_only_if_there_are_some():
    plain = EnvConfig()
    assert digest(override(plain, {"people.count": 1})) != digest(plain)
    assert digest(override(plain, {"failure.kidnap_step": 1})) != digest(plain)
    assert digest(override(plain, {"clutter.furniture": 1})) != digest(plain)
    assert digest(override(plain, {"clutter.furniture": 0})) == digest(plain)


def test_the_same_seed_gives_the_same_episode_bit_by_bit(explore, log, same):
    again = explore(STEPS, config=PEOPLE)
    assert all(
        same(a[agent], b[agent]) for a, b in zip(log.observations, again.observations, strict=True) for agent in a
    )


@pytest.mark.parametrize("scanner", ["ideal", "lms-200"])
def test_an_episode_continues_exactly_from_a_snapshot(explore, same, scanner):
    env = explore(30, config=PEOPLE | {"lidar.preset": scanner}).env
    moment, action = env.snapshot(), dict.fromkeys(env.agents, np.array([0.6, 0.2], np.float32))
    first = [env.step(action)[0] for _ in range(30)]
    env.restore(moment)
    again = [env.step(action)[0] for _ in range(30)]
    assert all(same(a[agent], b[agent]) for a, b in zip(first, again, strict=True) for agent in a)


def test_observations_do_not_depend_on_where_the_building_stands(explore, log):
    moved = explore(STEPS, config=PEOPLE, floorplan=log.env.floorplan.moved(MOTION))
    assert np.abs(log.env.state() - moved.env.state()).max() > 30
    for a, b in zip(log.observations, moved.observations, strict=True):
        for agent in a:
            assert all(np.array_equal(a[agent][key], b[agent][key]) for key in a[agent])


@pytest.mark.parametrize("kind", ["velocity", "waypoint", "frontier"])
def test_with_every_effect_observations_do_not_depend_on_where_the_building_stands(kind):
    """All blocks of a mixed team, with lost frames, unlike clocks, late scans, bumps, and robots that are carried."""
    settings = {f"observation.{name}": True for name in BLOCKS} | EFFECTS | PEOPLE
    settings |= {"action.kind": kind, "action.decision_max_s": 1.0}
    plan = twc_env.load_map("twin-01")
    here, there = (
        twc_env.parallel_env(floorplan=floorplan, max_cycles=STEPS, config=settings)
        for floorplan in (plan, plan.moved(MOTION))
    )
    random, steps = np.random.default_rng(0), 0
    (seen, infos), (moved, _) = (env.reset(seed=3, options={"starts": "map"}) for env in (here, there))
    while here.agents:
        for agent, blocks in seen.items():
            assert all(np.array_equal(blocks[name], moved[agent][name]) for name in blocks), (steps, agent)
        actions, steps = random_actions(here, infos, random), steps + 1
        (seen, _, _, _, infos), (moved, *_) = here.step(actions), there.step(actions)
    assert steps == STEPS if kind == "velocity" else steps >= STEPS / 10
    assert np.abs(here.state() - there.state()).max() > 30
    here.close()
    there.close()


@pytest.mark.parametrize("scanner", ["ideal", "lms-200", "rplidar-a1"])
def test_people_change_what_is_sensed_but_not_the_true_map(explore, scanner):
    config = PEOPLE | {"lidar.preset": scanner, "lidar.dropout_probability": 0.0}
    log, clean = (explore(STEPS, config=config | {"people.count": count}) for count in (10, 0))
    assert log.env.floorplan.digest == clean.env.floorplan.digest
    seen, bare = ([o[agent]["lidar"] for o in it.observations for agent in o] for it in (log, clean))
    assert any((np.array(a) < np.array(b) - 0.05).sum() > 2 for a, b in zip(seen, bare, strict=True))


def test_contacts_with_people_are_counted_where_there_are_some(log, explore):
    assert log.env.result().figures["people_collisions"] >= 0
    assert "people_collisions" not in explore(3).env.result().figures


def test_a_picture_shows_people():
    def yellow(count):
        env = twc_env.parallel_env(map="twin-01", robots=1, config={"people.count": count}, render_mode="rgb_array")
        env.reset(seed=0)
        picture = env.render().astype(int)
        return np.count_nonzero((picture[..., 0] > 220) & (picture[..., 2] < 130))

    assert yellow(0) == 0 and yellow(5) > 5 * 20
