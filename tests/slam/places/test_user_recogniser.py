"""Custom place recognisers, named by their file."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import twc_env
from twc_env import ConfigError, DataError, EnvConfig
from twc_env.__main__ import main
from twc_env.config import PlaceRecognitionConfig, from_dict, override, to_dict
from twc_env.config.manual import as_toml
from twc_env.records.class_file import digest_of
from twc_env.records.messages import SignObservation
from twc_env.slam.cues import restricted_config
from twc_env.slam.mapping.closure_search import make_recogniser

LIBRARY = Path(__file__).parents[3] / "docs/library.md"
OWN = "places.py:SameRouter"
SETTING = "slam.place_recognition.recogniser"
UNFIT = """
from places import SameRouter


class Bare:
    name = "bare"

    def propose(self, *_): ...

    def sparsify(self, *_): ...


class Alone(SameRouter):
    def propose(self, keyframe): ...


class Keeps(SameRouter):
    def sparsify(self): ...


class Writes(SameRouter):
    def propose(self, keyframe, skipped_robots=()):
        keyframe.robot = 9
        for array in (keyframe.ranges_m, keyframe.motion, keyframe.fingerprint.rssi_dbm, keyframe.signs[0].position_m):
            assert not array.flags.writeable
        keyframe.ranges_m[:] = 1.0
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A config, and overrides that select the recogniser of docs/library.md; its file also has an incomplete class,
    and another one has classes that cannot be called."""
    monkeypatch.chdir(tmp_path)
    text = LIBRARY.read_text().partition("### Your own place recogniser")[2]
    code = re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0]
    (tmp_path / "places.py").write_text(f"{code}\n\nclass Half:\n    def propose(self, *_):\n        return []\n")
    (tmp_path / "unfit.py").write_text(UNFIT)
    return EnvConfig(max_cycles=700), {SETTING: OWN, "slam.place_recognition.proximity_m": 0.0}


def test_robots_are_merged_with_a_custom_recogniser(own, capsys):
    config = override(*own)
    assert from_dict(to_dict(config)) == config
    settings = [f"--set={key}={value}" for key, value in own[1].items()]
    explore = ["explore", "--no-pictures", "--steps", "700", "--seed", "1", *settings, "--out", "run"]
    assert main(explore) == 0
    report = json.loads(Path("run/report.json").read_text())
    assert report["recogniser_digest"] == digest_of(OWN)
    assert report["merged_robots"] >= 2 and report["wrong_merges"] == 0
    found = json.loads(Path("run/config.json").read_text())
    assert found["slam"]["place_recognition"]["recogniser"] == OWN


def test_a_benchmark_is_repeated_after_a_change_of_the_recogniser(own, capsys):
    settings = [f"--set={key}={value}" for key, value in own[1].items()]
    benchmark = ["benchmark", "--maps", "sfw-e1", "--seeds", "0", "--robots", "1", "--steps", "3", "--no-pictures"]
    assert main([*benchmark, *settings, "--out", "out"]) == 0 and main([*benchmark, *settings, "--out", "out"]) == 0
    assert "(reused)" in capsys.readouterr().err
    with Path("places.py").open("a") as file:
        file.write("CHANGED = True\n")
    assert main([*benchmark, *settings, "--out", "out"]) == 0
    assert "(reused)" not in capsys.readouterr().err


def test_a_snapshot_contains_the_state_of_a_custom_recogniser(own):
    config, settings = own
    env = twc_env.parallel_env(config=override(config, settings))
    env.reset(seed=1)

    def go_on() -> dict:
        for _ in range(200):
            env.step(dict.fromkeys(env.agents, np.array([0.8, 0.3], np.float32)))
        return env.result().figures

    go_on()
    moment = env.snapshot()
    figures = go_on()
    env.restore(moment)
    assert figures["closures"]["proposed"] > 0 and go_on() == figures


@pytest.mark.parametrize("cue", ["text", "wifi", "lidar"])
def test_a_custom_recogniser_is_used_even_if_cues_are_disabled(own, cue):
    config = restricted_config(override(own[0], own[1] | {f"slam.cues.{cue}": False}))
    assert config.slam.place_recognition.recogniser == OWN


def test_the_settings_mention_custom_classes():
    assert "# one of twc, text, wifi, lidar, fused or FILE.py:CLASS" in as_toml(EnvConfig(), ["slam.place_recognition"])


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("places.py:SameRoute", r"no class 'SameRoute' in .*places\.py; it has SameRouter$"),
        ("other.py:Mine", "there is no file other.py"),
        (
            "places.py:Half",
            r"has no name and no sparsify: a place recogniser has what .*\.Recogniser names \(sparsify was forget",
        ),
        (
            "unfit.py:Bare",
            r"unfit.py:Bare, when it is made, cannot be called with \(slam\.place_rec.*, range_max_m\): too",
        ),
        ("unfit.py:Alone", r"Alone.propose cannot be called with \(keyframe, skipped_robots\): too many positional"),
        ("unfit.py:Keeps", r"Keeps.sparsify cannot be called with \(is_held\): too many positional"),
        ("places", r"must be one of .*, fused or FILE\.py:CLASS; got 'places'"),
    ],
)
def test_the_error_of_an_invalid_recogniser_names_the_remedy(own, name, remedy):
    with pytest.raises(ConfigError, match=remedy):
        make_recogniser(override(EnvConfig(), {SETTING: name}).slam.place_recognition, 8.0)


@pytest.mark.parametrize(
    ("proposed", "remedy"),
    [
        ("None", "must propose a list of LoopCandidate; got None"),
        ("[(0, 0)]", r"must propose a list of LoopCandidate; got \[\(0, 0\)\]"),
        (
            "[LoopCandidate((0, 0), (1, 3), [0.0, 0.0], 'odd')]",
            r"must guess a pose \(x, y, heading\); got \[0\.0, 0\.0\]",
        ),
        ("[LoopCandidate((0, 0), (1, 3), [0.0, 0.0, float('nan')], 'odd')]", "must guess a pose"),
        (
            "[LoopCandidate((0, 0), (1, 3), [0.0, 0.0, 0.0], 'even')]",
            r"must name candidates 'odd', with source \(1, 3\)",
        ),
        ("[LoopCandidate((1, 3), (0, 0), [0.0, 0.0, 0.0], 'odd')]", r"with source \(1, 3\); got 'odd' and \(0, 0\)"),
        ("[LoopCandidate((0, 1), (1, 3), [0.0, 0.0, 0.0], 'odd')]", r"shown before; got target \(0, 1\)"),
        ("[LoopCandidate((1, 3), (1, 3), [0.0, 0.0, 0.0], 'odd')]", r"shown before; got target \(1, 3\)"),
    ],
)
def test_invalid_candidates_are_rejected_before_the_engine_uses_them(own, keyframe, proposed, remedy):
    Path("odd.py").write_text(
        "from twc_env.records.messages import LoopCandidate\n\n\nclass Odd:\n    name = 'odd'\n\n"
        "    def __init__(self, *_):\n        pass\n\n    def sparsify(self, is_held):\n        pass\n\n"
        f"    def propose(self, keyframe, *_):\n        return {proposed} if keyframe.robot else []\n"
    )
    recogniser = make_recogniser(PlaceRecognitionConfig(recogniser="odd.py:Odd"), 8.0)
    assert recogniser.propose(keyframe(0, 0)) == []
    with pytest.raises(DataError, match=remedy):
        recogniser.propose(keyframe(1, 3))


def test_a_recogniser_cannot_write_into_the_map(own, keyframe):
    recogniser = make_recogniser(PlaceRecognitionConfig(recogniser="unfit.py:Writes"), 8.0)
    shown = keyframe(0, 0, signs=[SignObservation("A1", np.ones(2), 0.0)], macs=[1], rssi_dbm=[-40.0])
    with pytest.raises(ValueError, match="read-only"):
        recogniser.propose(shown)
    assert shown.robot == 0 and shown.ranges_m.min() > 1.0 and shown.ranges_m.flags.writeable
