"""What mkdocs does beside turning pages into HTML: pages from outside docs/, and tables made from the code.

- Pages that stand elsewhere for other reasons (CHANGELOG.md, maps/README.md, notebooks) become part of the site, and
  links from page to page, which are written for a reader of the repository, lead to them. A link to a source file leads
  to a page that shows it.
- A line `<!-- made: NAME -->` is replaced by what the function `made_NAME` says, so no table of tasks can be out of
  date, and `<!-- file: PATH -->` by the file.
- Parts of the navigation that do not exist yet are left out.
- Where GITHUB_REPOSITORY is OWNER/NAME, as in GitHub Actions, there are links to the repository and, for notebooks, to
  Colab. Colab opens the notebooks of the site, published as the branch gh-pages, which install twc_env from there.
"""

from __future__ import annotations

import ast
import base64
import json
import os
import posixpath
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
BESIDE = {
    "CHANGELOG.md": "project/changelog.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "SECURITY.md": "project/security.md",
    "maps/README.md": "project/maps.md",
}
"""Pages outside docs/ -> where they stand in the site."""
WORD_MAX = 30
"""Letters of a word with hyphens in code that is kept on one line: a phone has room for it."""
SAME = {"README.md": "docs/index.md"}
"""A link to the first leads to the second."""
PACKAGES = {
    "twc_env.config": "settings: reading, writing, digests. In signatures, `number(default, least, most)` is a number "
    "with its range, `choice(default, others)` one of some names. [Settings](../reference/settings.md) explains each",
    "twc_env.errors": "what can be raised",
    "twc_env.records": "messages, frames, poses: what crosses borders",
    "twc_env.vector": "many environments at once",
    "twc_env.planning": "path planning on estimated maps",
    "twc_env.metrics": "plain arrays in, numbers out",
    "twc_env.datasets": "readers and writers of maps, logs and surveys",
    "twc_env.pictures": "films and pages",
    "twc_env.running": "what commands share",
    "twc_env.agents": "scripted teams: `Policy` to derive your own from, `explore` to play an episode",
    "twc_env.training": "learning: what `twc-env train` runs, and how a trained policy is played",
}
"""Public packages, each with a page of its own."""
FIRST = (
    "twc_env.config.environment", "twc_env.config.values", "twc_env.records.messages", "twc_env.records.team_messages",
    "twc_env.records.scanner", "twc_env.records.geometry", "agents.policy", "agents.explore", "agents.roster",
    "training.ppo", "training.mappo", "training.evolution", "training.trained_policy",
    "twc_env.pictures.style", "twc_env.pictures.video", "twc_env.datasets.logs.frame_log",
    "twc_env.datasets.logs.scan_log", "twc_env.datasets.logs.carmen_log",
)  # fmt: skip
"""Modules that stand at the top of their page."""
PARTS = (
    "world.world", "world.building.floorplan", "world.building.floorplan_file", "slam.matching.scan_matching",
    "slam.matching.global_matching", "slam.pose_graph.robust_back_end", "slam.graph_optimisation.whole_graph",
    "slam.radio.radio_slam", "slam.radio.radio_map", "slam.walls.k_visibility", "slam.saved_maps.saved_map",
    "slam.saved_maps.placement", "suite.evaluation", "reproduce.walls.sfw_flats",
)  # fmt: skip
"""Modules that recipes and notebooks use alone: they are one page."""
OUTSIDE = {"twc_env.agents": "agents", "twc_env.training": "training"}
"""Packages that stand beside twc_env in a clone."""


def _repository() -> str:
    """OWNER/NAME on GitHub; empty if it is not known."""
    named = os.environ.get("GITHUB_REPOSITORY", "")
    if named and not re.fullmatch(r"[\w.-]+/[\w.-]+", named):
        from mkdocs.exceptions import PluginError

        raise PluginError(f"GITHUB_REPOSITORY must be OWNER/NAME, or not be set; it is {named!r}")
    return named


def on_config(config: Any) -> Any:
    """Anchors as on code hosting sites, since the same pages are read there; a link to the repository in the footer."""
    from pymdownx.slugs import slugify

    if repository := _repository():
        config["copyright"] += f' · <a href="https://github.com/{repository}">{repository} on GitHub</a>'
    os.chdir(ROOT)  # mkdocstrings reads the sources from here
    config["mdx_configs"].setdefault("toc", {})["slugify"] = slugify(case="lower")
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that are made, and leave out what the navigation names in vain."""
    made = {inside: (ROOT / outside).read_text(encoding="utf-8") for outside, inside in BESIDE.items()}
    made |= {f"api/{name.partition('.')[2]}.md": _package_page(name, text) for name, text in PACKAGES.items()}
    made |= {"api/parts.md": _parts_page(), "reference/settings.md": _settings()}
    for path, content in {**made, **_notebooks(), **_sources(config)}.items():
        _add(files, config, path, content)
    known = {file.src_uri for file in files}
    config["nav"] = _existing(config["nav"], known)
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Put in what is made, and lead links to where pages stand in the site."""
    markdown = re.sub(r"^<!-- made: (\w+) -->$", lambda m: globals()[f"made_{m[1]}"](), markdown, flags=re.MULTILINE)
    markdown = re.sub(r"^<!-- file: (\S+) -->$", lambda m: _fenced(ROOT / m[1]), markdown, flags=re.MULTILINE)
    uri = page.file.src_uri
    if uri == "index.md":
        page.meta["hide"] = ["navigation", "toc"]
    home = _place_in_repository(uri)
    parts = re.split(r"(^````.*?^````|^```.*?^```|`[^`\n]+`)", markdown, flags=re.DOTALL | re.MULTILINE)
    parts[::2] = [_with_links(part, uri, home) for part in parts[::2]]
    return "".join(parts)


def on_page_content(html: str, page: Any, config: Any, files: Any) -> str:
    """Keep options such as `--out` on one line, and let a picture be opened in its full size by a click."""
    html = re.sub(r"<code>.*?</code>", lambda m: _with_whole_words(m[0]), html, flags=re.DOTALL)
    return re.sub(r'(?<!">)<img [^>]*src="([^":]+)"[^>]*>', r'<a href="\1">\g<0></a>', html)


def _with_whole_words(code: str) -> str:
    """Short words with hyphens, at which browsers break lines, in spans that are not broken; a name alone stays."""
    if not re.search(r"\s", re.sub(r"<[^>]*>", "", code)):
        return code
    texts = re.split(r"(<[^>]*>)", code)
    words = rf"(?<!\S)(?=\S{{1,{WORD_MAX}}}(?!\S))\S*-\S*"
    texts[::2] = [re.sub(words, r'<span class="whole">\g<0></span>', text) for text in texts[::2]]
    return "".join(texts)


def made_tasks_v0() -> str:
    """Table of the tasks v0."""
    return _tasks("-v0")


def made_tasks_v1() -> str:
    """Table of the tasks v1."""
    return _tasks("-v1")


def _tasks(ending: str) -> str:
    from twc_env.tasks import PURPOSES, TASKS

    rows = ["| id | what it is for | settings that differ from the defaults |", "|---|---|---|"]
    for task, settings in TASKS.items():
        if task.endswith(ending):
            shown = "<br>".join(f"`{key} = {_toml(value)}`" for key, value in settings.items())
            rows.append(f"| `{task}` | {PURPOSES[task]} | {shown or 'none'} |")
    return "\n".join(rows)


def _toml(value: object) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value).lower()


def made_maps() -> str:
    """Table of the bundled maps."""
    from twc_env import load_map, map_names

    rows = ["| map | size | signs | access points |", "|---|---|---|---|"]
    for name in map_names():
        plan = load_map(name)
        x0, y0, x1, y1 = plan.bounds_m
        rows.append(f"| `{name}` | {x1 - x0:.0f} x {y1 - y0:.0f} m | {len(plan.signs)} | {len(plan.access_points)} |")
    return "\n".join(rows)


def _add(files: Any, config: Any, path: str, content: str | bytes) -> None:
    from mkdocs.structure.files import File

    if files.get_file_from_path(path) is None:
        files.append(File.generated(config, path, content=content))


def _existing(nav: list, known: set[str]) -> list:
    """The navigation without pages that do not exist; a folder, `NAME/`, stands for its pages."""
    kept: list = []
    for item in nav:
        title, target = next(iter(item.items())) if isinstance(item, dict) else (None, item)
        if isinstance(target, list):
            if below := _existing(target, known):
                kept.append({title: below})
        elif target.endswith("/"):
            pages = sorted(uri for uri in known if re.fullmatch(rf"{target}(?!index)\w[^/]*\.md", uri))
            kept += [{title: pages}] if title else pages
        elif target in known:
            kept.append(item)
    return kept


def _place_in_repository(uri: str) -> str:
    """Where the source of a page of the site stands, from the top of the repository."""
    for outside, inside in BESIDE.items():
        if uri == inside:
            return outside
    return uri.replace(".md", ".ipynb") if uri.startswith("notebooks/") else f"docs/{uri}"


def _place_in_site(path: str) -> str | None:
    """Where the site shows a file of the repository; None if it does not exist."""
    path = SAME.get(path, path)
    if path in BESIDE:
        return BESIDE[path]
    if path.startswith("docs/") and not path.endswith(".py"):
        return path.removeprefix("docs/")
    if path.startswith("notebooks/") and path.endswith(".ipynb"):
        return path.replace(".ipynb", ".md")
    return f"source/{path}.md".replace("/.", "/") if (ROOT / path).exists() else None  # mkdocs leaves out .folders


def _targets(text: str) -> list[tuple[str, str]]:
    return re.findall(r"(\]\()([^)\s]+)(?=\))", text)


def _with_links(text: str, uri: str, home: str) -> str:
    def lead(match: re.Match[str]) -> str:
        target, _, heading = match[2].partition("#")
        if not target or "://" in target or target.startswith("mailto:"):
            return match[0]
        path = posixpath.normpath(posixpath.join(posixpath.dirname(home), target))
        place = _place_in_site(path)
        if place is None:
            return match[0]  # mkdocs says that it leads nowhere
        there = posixpath.relpath(place, posixpath.dirname(uri) or ".")
        before = match[1] if match[1] == "](" else f"[{_title(ROOT / path)}]("
        return f"{before}{there}{'#' + heading if heading else ''}"

    return re.sub(r"(\[[\w./-]+\.md\]\(|\]\()([^)\s]+)(?=\))", lead, text)


def _title(file: Path) -> str:
    """The heading of a page, which says more to a reader of the site than the name of a file."""
    return re.search(r"^# (.+)$", file.read_text(encoding="utf-8"), re.MULTILINE)[1]  # type: ignore[index]


def _sources(config: Any) -> dict[str, str]:
    """Pages that show the source files and folders that pages name."""
    pages = [*Path(config["docs_dir"]).rglob("*.md"), *(ROOT / outside for outside in BESIDE)]
    shown = {}
    for page in pages:
        home = page.relative_to(ROOT).as_posix()
        for _, target in _targets(page.read_text(encoding="utf-8")):
            path = posixpath.normpath(posixpath.join(posixpath.dirname(home), target.partition("#")[0]))
            place = None if "://" in target else _place_in_site(path)
            if place and place.startswith("source/"):
                shown[place] = _source_page(path)
    return shown


def _source_page(path: str) -> str:
    file = ROOT / path
    if file.is_dir():
        lines = [f"- `{p.relative_to(file).as_posix()}`: {_first_line(p)}" for p in sorted(file.rglob("*.py"))]
        return f"# {path}\n\n" + "\n".join(line for line in lines if not line.endswith(": ")) + "\n"
    return f"# {path}\n\n{_fenced(file)}\n"


def _fenced(file: Path) -> str:
    """The text of a file as a code block."""
    kind = {".py": "python", ".json": "json", ".toml": "toml", ".yml": "yaml"}.get(file.suffix, "text")
    return f"````{kind}\n{file.read_text(encoding='utf-8').rstrip()}\n````"


def _first_line(file: Path) -> str:
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return text.splitlines()[0] if text else ""


def _package_page(name: str, text: str) -> str:
    """The reference of a public package: of modules from which it exports names these, and all other modules."""
    inside = OUTSIDE.get(name, name)
    home = ROOT / inside.replace(".", "/")
    if home.with_suffix(".py").exists():
        return f"# {name}\n\n{text[0].upper()}{text[1:]}.\n\n{_module(name, name)}"
    exported = _exported(home / "__init__.py")
    files = (file.relative_to(ROOT).with_suffix("") for file in sorted(home.rglob("*.py")) if _is_worth_showing(file))
    others = (".".join(path.parts) for path in files if path.name != "__init__")
    modules = sorted([*exported, *(module for module in others if module not in exported)], key=_rank)
    shown = (_module(module, name + module.removeprefix(inside), exported.get(module)) for module in modules)
    return "\n".join([f"# {name}", "", f"{text[0].upper()}{text[1:]}.", "", *shown])


def _rank(module: str) -> int:
    return FIRST.index(module) if module in FIRST else len(FIRST)


def _parts_page() -> str:
    """The reference of parts that are used alone."""
    lead = (
        "Parts of the world, the engine and the tables that [recipes](../library.md) and notebooks use by themselves."
    )
    modules = [_module(f"twc_env.{part}", f"twc_env.{part}") for part in PARTS]
    return "\n".join(["# twc_env.world, slam, reproduce", "", lead, "", *modules])


def _exported(init: Path) -> dict[str, list[str]]:
    """The modules from which a package takes its public names, with these."""
    found: dict[str, list[str]] = {}
    for node in ast.walk(ast.parse(init.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module != "__future__":
            package = ".".join(init.parent.relative_to(ROOT).parts)
            module = f"{package}.{node.module}" if node.level else node.module
            if module.startswith(f"{package}."):
                found.setdefault(module, []).extend(alias.name for alias in node.names)
    return found


def _module(module: str, shown: str, names: list[str] | None = None) -> str:
    """The reference of a module under a heading: these names, or all that is public but for constants."""
    which = f"members: {json.dumps(names)}" if names else 'filters: ["!^_", "!^[A-Z][A-Z0-9_]*$"]'
    options = ["show_root_heading: false", "show_root_toc_entry: false", "heading_level: 3", which]
    return "\n".join([f"## {shown}", "", f"::: {module}", "    options:", *(f"      {o}" for o in options), ""])


def _is_worth_showing(file: Path) -> bool:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    kinds = (ast.FunctionDef, ast.ClassDef)
    return any(isinstance(node, kinds) and not node.name.startswith("_") for node in tree.body)


def _settings() -> str:
    from twc_env.config import EnvConfig
    from twc_env.config.manual import as_toml

    text = "Every setting with its meaning, default and range, as `twc-env settings` prints it."
    return f"# Settings\n\n{text}\n\n```toml\n{as_toml(EnvConfig(), [])}```\n"


def made_commands() -> str:
    """The help of every command."""
    from twc_env.__main__ import COMMANDS, _parser

    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = "90"
    try:
        parser = _parser()
        choices: dict[str, Any] = parser._subparsers._group_actions[0].choices  # type: ignore[union-attr, assignment]
        helps = {name: choices[name].format_help() for name in COMMANDS}
    finally:
        del os.environ["COLUMNS"]
        if before is not None:
            os.environ["COLUMNS"] = before
    parts = [f"## {name}\n\n```text\n{text}```\n" for name, text in helps.items()]
    return "\n".join(parts)


def _notebooks() -> dict[str, str | bytes]:
    """Every notebook as a page, with the outputs that it stores, and the notebook itself to download and for Colab."""
    made: dict[str, str | bytes] = {}
    repository = _repository()
    source = f"\\1 @ git+https://github.com/{repository}'".encode() if repository else rb"\1'"
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        made[f"notebooks/{path.name}"] = re.sub(rb"('twc_env\[[\w,]+\])'", source, path.read_bytes())
        parts = []
        for number, cell in enumerate(json.loads(path.read_text(encoding="utf-8"))["cells"]):
            text = "".join(cell["source"])
            parts.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
            for output in cell.get("outputs", []):
                parts.append(_shown(output, f"notebooks/{path.stem}-{number}", made))
        title = f'\n<a href="{path.name}" download>Download this notebook</a> for Jupyter.\n'
        if repository:
            place = f"https://colab.research.google.com/github/{repository}/blob/gh-pages/notebooks/{path.name}"
            title = f'\n<a href="{place}">Open in Colab</a>, or {title[1:].replace("Download", "download")}'
        parts[0] = parts[0].replace("\n", f"\n{title}\n", 1) if "\n" in parts[0] else parts[0] + "\n" + title
        made[f"notebooks/{path.stem}.md"] = "\n\n".join(parts) + "\n"
    return made


def _shown(output: dict, name: str, made: dict[str, str | bytes]) -> str:
    """The text of an output of a cell; a picture becomes a file of its own."""
    data = output.get("data", {})
    for kind in ("png", "gif"):
        if picture := data.get(f"image/{kind}"):
            place = f"{name}-{sum(key.startswith(name + '-') for key in made)}.{kind}"
            made[place] = base64.b64decode(picture)
            return f"![Output of the cell above]({posixpath.basename(place)})"
    if "text/html" in data:
        return "".join(data["text/html"])
    text = "".join(output.get("text", data.get("text/plain", ""))).rstrip()
    return f"```text\n{text}\n```" if text else ""
