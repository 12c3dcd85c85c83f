"""The documentation site builds without a warning, and everything on it leads somewhere on it."""

import functools
import http.server
import json
import os
import re
import subprocess
import sys
import threading
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

import twc_env
from tests.chromium import screen
from twc_env.__main__ import COMMANDS

ROOT = Path(__file__).parents[2]
FILM_MAX_BYTES = 2_000_000
PHONE, DESKTOP = (390, 844), (1280, 900)


class Page(HTMLParser):
    """Links, anchors and what a page loads."""

    def __init__(self, path: Path):
        super().__init__()
        self.links, self.anchors, self.loads, self.titles = [], set(), [], 0
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.anchors |= {given[key] for key in ("id", "name") if given.get(key)}
        self.titles += tag == "h1"
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])
        if tag in ("img", "script", "source") and given.get("src"):
            self.loads.append(given["src"])
        if tag == "link" and given.get("rel") in ("stylesheet", "icon", "preload"):
            self.loads.append(given["href"])


def built(folder: Path, repository: str = "", config: str = "mkdocs.yml") -> Path:
    """The folder of the built site."""
    for module in ("mkdocs", "material", "mkdocstrings"):
        pytest.importorskip(module, reason="needs the extra 'docs'")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder), "--config-file", config]
    env = {**os.environ, "NO_MKDOCS_2_WARNING": "1", "GITHUB_REPOSITORY": repository}
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "WARNING" not in done.stdout + done.stderr
    return folder


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    return built(tmp_path_factory.mktemp("site"))


@pytest.fixture(scope="module")
def pages(site):
    return {path: Page(path) for path in site.rglob("*.html")}


def test_every_link_leads_to_a_page_and_a_heading_of_the_site(site, pages):
    lost = []
    for path, page in pages.items():
        if path.name == "404.html":
            continue  # it is shown at any address, so its links begin at the root of the server
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            is_there = target.exists() and target.is_relative_to(site.resolve())
            anchors = pages[target].anchors if target in pages else {parts.fragment}
            if not is_there or (parts.fragment and unquote(parts.fragment) not in anchors):
                lost.append((str(path.relative_to(site)), link))
    assert lost == []


def test_pages_load_nothing_from_other_hosts(site, pages):
    for path, page in pages.items():
        assert [load for load in page.loads if urlsplit(load).netloc] == [], path
        for load in page.loads:
            if path.name != "404.html":
                assert (path.parent / unquote(urlsplit(load).path)).exists(), (path, load)
    assert not [path for path in site.rglob("*.css") if "fonts.googleapis" in path.read_text(encoding="utf-8")]


def test_the_site_names_every_task_setting_command_and_public_name(site):
    gallery = (site / "gallery.html").read_text(encoding="utf-8")
    assert [task for task in twc_env.TASKS if f"<code>{task}</code>" not in gallery] == []
    assert all(name in gallery for name in twc_env.map_names())
    commands = (site / "reference" / "commands.html").read_text(encoding="utf-8")
    assert [name for name in COMMANDS if f'id="{name}"' not in commands] == []
    reference = "".join(path.read_text(encoding="utf-8") for path in (site / "api").glob("*.html"))
    names = set(twc_env.__all__) - {"__version__"}
    assert [name for name in names if f".{name}" not in reference and f">{name}<" not in reference] == []


@pytest.mark.parametrize("name", ["parallel_env", "env", "raw_env"])
def test_the_reference_shows_the_arguments_of_what_makes_environments(site, name):
    page = (site / "api" / "index.html").read_text(encoding="utf-8")
    signature = page[page.index(f'id="twc_env.{name}"') :][:6000]
    assert all(f">{name}<" in signature for name in ("map", "robots", "max_cycles", "config", "render_mode", "task"))


def test_what_pages_and_notebooks_import_stands_in_the_reference(site, pages):
    known = set().union(*(page.anchors for path, page in pages.items() if path.parent.name == "api"))
    texts = [*(ROOT / "docs").glob("*.md"), *(ROOT / "docs").glob("*/*.md"), *(ROOT / "notebooks").glob("*.ipynb")]
    found = [
        (path.name, module, name.split(" as ")[0].strip())
        for path in texts
        for module, names in re.findall(r"from (twc_env[\w.]*) import ([\w, ]+)", path.read_text(encoding="utf-8"))
        for name in names.split(",")
    ]
    assert len(found) > 30
    lost = [each for each in found if not any(_shows(place, *each[1:]) for place in known)]
    assert lost == []


def _shows(anchor: str, module: str, name: str) -> bool:
    """Whether an anchor is that of a name, which its package may have from any of its modules, or of a module."""
    beside = re.sub(r"^twc_env\.(agents|training)", r"\1", module)
    is_module = anchor == f"{module}.{name}".replace(".", "")
    return is_module or (anchor.startswith(f"{beside}.") and anchor.endswith(f".{name}"))


def test_records_show_the_types_of_their_fields(site):
    page = (site / "api" / "records.html").read_text(encoding="utf-8")
    signature = page[page.index('id="twc_env.records.messages.SensorFrame"') :][:3000]
    assert ">ranges_m<" in signature and ">NDArray<" in signature


def test_every_page_has_one_title_so_that_its_contents_list_all_of_it(site, pages):
    wrong = {str(path.relative_to(site)): page.titles for path, page in pages.items() if page.titles != 1}
    assert {name: count for name, count in wrong.items() if name.split("/")[0] not in ("404.html", "source")} == {}


def test_links_are_called_by_the_title_of_their_page_not_by_its_file(pages):
    for path in pages:
        if "source" not in path.parts and path.name not in ("changelog.html", "search.html"):
            assert ".md</a>" not in path.read_text(encoding="utf-8"), path


def test_every_notebook_is_a_page_with_a_download(site):
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        assert (site / "notebooks" / path.name).read_bytes() == path.read_bytes()
        assert f'href="{path.name}"' in (site / "notebooks" / f"{path.stem}.html").read_text(encoding="utf-8")


def test_the_film_of_a_notebook_is_shown_on_its_page(site):
    page = (site / "notebooks" / "06-train-and-watch.html").read_text(encoding="utf-8")
    (film,) = re.findall(r'src="([^"]+\.gif)"', page)
    assert (site / "notebooks" / film).read_bytes().startswith(b"GIF8") and "IPython.core.display" not in page


def test_pictures_open_in_full_size_and_options_are_not_broken_at_their_hyphens(site):
    page = (site / "first_hours" / "lecturer.html").read_text(encoding="utf-8")
    assert re.search(r'<a href="(\S+gullible\.png)"><img [^>]*src="\1"', page)
    assert '<span class="whole">--out</span>' in page and '<span class="whole">runs/with-closures</span>' in page
    assert all('class="whole">--' in code for code in re.findall(r"<code>.*?</code>", page) if " --" in code)


def test_where_the_repository_is_known_notebooks_open_in_colab_and_install_from_it(tmp_path):
    config = tmp_path / "without_reference.yml"  # whose pages take most of the time
    places = f"INHERIT: {ROOT}/mkdocs.yml\ndocs_dir: {ROOT}/docs\nhooks: [{ROOT}/docs/site/hooks.py]\n"
    config.write_text(f"{places}plugins: []\n", encoding="utf-8")
    site = built(tmp_path / "site", "some-one/twc.env", str(config))
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        page = (site / "notebooks" / f"{path.stem}.html").read_text(encoding="utf-8")
        place = f"github/some-one/twc.env/blob/gh-pages/notebooks/{path.name}"
        assert f'href="https://colab.research.google.com/{place}"' in page
        shown, kept = (json.loads(p.read_text(encoding="utf-8")) for p in (site / "notebooks" / path.name, path))
        line = "".join(shown["cells"][1]["source"]).splitlines()[-1]
        assert re.fullmatch(r" +%pip .* 'twc_env\[[\w,]+\] @ git\+https://github.com/some-one/twc.env'", line)
        assert shown["cells"][2:] == kept["cells"][2:]
    assert 'href="https://github.com/some-one/twc.env"' in (site / "index.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_small_pictures_of_the_gallery_have_the_ground_of_the_page(address, browser, scheme):
    with screen(browser, scheme, DESKTOP) as script:
        browser.get(f"{address}/gallery.html")
        grounds = "return [...document.querySelectorAll('.gallery img')].map(i => getComputedStyle(i).backgroundColor)"
        assert set(script(grounds)) == {"rgba(0, 0, 0, 0)"}
        wide = script("return [...document.querySelectorAll('.gallery img')].map(i => i.clientWidth / i.naturalWidth)")
        assert len(wide) >= 15 and max(wide) <= 1


def test_every_page_of_docs_is_in_the_navigation(site):
    menu = Page(site / "index.html")
    home = {unquote(link.partition("#")[0]) for link in menu.links}
    missing = [
        page.relative_to(ROOT / "docs").as_posix()
        for page in (ROOT / "docs").rglob("*.md")
        if page.relative_to(ROOT / "docs").with_suffix(".html").as_posix() not in home
    ]
    assert [page for page in missing if page != "index.md"] == []


@pytest.mark.parametrize("name", ["episode.gif", "learned.gif"])
def test_films_are_small(name):
    assert (ROOT / "docs/pictures" / name).stat().st_size < FILM_MAX_BYTES


@pytest.fixture(scope="module")
def address(site):
    """Address of a server of the site."""

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(site)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


SHOWN = ("index.html", "gallery.html", "explained/twc_slam.html", "api/index.html", "api/records.html", "results.html")


@pytest.mark.parametrize("size", [PHONE, DESKTOP], ids=["phone", "desktop"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_fit_a_browser_without_errors(site, address, browser, size, scheme):
    names = [*SHOWN, *(path.relative_to(site).as_posix() for path in sorted(site.glob("notebooks/02*.html")))]
    with screen(browser, scheme, size) as script:
        for name in names:
            browser.get(f"{address}/{name}")
            inner, wide = script("return [window.innerWidth, document.documentElement.scrollWidth]")
            assert wide <= inner == size[0], f"{name} is {wide} px wide"
            colour = script("return getComputedStyle(document.body).backgroundColor")
            red, green, blue = (float(part) for part in colour.strip("rgba()").split(",")[:3])
            assert ((red + green + blue) / 3 > 128) == (scheme == "light"), colour
            broken = "return [...document.images].filter(i => i.complete && !i.naturalWidth).map(i => i.src)"
            assert script(broken) == []
            errors = [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
            assert errors == [], json.dumps(errors)
            if folder := os.environ.get("TWC_SCREENSHOTS"):
                Path(folder).mkdir(exist_ok=True)
                shot = f"{name.replace('/', '-').removesuffix('.html')}-{scheme}-{size[0]}.png"
                browser.save_screenshot(str(Path(folder) / shot))
