"""What learners see as a set: candidates, teammates and signs of any number, which attend to each other.

Nothing depends on the order of the candidates: there is one logit for each, and swapping two swaps their logits. The
number of weights depends neither on the number of candidates nor on that of robots, so one policy serves teams of 2 to
8 robots. Attention is that of Vaswani et al. 2017 ("Attention is all you need") without positions, as in Set
Transformers (Lee et al. 2019).
"""

from __future__ import annotations

import torch
from gymnasium import spaces
from torch import Tensor, nn
from torch.nn import functional
from twc_env.training.blindness import hidden

HEADS = 4
EXTRA_CHOICES = 3
"""Choices after the frontiers: nearest sign, nearest teammate, stay."""
POSE_COLUMNS = slice(4, 8)
"""Standard deviations of x, y and heading, and path length since the last closure. Where a robot is in its map tells
nothing about other buildings."""
HALF_WAY_M, HALF_GAIN_M2 = 10.0, 10.0
"""Observations show lengths l and areas a as l / (l + 10 m) and a / (a + 10 m2)."""
DECAY_PER_M, GAIN_MIN_M2 = 0.15, 0.3
"""The rate at which a gain is worth less with its way, and the least gain."""
SHARPNESS = 20.0
"""Logits per utility. This and the rate of decay were chosen in forty validation buildings of ExploreQuick-v1: sharper
is better for the rule, and leaves less to try."""
RULE = {
    "gain": (1.0, 0.0),
    "way": (-DECAY_PER_M * HALF_WAY_M, 0.3),
    "way early": (0.0, 0.3),
    "near own goal": (0.0, 0.1),
    "near goal of teammate": (0.0, 0.2),
    "aside": (0.0, 0.15),
    "frontier": (0.0, 0.2),
    "to other maps": (0.0, 0.3),
    "sign": (-20.0, 0.0),
    "teammate": (-20.0, 0.0),
    "stay": (-20.0, 0.0),
}
"""What makes the utility of a choice: weight at the start of training, and how far evolution strategies vary it. Of a
goal the logarithm of its gain, its way in 10 m, the same where more than half of the time is left, closeness to the
robot's last goal and to those of teammates, how far it lies aside, to where a robot that drives either way has to
turn, its size as a frontier, and its distance to other maps in 10 m, which only counts where robots observe it
(`rule_for`); utilities of the other choices, below those of most goals."""
USED = ("frontiers", "gains", "other_maps", "goals", "action_mask", "pose", "clock", "team", "signs")
"""The blocks that a policy sees, as far as the observation has them. Images are left out: the rows of the candidates
summarise the part of the map that matters, and train in minutes."""


class Attention(nn.Module):
    """One block of a transformer: everything that is present attends to everything that is present."""

    def __init__(self, width: int):
        super().__init__()
        self.before, self.after = nn.LayerNorm(width), nn.LayerNorm(width)
        self.looks = nn.Linear(width, 3 * width)
        self.takes = nn.Linear(width, width)
        self.thinks = nn.Sequential(nn.Linear(width, 2 * width), nn.ReLU(), nn.Linear(2 * width, width))

    def forward(self, tokens: Tensor, is_present: Tensor) -> Tensor:
        """tokens (batch, n, width), is_present (batch, n) bool -> tokens (batch, n, width)."""
        batch, count, width = tokens.shape
        parts = self.looks(self.before(tokens)).reshape(batch, count, 3, HEADS, width // HEADS)
        query, key, value = parts.permute(2, 0, 3, 1, 4)
        taken = functional.scaled_dot_product_attention(query, key, value, is_present[:, None, None])
        tokens = tokens + self.takes(taken.transpose(1, 2).reshape(batch, count, width))
        return tokens + self.thinks(self.after(tokens))


class FeedForward(nn.Module):
    """In the place of `Attention`: each token by itself, and the first one with the mean of all that are present, as in
    Deep Sets (Zaheer et al. 2017)."""

    def __init__(self, width: int):
        super().__init__()
        self.before = nn.LayerNorm(width)
        self.takes = nn.Linear(width, width)
        self.thinks = nn.Sequential(nn.Linear(width, 2 * width), nn.ReLU(), nn.Linear(2 * width, width))

    def forward(self, tokens: Tensor, is_present: Tensor) -> Tensor:
        """tokens (batch, n, width), is_present (batch, n) bool -> tokens (batch, n, width)."""
        tokens = tokens + self.thinks(self.before(tokens))
        share = is_present / is_present.sum(1, keepdim=True)
        pooled = (tokens * share[..., None]).sum(1, keepdim=True)
        return torch.cat([tokens[:, :1] + self.takes(pooled), tokens[:, 1:]], 1)


class Encoder(nn.Module):
    """One token per choice, teammate and sign, and one for the robot itself."""

    def __init__(self, space: spaces.Dict, width: int, attention: bool = True):
        """attention: whether tokens attend to each other; else each is encoded by itself."""
        super().__init__()
        shapes = {name: tuple(block.shape or ()) for name, block in space.spaces.items()}
        self.width = width
        self.alone = [name for name in ("gains", "other_maps") if name in shapes]
        self.has_signs = "signs" in shapes
        self.frontier = nn.Linear(shapes["frontiers"][1] + shapes["goals"][1] + len(self.alone), width)
        self.extra = nn.Parameter(torch.randn(EXTRA_CHOICES, width) / width**0.5)
        self.teammate = nn.Linear(shapes["team"][1], width)
        self.sign = nn.Linear(shapes["signs"][1], width) if self.has_signs else None
        self.own = nn.Linear(POSE_COLUMNS.stop - POSE_COLUMNS.start + 1, width)
        self.attention = Attention(width) if attention else FeedForward(width)
        self.norm = nn.LayerNorm(width)

    def forward(self, seen: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Blocks (batch, ...) -> encoded choices (batch, choices, width) and situation (batch, width)."""
        frontiers = [seen["frontiers"], seen["goals"], *(seen[name][..., None] for name in self.alone)]
        batch, slots = len(frontiers[0]), frontiers[0].shape[1]
        own = torch.cat([torch.log1p(seen["pose"][:, POSE_COLUMNS]), seen["clock"]], 1)
        tokens = [
            self.own(own)[:, None],
            self.frontier(torch.cat(frontiers, 2)),
            self.extra.expand(batch, -1, -1),
            self.teammate(seen["team"]),
        ]
        is_present = [own.new_ones(batch, 1) > 0, seen["action_mask"] > 0, (seen["team"] != 0).any(2)]
        if self.sign is not None:
            tokens.append(self.sign(seen["signs"]))
            is_present.append(seen["signs"][..., 0] > 0)
        encoded = self.norm(self.attention(torch.cat(tokens, 1), torch.cat(is_present, 1)))
        return encoded[:, 1 : 1 + slots + EXTRA_CHOICES], encoded[:, 0]


class Actor(nn.Module):
    """Logits of the choices: a rule for one robot alone, and what the network adds to it.

    The rule is the utility of González-Baños and Latombe 2002, unknown area in view times exp(-lambda length), whose
    logarithm is a logit; without `gains` it prefers the nearest goal. Its weights are learnt, too, and those of what
    else a goal has (`RULE`). Training starts from it and adds the rest ("residual policy learning", Silver et al. 2018;
    Johannink et al. 2019).
    """

    def __init__(self, space: spaces.Dict, width: int = 64, blind: tuple[str, ...] = (), attention: bool = True):
        """blind: what it does not know of (`blindness.HIDES`); attention: of its encoder."""
        super().__init__()
        self._blind = blind
        self.encoder = Encoder(space, width, attention)
        self.score = nn.Sequential(nn.Linear(2 * width, width), nn.Tanh(), nn.Linear(width, 1))
        for parameter in self.score[2].parameters():
            nn.init.zeros_(parameter)
        self.rule = nn.Parameter(torch.tensor([weight for weight, _ in rule_for(space).values()]))

    def forward(self, seen: dict[str, Tensor]) -> Tensor:
        """(batch, choices) logits; masked choices have probability 0."""
        seen = hidden(seen, self._blind)
        choices, situation = self.encoder(seen)
        around = situation[:, None].expand(-1, choices.shape[1], -1)
        added = self.score(torch.cat([choices, around], 2))[..., 0]
        return added + logits_of_rule(seen, self.rule.expand(len(added), -1))


def rule_for(space: spaces.Dict) -> dict[str, tuple[float, float]]:
    """The part of `RULE` for these observations."""
    return {name: told for name, told in RULE.items() if name != "to other maps" or "other_maps" in space.spaces}


def logits_of_rule(seen: dict[str, Tensor], weights: Tensor) -> Tensor:
    """(batch, choices) for weights (batch, len(rule_for(space))); masked choices have probability 0."""
    row, near, left = seen["frontiers"], seen["goals"], seen["clock"]
    way = _unshared(row[..., 3])
    gain = torch.log(HALF_GAIN_M2 * _unshared(seen["gains"]) + GAIN_MIN_M2) if "gains" in seen else 0.0 * way
    aside = 1.0 - (2.0 * row[..., 1].abs() - 1.0).abs()
    told = [near[..., 0], near[..., 1], aside, row[..., 4]]
    if "other_maps" in seen:
        told.append(_unshared(seen["other_maps"]))
    known = [gain, way, (left - 0.5) * way, *told]
    utilities = torch.zeros_like(gain)
    for number, column in enumerate(known):  # one after the other: matrix products round as the size of the batch says
        utilities = utilities + column * weights[:, number, None]
    logits = SHARPNESS * torch.cat([utilities, weights[:, len(known) :]], 1)
    return logits.masked_fill(seen["action_mask"] <= 0, -1e9)


def _unshared(share: Tensor) -> Tensor:
    """x of x / (x + 1)."""
    share = share.clamp(max=0.99)
    return share / (1.0 - share)
