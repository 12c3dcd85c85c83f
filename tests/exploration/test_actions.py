import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import twc_env
from twc_env.config import DynamicsConfig
from twc_env.errors import ActionError
from twc_env.exploration.actions import Velocities, check_agents, velocity_space

AGENTS = ["robot_0", "robot_1"]
LIMITS = DynamicsConfig(speed_max_m_s=1.2, turn_rate_max_rad_s=2.0)
FINE = np.array([0.5, -0.5], np.float32)

BAD = {
    "NaN": np.array([np.nan, 0.0]),
    "infinity": np.array([0.0, np.inf]),
    "too fast": np.array([1.5, 0.0]),
    "too fast backwards": np.array([0.0, -1.01]),
    "one number too many": np.array([0.1, 0.2, 0.3]),
    "one number too few": np.array([0.7]),
    "a bare number": 0.7,
    "a row instead of a pair": np.array([[0.1, 0.2]]),
    "no numbers": "forward",
    "nothing": None,
    "complex numbers": np.array([1j, 0.0]),
    "an empty array": np.array([]),
    "a masked number": np.ma.masked_array([0.5, 0.2], [False, True]),
}


@given(st.floats(-1, 1), st.floats(-1, 1))
def test_an_action_is_a_fraction_of_the_maximum_speeds(forward, turn):
    commands = Velocities(LIMITS, 2).decode({"robot_0": (forward, turn), "robot_1": FINE}, AGENTS)
    assert commands == pytest.approx(np.array([[1.2 * forward, 2.0 * turn], [0.6, -1.0]]))


def test_values_beyond_one_by_rounding_are_clipped():
    commands = Velocities(LIMITS, 1).decode({"robot_0": (1 + 5e-7, -1 - 5e-7)}, ["robot_0"])
    assert commands.tolist() == [[1.2, -2.0]]


def test_every_action_of_the_space_is_accepted():
    space = velocity_space()
    space.seed(0)
    for action in [space.low, space.high, *(space.sample() for _ in range(20))]:
        assert np.isfinite(Velocities(LIMITS, 1).decode({"robot_0": action}, ["robot_0"])).all()


@pytest.mark.parametrize("bad", BAD.values(), ids=BAD.keys())
def test_the_error_of_an_invalid_action_names_agent_value_and_remedy_in_one_line(bad):
    with pytest.raises(ActionError) as caught:
        Velocities(LIMITS, 2).decode({"robot_0": FINE, "robot_1": bad}, AGENTS)
    text = str(caught.value)
    assert "\n" not in text
    assert "'robot_1'" in text
    assert " ".join(line.strip() for line in repr(bad).splitlines()) in text
    assert "[-1, 1]" in text
    assert any(word in text for word in ("must be", "clip"))


@pytest.mark.parametrize("kind", ["velocity", "waypoint"])
def test_the_error_of_a_tensor_with_a_gradient_says_how_to_pass_it(kind):
    torch = pytest.importorskip("torch", reason="needs the extra 'train'")
    env = twc_env.parallel_env(robots=1, config={"action.kind": kind, "lidar.beam_count": 36})
    env.reset(seed=0)
    action = torch.zeros(2, requires_grad=True)
    with pytest.raises(ActionError, match=r"requires_grad=True\): pass action\.detach\(\)\.cpu\(\)\.numpy\(\)"):
        env.step({"robot_0": action})
    env.step({"robot_0": action.detach()})
    with pytest.raises(ActionError, match=r"got tensor\(\[5\., 5\.\]\)") as caught:
        env.step({"robot_0": action.detach() + 5.0})
    assert "detach" not in str(caught.value)


def test_the_first_of_several_invalid_actions_is_named():
    with pytest.raises(ActionError, match="'robot_0'"):
        Velocities(LIMITS, 2).decode({"robot_0": np.array([3.0, 0.0]), "robot_1": np.array([np.nan, 0.0])}, AGENTS)


def test_the_error_of_a_missing_agent_lists_all_required_agents():
    with pytest.raises(ActionError) as caught:
        check_agents({"robot_0": FINE, "robot_7": FINE}, AGENTS)
    text = str(caught.value)
    assert "no action for 'robot_1'" in text
    assert str(AGENTS) in text
    assert "\n" not in text


@pytest.mark.parametrize("bad", [BAD["NaN"], BAD["too fast"], BAD["a bare number"]], ids=["NaN", "range", "shape"])
def test_an_invalid_action_does_not_change_the_episode(bad, same):
    tried, untouched = (twc_env.parallel_env(robots=2, max_cycles=20) for _ in range(2))
    for env in (tried, untouched):
        env.reset(seed=0)
    for _ in range(5):
        with pytest.raises(ActionError):
            tried.step({"robot_0": FINE, "robot_1": bad})
        a, b = (env.step(dict.fromkeys(AGENTS, FINE)) for env in (tried, untouched))
        assert all(same(a[0][agent], b[0][agent]) for agent in AGENTS)


def test_the_single_agent_and_aec_environments_reject_invalid_actions():
    import gymnasium

    single = gymnasium.make("twc/Explore-v0", disable_env_checker=True)
    single.reset(seed=0)
    with pytest.raises(ActionError, match="robot_0"):
        single.step(BAD["NaN"])
    turns = twc_env.env(robots=1)
    turns.reset(seed=0)
    with pytest.raises(ActionError, match="robot_0"):
        turns.step(BAD["too fast"])


@pytest.mark.parametrize(
    ("settings", "bad", "good"),
    [({}, np.array([np.nan, 0.0]), FINE), ({"config": {"action.kind": "frontier"}}, 99, 0),
     ({"config": {"action.kind": "waypoint"}}, np.array([2.0, 0.0]), FINE)],
)  # fmt: skip
def test_in_turns_an_invalid_action_is_refused_at_its_own_turn_and_another_may_follow(settings, bad, good):
    turns = twc_env.env(robots=2, max_cycles=3, **settings)
    turns.reset(seed=0)
    with pytest.raises(ActionError, match="robot_0"):
        turns.step(bad)
    assert turns.agent_selection == "robot_0"
    turns.step(good)
    assert turns.agent_selection == "robot_1"
    turns.step(good)
    assert turns.agent_selection == "robot_0" and turns.unwrapped.episode.steps >= 1


@pytest.mark.parametrize("bad", [np.zeros((3, 2)), np.array([1, 2], "M8[s]"), "a\nb"], ids=["rows", "dates", "text"])
def test_multi_line_values_are_reported_in_one_line(bad):
    env = twc_env.parallel_env(map="twin-01", robots=1)
    env.reset(seed=0)
    for actions in ({"robot_0": bad}, bad):
        with pytest.raises(ActionError) as error:
            env.step(actions)
        assert "\n" not in str(error.value) and "got" in str(error.value)
        again = pickle.loads(pickle.dumps(error.value))  # as it comes from a worker process
        assert (type(again), str(again)) == (ActionError, str(error.value))
