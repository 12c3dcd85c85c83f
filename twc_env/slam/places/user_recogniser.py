"""A place recogniser loaded from a user's file, with checks of its candidates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from twc_env.config import PlaceRecognitionConfig
from twc_env.errors import DataError
from twc_env.records.class_file import check_call, class_in
from twc_env.records.messages import Keyframe, LoopCandidate


class OwnRecogniser:
    """The class that `recogniser` names as FILE.py:CLASS, constructed from the config and the scanner's range [m]."""

    def __init__(self, config: PlaceRecognitionConfig, range_max_m: float):
        """Raises ConfigError if the class does not exist, lacks a method of `Recogniser`, or takes other arguments."""
        remedy = (
            "a place recogniser has what twc_env.slam.places.place_recognition.Recogniser names "
            "(sparsify was forget until version 0.1.0)"
        )
        self._file = config.recogniser
        own, settings = class_in(self._file, ("name", "propose", "sparsify"), remedy), "slam.place_recognition"
        check_call(f"{self._file}, when it is made,", f"with ({settings}, range_max_m)", own, config, range_max_m)
        self._own = own(config, range_max_m)
        check_call(f"{self._file}.propose", "with (keyframe, skipped_robots)", self._own.propose, None, ())
        check_call(f"{self._file}.sparsify", "with (is_held)", self._own.sparsify, None)
        self.name: str = self._own.name
        self._known: dict[tuple[int, int], Keyframe] = {}
        """Keyframes passed to it that are still held, by robot and index."""

    def propose(self, keyframe: Keyframe, skipped_robots: Sequence[int] = ()) -> list[LoopCandidate]:
        """See `Recogniser`. The class cannot write into the keyframe's arrays, which are those of the map.

        Raises DataError for malformed candidates: wrong type, name or source, a target that is no earlier keyframe, or
        a guess that is no finite pose.
        """
        proposed = self._own.propose(_read_only(keyframe), skipped_robots)
        if not isinstance(proposed, Sequence) or not all(isinstance(each, LoopCandidate) for each in proposed):
            raise DataError(f"{self._file} must propose a list of LoopCandidate; got {proposed!r}")
        candidates = [self._checked(candidate, keyframe) for candidate in proposed]
        self._known[keyframe.key] = keyframe
        return candidates

    def score(self, target: Keyframe, source: Keyframe) -> float:
        """See `Recogniser`."""
        return float(self._own.score(_read_only(target), _read_only(source)))

    def sparsify(self, is_held: Callable[[Keyframe], bool]) -> None:
        """See `Recogniser`."""
        self._known = {key: keyframe for key, keyframe in self._known.items() if is_held(keyframe)}
        self._own.sparsify(is_held)

    def _checked(self, candidate: LoopCandidate, keyframe: Keyframe) -> LoopCandidate:
        guess, source = np.array(candidate.guess, float), keyframe.key
        if guess.shape != (3,) or not np.isfinite(guess).all():
            raise DataError(f"{self._file} must guess a pose (x, y, heading); got {candidate.guess!r}")
        if candidate.recogniser != self.name or tuple(candidate.source) != source:
            got = f"{candidate.recogniser!r} and {candidate.source}"
            raise DataError(f"{self._file} must name candidates {self.name!r}, with source {source}; got {got}")
        if tuple(candidate.target) not in self._known:
            raise DataError(f"{self._file} must name keyframes that it was shown before; got target {candidate.target}")
        sign_m = None if candidate.sign_m is None else np.array(candidate.sign_m)  # maybe a read-only one
        return replace(candidate, guess=guess, sign_m=sign_m)


def _read_only(value: Any) -> Any:
    """The same record, with read-only views of all arrays in it."""
    if isinstance(value, np.ndarray):
        view = value.view()
        view.flags.writeable = False
        return view
    if isinstance(value, tuple):
        return tuple([_read_only(part) for part in value])
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{part.name: _read_only(getattr(value, part.name)) for part in fields(value)})
    return value
