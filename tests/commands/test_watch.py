"""`twc-env watch` on a display that is not there."""

import json
import sys

import numpy as np
import pytest

import twc_env
from twc_env.__main__ import main
from twc_env.commands.watch import steering
from twc_env.exploration.environment import ExplorationEnv

SMALL = ["watch", "--map", "sfw-e1", "--robots", "2", "--steps", "20", "--speed", "100", "--set", "lidar.beam_count=60"]


@pytest.fixture
def pygame(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    module = pytest.importorskip("pygame", reason="needs the extra 'viz'")
    yield module
    module.display.quit()


@pytest.fixture
def driven(monkeypatch):
    """The actions of every step."""
    actions, step = [], ExplorationEnv.step
    monkeypatch.setattr(ExplorationEnv, "step", lambda env, given: actions.append(given) or step(env, given))
    return actions


def press(pygame, *keys, kind="KEYDOWN"):
    for key in keys:
        pygame.event.post(
            pygame.event.Event(getattr(pygame, kind), key=key, unicode="\t" if key == pygame.K_TAB else "")
        )


def test_steering_by_arrow_keys():
    assert steering({"up"}) == (1.0, 0.0) and steering({"down", "left"}) == (-1.0, 0.8)
    assert steering({"up", "down", "right"}) == (0.0, -0.8) and steering(set()) == (0.0, 0.0)


def test_one_robot_is_driven_by_the_keys_and_the_others_by_the_team(pygame, driven, monkeypatch, tmp_path):
    shown = []

    def flip():
        shown.append(1)
        if len(shown) == 5:
            press(pygame, pygame.K_UP)
        if len(shown) == 10:
            press(pygame, pygame.K_UP, kind="KEYUP")
            press(pygame, pygame.K_RIGHT)

    monkeypatch.setattr(pygame.display, "flip", flip)
    assert main([*SMALL, "--drive", "0", "--close", "--json", str(tmp_path / "a.json")]) == 0
    own = [tuple(np.round(actions["robot_0"].astype(float), 2).tolist()) for actions in driven]
    assert own[:4] == [(0.0, 0.0)] * 4 and own[6:8] == [(1.0, 0.0)] * 2 and own[12] == (0.0, -0.8)
    assert len(own) == 20 and any(np.abs(actions["robot_1"]).max() > 0.1 for actions in driven)
    assert json.loads((tmp_path / "a.json").read_text())["steps"] == 20


def test_tab_goes_to_the_next_robot_and_to_none(pygame, driven, monkeypatch):
    shown = []

    def flip():
        shown.append(1)
        if len(shown) in (6, 12):
            press(pygame, pygame.K_TAB)

    monkeypatch.setattr(pygame.display, "flip", flip)
    assert main([*SMALL, "--drive", "0", "--close"]) == 0
    still = [[bool(np.abs(actions[f"robot_{k}"]).max() == 0) for k in range(2)] for actions in driven]
    assert still[3][0] and still[9][1]
    assert not any(still[-1])


def test_the_result_is_printed_and_the_window_stays_until_it_is_closed(pygame, monkeypatch, capsys):
    waits, wait = [], pygame.time.wait

    def waiting(milliseconds):
        waits.append(milliseconds)
        if len(waits) == 3:
            pygame.event.post(pygame.event.Event(pygame.QUIT))
        wait(1)

    monkeypatch.setattr(pygame.time, "wait", waiting)
    assert main(SMALL) == 0
    assert len(waits) >= 3 and not pygame.display.get_init()
    assert "team ATE" in capsys.readouterr().out


def test_closing_the_window_ends_the_command(pygame, driven):
    pygame.init()
    pygame.display.init()
    shown = []

    def flip():
        shown.append(1)
        if len(shown) == 4:
            pygame.event.post(pygame.event.Event(pygame.QUIT))

    original, pygame.display.flip = pygame.display.flip, flip
    try:
        assert main(SMALL) == 0
    finally:
        pygame.display.flip = original
    assert len(driven) < 8


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a display")
def test_without_a_display_there_is_one_line_and_none_of_a_library(monkeypatch, capfd):
    pytest.importorskip("pygame", reason="needs the extra 'viz'")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER", "XDG_RUNTIME_DIR"):
        monkeypatch.delenv(name, raising=False)
    assert main(SMALL) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith("error: no window can be opened here") and "twc-env explore" in line


def test_only_robots_that_there_are_can_be_driven(capsys, pygame):
    assert main([*SMALL, "--drive", "2"]) == 2
    assert "--drive names a robot from 0 to 1; got 2" in capsys.readouterr().err


def test_the_help_teaches_what_to_see_and_to_press(capsys):
    with pytest.raises(SystemExit):
        main(["watch", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    for word in ("arrow keys", "tab", "space", "disc", "ring", "violet", "drift", "merge", "What to try"):
        assert word in text


def test_an_environment_without_a_window_says_so():
    assert twc_env.parallel_env().window is None
