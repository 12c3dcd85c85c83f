"""Malformed settings: TOML, JSON and run folders. Reading one may only raise ConfigError; what is read must work."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from tests.soak.attempts import Attempt, workplace
from tests.soak.malformed.mutations import ODD_VALUES, OF_JSON, OF_TEXT, mutated
from twc_env.config import EnvConfig, digest, from_dict, load, override, to_dict
from twc_env.config.manual import as_toml
from twc_env.errors import ConfigError
from twc_env.exploration.environment import ExplorationEnv
from twc_env.records.random_streams import random_stream

_TOML_VALUES = (
    "nan", "inf", "-inf", "1e400", "9" * 400, "-1", "true", '""', '"x"', "[]", "{}", "1979-05-27", "0x10", "1_0",
    "[[]]", '"FILE.py:CLASS"', "0", "1.5", '"\\u0000"', "99999",
)  # fmt: skip
SHORT = {"max_cycles": 3, "map": "twin-01"}
"""Of accepted settings, what an episode is tried with."""
PLAYED_EVERY = 20
ROBOTS_MAX, BEAMS_MAX, SLOTS_MAX = 8, 720, 64


def malformed_settings(count: int, seed: int = 0) -> Iterator[Attempt]:
    """Read `count` malformed files of settings; equal seeds give the same files."""
    random = random_stream(seed, "settings-fuzz")
    toml = re.sub(r"^#(?=\w)", "", as_toml(EnvConfig()), flags=re.MULTILINE).encode()  # no setting commented out
    whole = json.dumps(to_dict(EnvConfig())).encode()
    short = (
        b'{"robots": 2, "robot": [{"preset": "handheld"}, "legged"], "lidar": {"preset": "lds-01"}, "world": "ward"}'
    )
    with workplace() as folder:
        (folder / "run").mkdir()
        _use(_written(folder / "a.json", whole), True)  # kernels compile before the clock runs
        for number in range(count):
            kind = number % 4
            if kind == 0:
                raw, what = mutated(toml, random, OF_TEXT)
            elif kind == 1:
                raw, what = _odd_setting(toml.decode(), random)
            else:
                raw, what = mutated(short if kind == 3 else whole, random, OF_JSON)
            path = folder / ("a.toml", "b.toml", "run/config.json", "c.json")[kind]
            is_played = random.random() < 1 / PLAYED_EVERY
            yield f"#{number} {path.name}: {what}", partial(_use, _written(path, raw), is_played)


def _written(path: Path, raw: bytes) -> Path:
    path.write_bytes(raw)
    return path.parent if path.name == "config.json" else path


def _odd_setting(toml: str, random: np.random.Generator) -> tuple[bytes, str]:
    """One setting with another value, the text of which is valid TOML for the most part."""
    lines = toml.splitlines()
    own = [k for k, line in enumerate(lines) if " = " in line and not line.startswith("#")]
    at = own[int(random.integers(len(own)))]
    if random.random() < 0.7:
        value = _TOML_VALUES[int(random.integers(len(_TOML_VALUES)))]
    else:
        value = json.dumps(ODD_VALUES[int(random.integers(len(ODD_VALUES)))])
    lines[at] = f"{lines[at].split(' = ')[0]} = {value}"
    return "\n".join(lines).encode(), lines[at][:60]


def _use(path: Path, is_played: bool) -> None:
    """Read settings; those that are accepted survive writing, and every so often an episode is played with them."""
    config = load(path)
    assert digest(from_dict(to_dict(config))) == digest(config), "settings change when they are written and read"
    slots = (config.observation.wifi_slots, config.observation.sign_slots, config.action.frontier_slots)
    is_small = config.robots <= ROBOTS_MAX and config.lidar.beam_count <= BEAMS_MAX and max(slots) <= SLOTS_MAX
    if not is_played or not is_small or config.slam.prior:
        return
    env = ExplorationEnv(config=override(config, SHORT))
    env.reset(seed=0)
    try:
        env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    except ConfigError as error:
        raise AssertionError(f"settings that were accepted end in an error: {error}") from error
