"""What is kept from a policy does not reach its choices, in training and at play."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.training.test_encoder import sample, space_for
from twc_env.errors import ConfigError, DataError

pytestmark = pytest.mark.usefixtures("torch")
SEEN = {
    "teammates": ("team", "other_maps", ("goals", 1), ("frontiers", 5)),
    "signs": ("signs",),
    "map": ("gains", ("frontiers", 3), ("frontiers", 4), ("frontiers", 5)),
}
"""The blocks that tell of it, or columns of them."""
TOLD = {"observation.other_maps": True}
CHOICE = {"teammates": -2, "signs": -3}


@pytest.fixture(scope="module")
def tiny(torch):
    from twc_env.training.mappo import Settings

    sizes = {"environments": 1, "rollout_steps": 8, "epochs": 1, "minibatches": 1, "hidden_size": 8}
    return Settings(**sizes, steps=8, workers=0, blind=("teammates", "map"), attention=False, from_rule=False)


@pytest.fixture(scope="module")
def blind_run(task, tiny, tmp_path_factory):
    """A run whose policy knows nothing of teammates and map, and has no attention."""
    from twc_env.training.mappo import train

    folder = tmp_path_factory.mktemp("blind")
    train(task, tiny, folder, show_progress=False)
    return folder


def changed(seen, place):
    """What is seen, with other numbers in a block or a column of it."""
    name, *column = (place,) if isinstance(place, str) else place
    block = seen[name].clone()
    block[(..., *column)] *= 0.5
    return {**seen, name: block}


def actor_of(blind, **more):
    import torch
    from twc_env.training.encoder import Actor

    torch.manual_seed(0)
    actor = Actor(space_for(3, **TOLD), 16, blind, **more)
    torch.nn.init.normal_(actor.score[2].weight, std=0.1)  # the network adds nothing before training
    torch.nn.init.normal_(actor.rule, std=0.1)
    return actor


@pytest.mark.parametrize("attention", [True, False])
@pytest.mark.parametrize("blind", SEEN)
def test_what_a_policy_is_blind_for_changes_none_of_its_logits(blind, attention, torch):
    seen = sample(space_for(3, **TOLD))
    sees, is_blind = actor_of((), attention=attention), actor_of((blind,), attention=attention)
    for place in SEEN[blind]:
        assert not torch.equal(sees(changed(seen, place)), sees(seen)), f"{place} matters"
        assert torch.equal(is_blind(changed(seen, place)), is_blind(seen)), f"{place} does not"
    for other in SEEN.keys() - {blind}:
        places = [place for place in SEEN[other] if place not in SEEN[blind]]
        assert not any(torch.equal(is_blind(changed(seen, place)), is_blind(seen)) for place in places)


@pytest.mark.parametrize("blind", CHOICE)
def test_nobody_goes_to_what_he_does_not_know_of(blind, torch):
    seen, actor = sample(space_for(3, **TOLD)), actor_of((blind,))
    before = {name: block.clone() for name, block in seen.items()}
    chances = actor(seen).softmax(1)[0]
    assert chances[CHOICE[blind]] == 0.0 and chances[-1] > 0.0
    assert all(torch.equal(seen[name], before[name]) for name in seen), "what is seen stays as it is"


def test_without_the_map_the_way_to_a_candidate_is_the_straight_line(torch):
    from twc_env.training.blindness import hidden

    seen = sample(space_for(3, **TOLD))
    left = hidden(seen, ("map",))["frontiers"]
    assert torch.equal(left[..., 3], seen["frontiers"][..., 2]) and torch.equal(
        left[..., :3], seen["frontiers"][..., :3]
    )


def test_who_is_blind_for_nothing_sees_the_same_tensors():
    from twc_env.training.blindness import hidden

    seen = sample(space_for(3, **TOLD))
    assert hidden(seen, ()) is seen


def test_an_evolution_strategy_plays_without_what_is_kept_from_it(task):
    from twc_env.training.encoder import rule_for
    from twc_env.training.evolution import Episodes, Settings

    played = {}
    for blind in ((), ("map",)):
        episodes = Episodes(task, Settings(environments=2, workers=0, blind=blind))
        rule = rule_for(episodes.space)
        weights = np.tile([weight for weight, _ in rule.values()], (2, 1))
        weights[1, list(rule).index("frontier")] = 3.0
        played[blind], _ = episodes.play(weights, [7, 7])
        episodes.close()
    assert played[()][0] != played[()][1] and played["map",][0] == played["map",][1]
    assert played["map",][0] != played[()][0]


def test_a_stored_policy_is_as_blind_at_play_as_in_training(blind_run, tiny, task, torch):
    from twc_env.training.encoder import FeedForward
    from twc_env.training.trained_policy import load_actor

    from twc_env.exploration.environment import ExplorationEnv

    space = ExplorationEnv(config=task.config).observation_space("robot_0")
    actor = load_actor(blind_run / "model.safetensors", space)
    seen = sample(space_for(2))
    for place in {*SEEN["teammates"], *SEEN["map"]} - {"other_maps"}:
        assert torch.equal(actor(changed(seen, place)), actor(seen))
    assert not torch.equal(actor(changed(seen, "signs")), actor(seen))
    assert isinstance(actor.encoder.attention, FeedForward)


def test_a_run_goes_on_only_as_blind_as_it_was_and_earlier_runs_saw_everything(blind_run, tiny, task, tmp_path):
    from twc_env.training.mappo import Settings
    from twc_env.training.run_folder import check_run

    check_run(blind_run, "mappo", task, tiny, resume=True)
    with pytest.raises(DataError, match=r"was trained with --blind \['teammates', 'map'\] instead of \[\]"):
        check_run(blind_run, "mappo", task, replace(tiny, blind=()), resume=True)
    record = json.loads((blind_run / "config.json").read_text())
    for name in ("blind", "attention", "privileged_critic", "from_rule"):
        del record["settings"][name]
    (tmp_path / "config.json").write_text(json.dumps(record))
    (tmp_path / "model.safetensors").touch()
    sighted = replace(tiny, **{name: getattr(Settings(), name) for name in ("blind", "attention", "from_rule")})
    check_run(tmp_path, "mappo", task, sighted, resume=True)
    with pytest.raises(DataError, match="--attention True instead of False"):
        check_run(tmp_path, "mappo", task, replace(sighted, attention=False), resume=True)


def test_a_misspelt_name_is_refused_before_anything_is_written(tiny, task, tmp_path):
    from twc_env.training.mappo import train

    with pytest.raises(ConfigError, match=r"--blind sign: nothing of this name is seen.*did you mean 'signs'"):
        train(task, replace(tiny, blind=("sign",)), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_critic_without_privilege_sees_what_the_robot_sees(torch):
    from twc_env.training.mappo import Critic

    torch.manual_seed(0)
    seen = sample(space_for(3, **TOLD)) | {"gained": torch.zeros(1, 1), "state": torch.rand(1, 3, 8)}
    for is_privileged in (True, False):
        critic = Critic(space_for(3, **TOLD), 16, is_privileged)
        for place in ("gained", "state"):
            other = {**seen, place: seen[place] + 0.5}
            assert torch.equal(critic(other), critic(seen)) != is_privileged
        assert not torch.equal(critic(changed(seen, "gains")), critic(seen))


def test_without_the_rule_all_choices_are_alike_before_training(torch):
    from twc_env.training import mappo
    from twc_env.training.ppo import ChoiceNetworks

    seen = sample(space_for(3, **TOLD))
    learner = mappo.Learner(space_for(3, **TOLD), mappo.Settings(hidden_size=8, from_rule=False), 0.1)
    networks = ChoiceNetworks(space_for(3, **TOLD), 8, from_rule=False)
    for logits in (learner.actor(seen), networks(seen)[0]):
        assert (logits == 0.0).all()


def test_without_attention_a_choice_knows_the_others_by_their_mean_alone(torch):
    from twc_env.training.encoder import FeedForward

    torch.manual_seed(0)
    layer, tokens, is_present = FeedForward(8), torch.rand(1, 5, 8), torch.tensor([[True, True, True, False, True]])
    other = tokens.clone()
    other[0, 2] = 0.0
    found, moved = layer(tokens, is_present)[0], layer(other, is_present)[0]
    assert torch.equal(found[1], moved[1]) and not torch.equal(found[0], moved[0])
    other = tokens.clone()
    other[0, 3] = 0.0
    assert torch.equal(layer(other, is_present)[0, 0], found[0]), "what is absent does not count"
