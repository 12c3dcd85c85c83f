"""Render modes: the window shows the picture, on a virtual display, and closing it does not affect the episode."""

import copy
import pickle
import shutil
import subprocess
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import render_test

import twc_env
from twc_env.errors import ConfigError
from twc_env.exploration.drawing import palette
from twc_env.exploration.drawing.extent import wall_points_m
from twc_env.exploration.drawing.rendering import building_box_m

SMALL = {"map": "twin-01", "robots": 2, "max_cycles": 6, "config": {"lidar.beam_count": 60}}
AHEAD = np.array([0.8, 0.1], np.float32)


def team(**arguments):
    return twc_env.parallel_env(**{**SMALL, **arguments})


def step(env):
    return env.step({agent: AHEAD for agent in env.agents})


def building_m(env):
    cells = env.floorplan.cells()
    return building_box_m(cells.origin_m, cells.wall, cells.resolution_m)


@pytest.fixture
def pygame(monkeypatch):
    """pygame without a display and without a limit of the frame rate."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    module = pytest.importorskip("pygame", reason="needs the extra 'viz'")
    monkeypatch.setitem(twc_env.ExplorationEnv.metadata, "render_fps", 0)
    yield module
    module.display.quit()


@pytest.fixture
def display(monkeypatch):
    """Name of a virtual display of 1280 x 1024 pixels."""
    if shutil.which("Xvfb") is None:
        pytest.skip("needs Xvfb (Debian package xvfb)")
    command = ["Xvfb", "-displayfd", "1", "-screen", "0", "1280x1024x24", "-nolisten", "tcp", "-noreset"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as server:
        try:
            name = f":{server.stdout.readline().strip()}"
            assert name != ":", "Xvfb did not start"
            monkeypatch.setenv("DISPLAY", name)
            monkeypatch.setenv("SDL_VIDEODRIVER", "x11")
            yield name
        finally:
            server.terminate()


def test_a_window_on_a_virtual_display_shows_the_picture_until_closed(display):
    pygame = pytest.importorskip("pygame", reason="needs the extra 'viz'")
    grab = pytest.importorskip("PIL.ImageGrab", reason="needs the extra 'viz'").grab
    shown, drawn = team(render_mode="human"), team(render_mode="rgb_array")
    for env in (shown, drawn):
        env.reset(seed=1)
        step(env)
    expected = drawn.render()
    screen = np.array(grab(xdisplay=display).convert("RGB"))
    lit = np.argwhere(screen.any(axis=2))
    (top, left), (bottom, right) = lit.min(axis=0), lit.max(axis=0) + 1
    assert bottom - top > expected.shape[0] and right - left == expected.shape[1]  # with a line about the keys
    assert np.array_equal(screen[top : top + expected.shape[0], left:right], expected)
    shown.close()
    assert not pygame.display.get_init()
    assert not np.array(grab(xdisplay=display).convert("RGB")).any()


def test_every_time_step_is_shown_once_at_the_frame_rate(pygame, monkeypatch):
    monkeypatch.setitem(twc_env.ExplorationEnv.metadata, "render_fps", 25)
    flips, flip = [], pygame.display.flip
    monkeypatch.setattr(pygame.display, "flip", lambda: (flips.append(pygame.time.get_ticks()), flip()))
    env = team(render_mode="human")
    env.reset(seed=0)
    while env.agents:
        step(env)
        assert env.render() is None  # already shown
        assert pygame.display.get_caption()[0] == env.episode.caption()
    assert len(flips) == 1 + SMALL["max_cycles"]
    assert flips[-1] - flips[1] >= 0.9 * 1000 * (len(flips) - 2) / 25
    env.close()


def test_every_time_step_of_a_long_action_is_shown(pygame, monkeypatch):
    flips = []
    monkeypatch.setattr(pygame.display, "flip", lambda: flips.append(1))
    env = team(render_mode="human", config={**SMALL["config"], "action.kind": "frontier"})
    env.reset(seed=0)
    infos = env.step({agent: 0 for agent in env.agents})[-1]
    assert len(flips) == 1 + infos["robot_0"]["time_steps"] > 2
    env.close()


def test_closing_the_window_does_not_end_the_episode(pygame):
    env = team(render_mode="human")
    env.reset(seed=0)
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    while env.agents:
        step(env)
    assert not pygame.display.get_init()
    assert env.render() is None
    env.reset(seed=1)
    assert not pygame.display.get_init()
    env.close()
    env.close()


def test_the_window_is_resized_for_another_building(pygame):
    env = team(render_mode="human")
    sizes = set()
    for name in ("twin-01", "gen:office:200:1"):
        env.reset(seed=0, options={"map": name})
        sizes.add(pygame.display.get_surface().get_size())
    env.close()
    assert len(sizes) == 2


def test_keys_toggle_layers_of_the_window(pygame):
    env = team(render_mode="human")
    env.reset(seed=0)

    def shown(keys: str):
        for key in keys:
            pygame.event.post(pygame.event.Event(pygame.KEYDOWN, unicode=key, key=ord(key)))
        step(env)
        return pygame.surfarray.array3d(pygame.display.get_surface()).astype(int)

    everything = shown("")
    without_truth = shown("t")
    assert np.abs(everything - without_truth).max() > 0
    assert np.ptp(shown("mcp")[:, 60:200, 0]) == 0  # only the background is left
    one = shown("tmcp1")
    assert (one == (213, 94, 0)).all(axis=2).any()  # the true pose of robot 1 is drawn
    viewer = env._viewer
    assert (viewer._layers.robot, viewer._layers.truth) == (0, True)
    shown("0x")
    assert viewer._layers.robot is None
    signal = shown("s")
    assert np.abs(signal - everything).max() > 0
    env.close()


def test_the_space_key_pauses_the_episode(pygame, monkeypatch):
    env = team(render_mode="human")
    env.reset(seed=0)
    waits, press = [], lambda: pygame.event.post(pygame.event.Event(pygame.KEYDOWN, unicode=" ", key=32))

    def wait(milliseconds):
        waits.append(milliseconds)
        if len(waits) == 3:
            press()

    monkeypatch.setattr(pygame.time, "wait", wait)
    press()
    step(env)
    assert len(waits) == 3
    env.close()


def test_the_window_does_not_affect_the_episode(pygame, same):
    def play(render_mode):
        env = team(render_mode=render_mode)
        env.reset(seed=3)
        while env.agents:
            observations, rewards, *_ = step(env)
        env.close()
        return observations, rewards

    (seen, paid), (other_seen, other_paid) = play("human"), play(None)
    assert paid == other_paid
    assert all(same(seen[agent], other_seen[agent]) for agent in seen)


def test_copies_of_an_environment_open_their_own_window(pygame):
    env = team(render_mode="human", render_signal=True)
    env.reset(seed=0)
    for copied in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert copied.render_mode == "human"
        copied.close()
    assert pygame.display.get_init()
    env.close()


def test_without_pygame_the_error_names_the_extra(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"twc_env\[viz\]"):
        team(render_mode="human")


def test_without_a_display_the_error_says_so(pygame, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "none such")
    with pytest.raises(ConfigError, match="no window"):
        team(render_mode="human").reset(seed=0)


def test_pettingzoo_accepts_the_pictures_in_every_mode(pygame):
    assert twc_env.ExplorationEnv.metadata["render_modes"] == ["human", "rgb_array"]
    render_test(lambda render_mode: twc_env.env(**{**SMALL, "render_mode": render_mode}))


def test_gymnasium_accepts_the_pictures_in_every_mode(pygame):
    check_env(gymnasium.make("twc/Explore-v0", max_cycles=5).unwrapped)


def test_pictures_widen_to_a_map_that_lies_askew_keep_their_size_and_stay_wide_until_the_next_episode(monkeypatch):
    env = team(render_mode="rgb_array")
    env.reset(seed=0)
    step(env)
    before, scores = env.render(), env.episode.map_scores()

    def moved(by_m):
        poses = [score.pose_building_map + [by_m, 0.0, 0.0] for score in scores]
        return [replace(score, pose_building_map=pose) for score, pose in zip(scores, poses, strict=True)]

    def walls(picture):  # dark columns between caption and legend
        return np.flatnonzero((picture[40:-60] == palette.rgb(palette.WALL)).all(axis=2).any(axis=0))

    x_max = env.floorplan.bounds_m[2]
    ends_m = [wall_points_m(score.grid, score.pose_building_map)[:, 0].max() for score in scores]
    monkeypatch.setattr(env.episode, "map_scores", lambda: moved(x_max - max(ends_m) + 3.0))
    beside = env.render()
    assert beside.shape == before.shape and walls(beside).max() < 945 and np.ptp(walls(beside)) < np.ptp(walls(before))
    monkeypatch.setattr(env.episode, "map_scores", lambda: moved(900.0))
    assert not len(walls(env.render())) and np.ptp(env._viewer._shown_m[:, 0]) < 1.31 * np.ptp(building_m(env)[:, 0])
    monkeypatch.undo()
    assert np.ptp(walls(env.render())) < np.ptp(walls(before))
    env.reset(seed=0)
    step(env)
    assert np.array_equal(env.render(), before)


def test_closures_and_the_signal_layer_are_drawn():
    from twc_env.exploration.drawing.rendering import (
        CLOSURE,
        FRESH_S,
        ClosureLine,
        Scene,
        SignalLayer,
        render,
    )

    def picture(**settings):
        return render(Scene(np.zeros((100, 200), bool), np.zeros(2), 0.1, **settings)).astype(int)

    def reddish(image, colour):
        return int((np.abs(image - colour).max(axis=2) < 12).sum())

    ends_m = np.array([[4.0, 5.0], [16.0, 5.0]])
    for is_accepted, least in ((True, 300), (False, 150)):
        fresh, old = (picture(closures=(ClosureLine(ends_m, is_accepted, age),)) for age in (0.0, 2 * FRESH_S))
        assert reddish(fresh, CLOSURE) > least
        assert reddish(old, CLOSURE) == 0
        assert (np.abs(old - picture()).max() > 0) == is_accepted  # old rejected closures are not drawn
    share = np.tile(np.linspace(0.0, 1.0, 20), (10, 1))
    share[:, 10:12] = np.nan
    tinted = picture(signal=SignalLayer(share, np.zeros(2), 1.0))
    row = tinted[tinted.shape[0] // 2]
    assert row[60].sum() < row[-60].sum()  # violet is weak, yellow is strong
    middle = row.shape[0] // 2
    assert np.array_equal(row[middle], picture()[0, 0])


def test_the_age_of_a_closure_restarts_when_its_status_changes():
    from types import SimpleNamespace as Thing

    from twc_env.exploration.viewer import SeenClosures

    closure = Thing(status="pending", candidate=Thing(target=(0, 0), source=(1, 0), recogniser="text"))
    mapper = Thing(closures=[closure], segment_path=lambda segment: (np.array([[1.0 + segment, 0.0, 0.0]]), [0]))
    view = Thing(mapper=mapper, viewers=(0, 1), segments=(0, 1))
    score = Thing(view=view, robots=(0, 1), pose_building_map=np.array([10.0, 0.0, 0.0]))
    seen = SeenClosures()

    def line(step):
        return [(x.is_accepted, x.age_s) for x in seen.lines([score], step, 0.1)]

    assert line(1) == []
    closure.status = "rejected"
    assert line(10) == [(False, 0.0)]
    assert line(30) == [(False, 2.0)]
    closure.status = "accepted"
    assert line(40) == [(True, 0.0)]
    assert line(20) == [(True, 0.0)]  # as after restoring a snapshot
    assert np.array_equal(seen.lines([score], 50, 0.1)[0].ends_m, [[11.0, 0.0], [12.0, 0.0]])
