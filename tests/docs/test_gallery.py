"""The small pictures of the gallery: one for every task v1 and kind of building, without texts and ground."""

import importlib.util
import re
from pathlib import Path

import pytest

from twc_env.pictures.style import save_figure
from twc_env.tasks import SUITES
from twc_env.world.building.layouts import KINDS

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
BYTES_MAX, SIDE_MAX_PX = 130_000, 450
spec = importlib.util.spec_from_file_location("gallery", ROOT / "docs" / "site" / "gallery.py")
gallery = importlib.util.module_from_spec(spec)
spec.loader.exec_module(gallery)
NAMES = (*SUITES["v1"], *gallery.MAPS)


def test_every_task_v1_and_every_kind_of_building_is_shown_and_the_command_is_named():
    shown = re.findall(r"^!\[[^]]+\]\((pictures/\S+)\)$", PAGE, re.MULTILINE)
    assert {str(gallery.picture_of(name).relative_to(ROOT / "docs")) for name in NAMES} <= set(shown)
    assert {name.split(":")[1] for name in gallery.MAPS} == set(KINDS)
    assert all(f"`{name}`" in PAGE for name in gallery.MAPS) and "`python docs/site/gallery.py`" in PAGE


@pytest.mark.parametrize("name", NAMES)
def test_pictures_are_small_files_that_also_stand_on_a_dark_page(name):
    image = pytest.importorskip("PIL.Image")
    path = gallery.picture_of(name)
    assert path.stat().st_size < BYTES_MAX
    with image.open(path) as picture:
        assert max(picture.size) <= SIDE_MAX_PX and picture.mode == "RGBA"
        assert picture.getchannel("A").getextrema()[0] == 0


@pytest.mark.parametrize("name", ["twc/ExploreQuick-v1", "gen:office:100:7"])
def test_the_command_draws_a_picture_without_texts(name, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(gallery, "PICTURES", tmp_path)
    monkeypatch.setattr(
        gallery, "save_figure", lambda figure, *rest: drawn.append(figure) or save_figure(figure, *rest)
    )
    monkeypatch.setattr(gallery, "figure_of_task", lambda task, play=gallery.figure_of_task: play(task, 20))
    drawn = []
    gallery.main([name])
    ((axes,),) = [figure.axes for figure in drawn]
    assert not axes.texts and not axes.axison and not drawn[0].legends and not drawn[0].get_suptitle()
    assert gallery.picture_of(name).read_bytes().startswith(b"\x89PNG")
