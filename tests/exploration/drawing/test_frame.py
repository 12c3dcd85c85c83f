"""Captions and legends inside the pictures of films, windows and `rgb_array`."""

import numpy as np
import pytest

import twc_env
from twc_env.exploration.drawing import frame, palette
from twc_env.exploration.drawing.rendering import ClosureLine, Scene, render

pytest.importorskip("PIL", reason="needs the extra 'viz'")


def hall(**settings):
    walls = np.zeros((50, 80), bool)
    walls[[0, -1]] = True
    return Scene(walls, np.zeros(2), 0.1, **settings)


def texts_of(monkeypatch):
    from PIL import ImageDraw

    texts, write = [], ImageDraw.ImageDraw.text

    def noted(draw, place, text, *more, **style):
        box = draw.textbbox(place, text, style.get("font"), style.get("anchor"))
        texts.append((text, box, draw.im.size))
        return write(draw, place, text, *more, **style)

    monkeypatch.setattr(ImageDraw.ImageDraw, "text", noted)
    for cached in (frame._legend, frame._strip):
        cached.cache_clear()
    return texts


def test_the_legend_names_what_is_drawn_and_every_robot(monkeypatch):
    texts = texts_of(monkeypatch)
    poses = np.tile([2.0, 2.0, 0.0], (9, 1))
    poses[:, 0] += 0.6 * np.arange(9)
    closures = (ClosureLine(np.array([[1.0, 1.0], [2.0, 2.0]]), True, 0.0),)
    picture = frame.framed(hall(true_poses=poses, closures=closures), "1.0 s", "keys")
    names = [text for text, _, _ in texts]
    assert {"1.0 s", "keys", "true walls", "accepted closures", "rejected closures"} <= set(names)
    assert [name for name in names if name.startswith("robot")] == [f"robot {k}" for k in range(9)]
    assert {str(k) for k in range(9)} <= set(names)  # beside the robots
    assert "people" not in names and "mapped walls" not in names
    assert picture.shape[1] == frame.WIDTH_PX == 960


def test_no_text_is_cut_off_or_covers_another(monkeypatch):
    texts = texts_of(monkeypatch)
    long = "a building with a long name, " * 12
    frame.framed(hall(true_poses=np.tile([2.0, 2.0, 0.0], (8, 1))), long, "T truth  M maps  " * 9)
    for text, (left, top, right, bottom), (width, height) in texts:
        assert left >= 0 and right <= width and top >= 0 and bottom <= height, text
    legend = [
        box for text, box, _ in texts if text.startswith("robot") or text in ("true walls", "true poses and paths")
    ]
    for k, a in enumerate(legend):
        assert all(a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1] for b in legend[k + 1 :])
    assert (
        "".join(text for text, _, _ in texts if text.startswith(("a building", "name", "with", "long"))).count("name")
        == 12
    )


def test_the_picture_itself_is_whole_between_caption_and_legend():
    scene = hall()
    picture, inner = frame.framed(scene, "caption"), render(scene)
    top = frame.CAPTION_PX + 9
    left = (frame.WIDTH_PX - inner.shape[1]) // 2
    assert np.array_equal(picture[top : top + inner.shape[0], left : left + inner.shape[1]], inner)


def test_the_caption_is_inside_rgb_array_and_names_map_and_seed(monkeypatch):
    texts = texts_of(monkeypatch)
    env = twc_env.parallel_env(map="twin-01", robots=2, render_mode="rgb_array", config={"lidar.beam_count": 60})
    env.reset(seed=5)
    picture = env.render()
    assert texts[0][0] == f"twin-01, seed 5: {env.episode.caption()}"
    strip = picture[: frame.CAPTION_PX + 9].astype(int)
    assert (np.abs(strip - palette.rgb(palette.INK)).max(axis=2) < 30).sum() > 200


def test_without_pillow_there_is_the_picture_alone(monkeypatch):
    monkeypatch.setattr(frame, "find_spec", lambda name: None)
    assert np.array_equal(frame.framed(hall(), "caption"), render(hall()))
