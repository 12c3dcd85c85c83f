"""The policy over a set of choices: its mask, its symmetry, and what it does not depend on."""

import numpy as np
import pytest

from twc_env.exploration.environment import ExplorationEnv

pytestmark = pytest.mark.usefixtures("torch")
VIEW = {"action.kind": "frontier", "observation.gains": True, "observation.map": False, "observation.lidar": False}


def space_for(robots, **more):
    from twc_env.training.team_notes import TeamNotes

    return TeamNotes.space(ExplorationEnv(config={**VIEW, "robots": robots, **more}).observation_space("robot_0"))


def sample(space, rows=1):
    import torch

    random = np.random.default_rng(0)
    seen = {}
    for name, block in space.items():
        if name not in ("overview", "wifi"):
            seen[name] = torch.from_numpy(random.uniform(0, 1, (rows, *block.shape)).astype(np.float32))
    seen["frontiers"][..., 0] = seen["signs"][..., 0] = 1.0
    seen["action_mask"] = torch.ones(rows, *space["action_mask"].shape)
    return seen


@pytest.fixture(scope="module")
def actor(torch):
    from twc_env.training.encoder import Actor

    torch.manual_seed(0)
    trained = Actor(space_for(3), 16)
    torch.nn.init.normal_(trained.score[2].weight, std=0.1)  # the network adds nothing before training
    return trained


def test_a_masked_choice_is_never_taken(actor):
    seen = sample(space_for(3))
    seen["action_mask"][:] = 0.0
    seen["action_mask"][0, [1, 9]] = 1.0
    chances = actor(seen).softmax(1)[0]
    assert chances[[1, 9]].sum().item() == pytest.approx(1.0)


def test_swapping_two_candidates_swaps_their_logits_and_changes_no_others(actor, torch):
    seen = sample(space_for(3))
    order = torch.arange(8)
    order[[0, 5]] = order[[5, 0]]
    swapped = {**seen, **{name: seen[name][:, order] for name in ("frontiers", "gains", "goals")}}
    first, second = actor(seen)[0], actor(swapped)[0]
    assert torch.allclose(second[:8], first[:8][order], atol=1e-6)
    assert torch.allclose(second[8:], first[8:], atol=1e-6)


def test_the_order_of_teammates_and_of_signs_does_not_matter(actor, torch):
    seen = sample(space_for(4))
    turned = {**seen, "team": seen["team"].flip(1), "signs": seen["signs"].flip(1)}
    assert torch.allclose(actor(turned), actor(seen), atol=1e-6)
    assert not torch.allclose(actor({**seen, "team": 0.5 * seen["team"]}), actor(seen), atol=1e-6)


def test_one_policy_serves_two_to_eight_robots_and_any_number_of_candidates(actor):
    for robots, slots in ((2, 8), (5, 3), (8, 16)):
        space = space_for(robots, **{"action.frontier_slots": slots})
        assert actor(sample(space, 2)).shape == (2, slots + 3)


def test_teammates_that_were_never_heard_are_as_if_there_were_none(actor, torch):
    seen = sample(space_for(3))
    seen["team"][:] = 0.0
    alone = {**seen, "team": seen["team"][:, :1]}
    assert torch.allclose(actor(seen), actor(alone), atol=1e-6)


def test_the_first_policy_prefers_near_frontiers_that_show_much(actor, torch):
    from twc_env.training.encoder import rule_for

    seen = sample(space_for(3))
    seen["frontiers"][0, :, 3], seen["gains"][0], seen["goals"][0] = 0.5, 0.5, 0.0
    seen["frontiers"][0, 2, 3] = 0.1
    assert actor(seen).argmax().item() == 2
    seen["frontiers"][0, 2, 3], seen["gains"][0, 6] = 0.5, 0.9
    assert actor(seen).argmax().item() == 6
    seen["goals"][0, 6] = 1.0
    assert actor(seen).argmax().item() == 6, "it may change its mind, and need not"
    with torch.no_grad():
        actor.rule[list(rule_for(space_for(3))).index("near own goal")] = -3.0
    assert actor(seen).argmax().item() != 6, "where it has just been going"


def test_robots_that_are_told_of_other_maps_can_learn_to_go_there(torch):
    from twc_env.training.encoder import RULE, Actor, rule_for

    space = space_for(3, **{"observation.other_maps": True})
    assert rule_for(space) == RULE and list(RULE)[7] == "to other maps" and len(rule_for(space_for(3))) == len(RULE) - 1
    actor, seen = Actor(space, 16), sample(space)
    seen["frontiers"][0, :, 3], seen["gains"][0], seen["goals"][0] = 0.5, 0.5, 0.0
    seen["other_maps"][0] = torch.tensor([0.5, 0.5, 0.5, 0.2, 0.5, 0.5, 0.5, 0.5])
    assert (actor(seen)[0, 3] == actor(seen)[0, 4]).item(), "before training it does not care"
    with torch.no_grad():
        actor.rule[7] = -0.4
    assert actor(seen).argmax().item() == 3


def test_the_return_so_far_affects_the_value_of_ppo_but_not_its_policy(torch):
    from twc_env.training.ppo import ChoiceNetworks

    torch.manual_seed(0)
    networks, seen = ChoiceNetworks(space_for(3), 16), sample(space_for(3))
    poor, rich = ({**seen, "gained": torch.tensor([[gained]])} for gained in (0.0, 0.8))
    assert torch.equal(networks(poor)[0], networks(rich)[0])
    assert not torch.equal(networks(poor)[1], networks(rich)[1])


@pytest.mark.parametrize("slots", [5, 8, 64])
def test_the_logits_of_the_rule_do_not_depend_on_what_else_is_computed_with_them(torch, slots):
    """So the result of an evolution strategy does not depend on which worker answers first."""
    from twc_env.training.encoder import logits_of_rule, rule_for

    space = space_for(1, **{"action.frontier_slots": slots, "observation.other_maps": slots == 8})
    weights = torch.from_numpy(np.random.default_rng(1).standard_normal((64, len(rule_for(space)))).astype(np.float32))
    together = sample(space, 64)
    alone = [logits_of_rule({k: v[i : i + 1] for k, v in together.items()}, weights[i : i + 1]) for i in range(64)]
    assert torch.equal(torch.cat(alone), logits_of_rule(together, weights))
