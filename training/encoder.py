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
SHARPNESS, EXTRA_UTILITY = 20.0, -4.0
"""Logits per utility, and utility of other choices than goals. Rate and sharpness were chosen in forty validation
buildings of ExploreQuick-v1: sharper is better for the rule, and leaves less to try."""
USED = ("frontiers", "gains", "goals", "action_mask", "pose", "clock", "team", "signs")
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


class Encoder(nn.Module):
    """One token per choice, teammate and sign, and one for the robot itself."""

    def __init__(self, space: spaces.Dict, width: int):
        super().__init__()
        shapes = {name: tuple(block.shape or ()) for name, block in space.spaces.items()}
        self.width = width
        self.has_gains, self.has_signs = "gains" in shapes, "signs" in shapes
        self.frontier = nn.Linear(shapes["frontiers"][1] + self.has_gains + shapes["goals"][1], width)
        self.extra = nn.Parameter(torch.randn(EXTRA_CHOICES, width) / width**0.5)
        self.teammate = nn.Linear(shapes["team"][1], width)
        self.sign = nn.Linear(shapes["signs"][1], width) if self.has_signs else None
        self.own = nn.Linear(POSE_COLUMNS.stop - POSE_COLUMNS.start + 1, width)
        self.attention = Attention(width)
        self.norm = nn.LayerNorm(width)

    def forward(self, seen: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Blocks (batch, ...) -> encoded choices (batch, choices, width) and situation (batch, width)."""
        frontiers = [seen["frontiers"], seen["goals"]] + ([seen["gains"][..., None]] if self.has_gains else [])
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
    logarithm is a logit; without `gains` it prefers the nearest goal. Its weights are learnt, too, and those of the
    closeness to the last goals and of lying behind. Training starts from it and adds the rest ("residual policy
    learning", Silver et al. 2018; Johannink et al. 2019).
    """

    def __init__(self, space: spaces.Dict, width: int = 64):
        super().__init__()
        self.encoder = Encoder(space, width)
        self.score = nn.Sequential(nn.Linear(2 * width, width), nn.Tanh(), nn.Linear(width, 1))
        with torch.no_grad():
            self.score[2].weight.mul_(0.1)
            self.score[2].bias.zero_()
        self.rule = nn.Parameter(torch.tensor([1.0, -DECAY_PER_M * HALF_WAY_M, 0.0, 0.0, 0.0, 0.0]))
        """Weights of the logarithm of the gain, the way in 10 m, closeness to the last goals, how far it lies behind,
        and whether a teammate is nearer."""
        self.extra = nn.Parameter(torch.full((EXTRA_CHOICES,), EXTRA_UTILITY))
        """Utilities of the other choices, below those of most goals."""

    def forward(self, seen: dict[str, Tensor]) -> Tensor:
        """(batch, choices) logits; masked choices have probability 0."""
        choices, situation = self.encoder(seen)
        around = situation[:, None].expand(-1, choices.shape[1], -1)
        logits = self.score(torch.cat([choices, around], 2))[..., 0] + self._logits_of_rule(seen)
        return logits.masked_fill(seen["action_mask"] <= 0, -1e9)

    def _logits_of_rule(self, seen: dict[str, Tensor]) -> Tensor:
        """(batch, choices)."""
        way = _unshared(seen["frontiers"][..., 3])
        gain = torch.zeros_like(way)
        if self.encoder.has_gains:
            gain = torch.log(HALF_GAIN_M2 * _unshared(seen["gains"]) + GAIN_MIN_M2)
        row, near = seen["frontiers"], seen["goals"]
        goals = torch.stack([gain, way, near[..., 0], near[..., 1], row[..., 1].abs(), row[..., 5]], -1) @ self.rule
        return SHARPNESS * torch.cat([goals, self.extra.expand(len(goals), -1)], 1)


def _unshared(share: Tensor) -> Tensor:
    """x of x / (x + 1)."""
    share = share.clamp(max=0.99)
    return share / (1.0 - share)
