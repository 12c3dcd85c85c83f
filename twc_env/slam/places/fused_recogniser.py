"""The recogniser `fused`: log-odds of all cues."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from twc_env.config import PlaceRecognitionConfig
from twc_env.records.messages import Keyframe, LoopCandidate
from twc_env.slam.places.place_evidence import PlaceMemory
from twc_env.slam.places.sign_place import SignView


class FusedRecogniser:
    """Proposes pairs of signs by the sum of the log-odds of text, radio, walls, neighbouring signs and paths."""

    name = "fused"

    def __init__(self, config: PlaceRecognitionConfig, range_max_m: float):
        self._config = config
        self.memory = PlaceMemory(range_max_m)
        """Observed signs and statistics of the cues."""

    def propose(self, keyframe: Keyframe, skipped_robots: Sequence[int] = ()) -> list[LoopCandidate]:
        """See `Recogniser`. For each known sign only the view with the most similar fingerprint is weighed."""
        best: dict[tuple[int, int], LoopCandidate] = {}
        places = self.memory.observe(keyframe)
        for sign, place in zip(keyframe.signs, places, strict=True):
            for robot in sorted(set(self.memory.signs) - set(skipped_robots)):
                for known in self.memory.like_text(place, robot):
                    views = [view for view in known.views if self._is_apart(view[0], keyframe)]
                    if not views:
                        continue
                    candidate = self._weigh(self.memory.best_view(views, keyframe), (keyframe, sign))
                    held = best.get(candidate.target) if candidate is not None else None
                    if candidate is not None and (held is None or candidate.log_odds > held.log_odds):
                        best[candidate.target] = candidate
        return list(best.values())

    def sparsify(self, is_held: Callable[[Keyframe], bool]) -> None:
        """See `Recogniser`."""
        self.memory.sparsify(is_held)

    def score(self, target: Keyframe, source: Keyframe) -> float:
        """Largest log-odds over pairs of signs of two keyframes that were proposed before; -inf without signs."""
        pairs = [((target, a), (source, b)) for a in target.signs for b in source.signs]
        return max((self.memory.weigh(*pair).total for pair in pairs), default=-math.inf)

    def _is_apart(self, earlier: Keyframe, keyframe: Keyframe) -> bool:
        is_own = earlier.robot == keyframe.robot
        return not is_own or keyframe.travel_m - earlier.travel_m >= self._config.revisit_travel_m

    def _weigh(self, target: SignView, source: SignView) -> LoopCandidate | None:
        total = self.memory.weigh(target, source).total
        guess = None if total < self._config.log_odds_min else self.memory.guess(target, source)
        if guess is None:
            return None
        ends = target[0].key, source[0].key
        return LoopCandidate(*ends, guess, self.name, sign_m=target[1].position_m, log_odds=total)
