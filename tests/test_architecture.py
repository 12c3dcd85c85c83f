"""Import rules: packages of estimates cannot import ground truth, and users need no private names."""

import ast
import json
import re
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import twc_env

ROOT = Path(__file__).parents[1]
LEAVES = {"twc_env.errors", "twc_env.records", "twc_env.kernels", "twc_env.config", "twc_env._version"}
RANDOM = {"twc_env.records.random_streams"}
FLOORPLAN = {
    f"twc_env.world.building.{name}" for name in ("floorplan", "floorplan_file", "floorplan_check", "floor_cells")
}
SPLITS = {f"twc_env.world.building.{name}" for name in ("splits", "twins")}


def rooms(*names: str) -> set[str]:
    """Rooms of the engine by their names."""
    return {f"twc_env.slam.{name}" for name in names}


def top(*names: str) -> set[str]:
    """Rooms and modules at the top of the package by their names."""
    return {f"twc_env.{name}" for name in names}


BELOW_EPISODES = LEAVES | top("world", "slam", "metrics", "planning", "maps", "datasets", "tasks")
# What modules may import from twc_env besides their own package, by prefix of their name; the longest prefix counts.
ALLOWED = {
    "twc_env.errors": set(),
    "twc_env._version": set(),
    "twc_env.processes": {"twc_env.errors"},
    "twc_env.kernels": {"twc_env.processes.file_lock"},
    "twc_env.records": {"twc_env.errors", "twc_env.kernels"},
    "twc_env.config": {"twc_env.errors", "twc_env.records"},
    "twc_env.tasks": {"twc_env.errors", "twc_env.config"},
    "twc_env.world": LEAVES,
    "twc_env.slam": LEAVES,
    "twc_env.slam.odometry": LEAVES,
    "twc_env.slam.scans": LEAVES,
    "twc_env.slam.places": LEAVES,
    "twc_env.slam.pose_graph": LEAVES,
    "twc_env.slam.walls": LEAVES,
    "twc_env.slam.matching": LEAVES | rooms("odometry", "scans", "places", "pose_graph"),
    "twc_env.slam.radio": LEAVES | rooms("odometry", "scans", "pose_graph", "matching"),
    "twc_env.slam.front_end": LEAVES | rooms("odometry", "scans", "places", "matching"),
    "twc_env.slam.mapping": LEAVES | rooms("scans", "places", "pose_graph", "matching", "walls"),
    "twc_env.slam.merging": LEAVES | rooms("places", "pose_graph", "radio", "mapping"),
    "twc_env.slam.saved_maps": LEAVES | rooms("pose_graph"),
    "twc_env.slam.graph_optimisation": LEAVES | rooms("pose_graph"),
    "twc_env.metrics": LEAVES,
    "twc_env.planning": LEAVES,
    "twc_env.datasets": LEAVES | FLOORPLAN,
    "twc_env.maps": LEAVES | FLOORPLAN | SPLITS | {"twc_env.datasets"},
    "twc_env.exploration": BELOW_EPISODES,
    "twc_env.running": LEAVES | top("processes", "maps", "tasks"),
    "twc_env.vector": BELOW_EPISODES | top("exploration", "running", "processes"),
    "twc_env.bench": BELOW_EPISODES | top("exploration", "vector", "processes") | {"twc_env"},
    "twc_env.replaying": LEAVES | top("exploration", "slam", "datasets", "running", "bench"),
    "twc_env.pictures": BELOW_EPISODES | top("exploration", "replaying"),
    "twc_env.offline": LEAVES | top("slam", "datasets", "maps", "running", "pictures"),
    "twc_env.learned_team": BELOW_EPISODES | top("exploration", "running"),
    "twc_env.suite": BELOW_EPISODES | top("exploration", "running", "pictures") | {"twc_env"},
    "twc_env.reproduce": BELOW_EPISODES
    | top("exploration", "running", "processes", "replaying", "pictures", "offline", "suite")
    | {"twc_env"},
    "twc_env.commands": BELOW_EPISODES
    | top("exploration", "running", "processes", "replaying", "pictures", "offline", "suite")
    | top("vector", "bench", "reproduce")
    | {"twc_env"},
    "twc_env.__main__": top("running", "commands"),
    "twc_env": {"twc_env.errors", "twc_env._version", "twc_env.config"}
    | top("running", "maps", "tasks", "world", "slam", "exploration"),
}
"""`twc_env` is its `__init__` alone; a new room takes a line of its own."""
USERS = {"twc_env.agents", "twc_env.training"}
"""In a clone, they stand beside the package, as `agents` and `training`."""
PEOPLE = ("twc_env.commands", "twc_env.reproduce", "twc_env.suite", "twc_env.learned_team")
"""Modules that may import them."""
WITHOUT_RANDOM = ("twc_env.slam", "twc_env.metrics", "twc_env.planning")
COMPUTED = "<a name computed at run time>"
COMPUTING = ("twc_env", "twc_env.__main__", "twc_env.commands.train", "twc_env.reproduce.runner")
"""Modules with a table of names that they import when asked for them."""
PUBLIC_MODULES = {
    "twc_env.agents",
    "twc_env.config",
    "twc_env.datasets",
    "twc_env.errors",
    "twc_env.metrics",
    "twc_env.pictures",
    "twc_env.planning",
    "twc_env.processes",
    "twc_env.records",
    "twc_env.running",
    "twc_env.training",
    "twc_env.vector",
    "twc_env.learned_team",
}


def is_below(module: str, prefix: str) -> bool:
    return module == prefix or module.startswith(prefix + ".")


def in_clone(module: str) -> str:
    """The place of a module in a clone: `twc_env.agents` is `agents`."""
    return module.removeprefix("twc_env.") if any(is_below(module, user) for user in USERS) else module


def known_modules() -> dict[str, Path]:
    """Every module of the repository's packages, by dotted name."""
    found = {}
    for package in ("twc_env", "agents", "training"):
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = known_modules()


def is_package(module: str) -> bool:
    return module in MODULES and MODULES[module].name == "__init__.py"


def imports_of(source: str, module: str, is_package: bool = False) -> set[tuple[str, str]]:
    """All (module, name) that a source imports anywhere in the file; name is "" for `import module`."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {(alias.name, "") for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = module.split(".")
                parts = parts[: len(parts) - node.level + is_package]
                base = ".".join([*parts, base] if base else parts)
            found |= {(base, alias.name) for alias in node.names}
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("import_module", "__import__")):
            name = node.args[0] if node.args else None
            literal = isinstance(name, ast.Constant) and isinstance(name.value, str)
            found.add((name.value if literal else COMPUTED, ""))
    return found


def wrong_arrows(source: str, module: str, is_package: bool = False) -> list[str]:
    """Forbidden imports of a module of twc_env."""
    rule = max((prefix for prefix in ALLOWED if is_below(module, prefix)), key=len)
    allowed = ALLOWED[rule] | {rule}
    wrong = []
    for base, name in imports_of(source, module, is_package):
        if base == COMPUTED and module in COMPUTING:
            continue
        target = f"{base}.{name}" if name and f"{base}.{name}" in MODULES else base
        if in_clone(target) != target and any(is_below(module, people) for people in PEOPLE):
            continue
        if in_clone(f"{base}.{name}") != f"{base}.{name}":
            wrong.append(in_clone(f"{base}.{name}"))
        is_ours = is_below(target, "twc_env") or target.split(".")[0] in ("agents", "training", "tests")
        needs_seed = target in RANDOM and any(is_below(module, p) for p in WITHOUT_RANDOM)
        is_allowed = target in allowed or any(is_below(target, prefix) for prefix in allowed - {"twc_env"})
        if needs_seed or target == COMPUTED or (is_ours and not is_allowed):
            wrong.append(target)
    return sorted(wrong)


def private_uses(source: str, module: str, may_import: tuple[str, ...] = ()) -> list[str]:
    """Private names of twc_env that a user (agents, training, a notebook) imports or accesses."""
    wrong = []
    imported = imports_of(source, module)
    if (COMPUTED, "") in imported:  # a table of names: check every string that looks like a module name
        texts = {node.value for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Constant)}
        names = {text.split(":")[0] for text in texts if isinstance(text, str) and re.fullmatch(r"[\w.]+(:\w+)?", text)}
        imported = (imported - {(COMPUTED, "")}) | {(name, "") for name in names if "." in name}
    others = {f"twc_env.{user}" for user in {"agents", "training"} - set(may_import)}
    for base, name in imported:
        if any(is_below(target, other) for target in (base, f"{base}.{name}") for other in others):
            public = False
        elif base == "twc_env" and name:
            public = name in twc_env.__all__ or f"twc_env.{name}" in PUBLIC_MODULES
        elif is_below(base, "twc_env"):
            public = base == "twc_env" or any(is_below(base, p) for p in PUBLIC_MODULES)
        else:
            public = base.split(".")[0] not in {"agents", "training", "tests"} - set(may_import)
        is_private = any(part.startswith("_") and part != "__future__" for part in [*base.split("."), name])
        if not public or (is_private and is_below(base, "twc_env")):
            wrong.append(f"{base}.{name}".rstrip("."))
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Attribute):
            parts = ast.unparse(node).split(".")
            if parts[0] == "twc_env" and len(parts) >= 2:
                public = parts[1] in twc_env.__all__ or f"twc_env.{parts[1]}" in PUBLIC_MODULES | {
                    "twc_env.__version__"
                }
                if not public:
                    wrong.append(".".join(parts[:2]))
    return sorted(set(wrong))


FILES_MAX, ROOT_FILES_MAX, TEAM_LINES_MAX = 20, 10, 150


@pytest.mark.parametrize("top", ["twc_env", "agents", "training", "tests"])
def test_no_folder_has_more_than_twenty_files_or_one(top):
    folders = [ROOT / top, *(path for path in (ROOT / top).rglob("*") if path.is_dir() and path.name != "__pycache__")]
    counts = {str(folder.relative_to(ROOT)): sum(path.is_file() for path in folder.iterdir()) for folder in folders}
    assert {folder: count for folder, count in counts.items() if count > FILES_MAX} == {}
    rooms = [folder for folder in folders if any(folder.glob("*.py"))]
    assert [str(room) for room in rooms if sum(path.is_file() for path in room.iterdir()) == 1] == []


def test_a_scripted_team_is_a_file_of_at_most_150_lines():
    files = [path for path in (ROOT / "agents").glob("*/*.py") if path.parent.name != "shared"]
    counts = {str(path.relative_to(ROOT)): len(path.read_text().splitlines()) for path in files}
    assert {file: count for file, count in counts.items() if count > TEAM_LINES_MAX} == {}


def test_the_package_root_has_ten_files_at_most():
    assert sum(path.is_file() for path in (ROOT / "twc_env").iterdir()) <= ROOT_FILES_MAX


def targets_of(source: str, module: str) -> set[str]:
    """The modules and packages of ours that a module with this source imports."""
    named = {(in_clone(base), name) for base, name in imports_of(source, module, is_package(module))}
    targets = {f"{base}.{name}" if f"{base}.{name}" in MODULES else base for base, name in named}
    return (targets & set(MODULES)) - {module}


def circle_in(arrows: dict[str, set[str]]) -> list[str]:
    """Names that lead in a circle, the first one again at the end; empty if there is none."""
    try:
        TopologicalSorter(arrows).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def room_of(module: str, parent: str) -> str:
    """The room below `parent` that a module belongs to, at the top if it is empty; modules at the own level of `parent`
    are one room."""
    if not parent:
        parts = module.split(".")
        return ".".join(parts[:2]) if parts[0] == "twc_env" else parts[0]
    name = module.removeprefix(f"{parent}.").split(".")[0]
    return f"{parent}.{name}" if module != parent and is_package(f"{parent}.{name}") else parent


def arrows_between_rooms(arrows: dict[str, set[str]], parent: str) -> dict[str, set[str]]:
    """The arrows of modules below `parent` (everything if it is empty) as arrows between its rooms."""
    found: dict[str, set[str]] = {}
    for module, targets in arrows.items():
        if parent and not is_below(module, parent):
            continue
        room = room_of(module, parent)
        others = {room_of(target, parent) for target in targets if not parent or is_below(target, parent)}
        found.setdefault(room, set()).update(others - {room})
    return found


ARROWS = {module: targets_of(path.read_text(), module) for module, path in MODULES.items()}
"""Of each module, what it imports."""


def circle_of_rooms(arrows: dict[str, set[str]], parent: str) -> list[str]:
    """As `circle_in`, of rooms below `parent`."""
    return circle_in(arrows_between_rooms(arrows, parent))


def test_no_modules_or_packages_import_each_other_in_a_circle():
    assert circle_in(ARROWS) == []


def test_the_checker_finds_a_circle_through_a_package():
    late, values = "def late():\n    from twc_env.config import EnvConfig", "twc_env.config.values"
    circle = circle_in(ARROWS | {values: ARROWS[values] | targets_of(late, values)})
    assert {values, "twc_env.config"} <= set(circle)


@pytest.mark.parametrize("parent", ["", "twc_env.slam", "twc_env.world", "twc_env.exploration"])
def test_no_rooms_import_each_other_in_a_circle(parent):
    assert circle_of_rooms(ARROWS, parent) == []


@pytest.mark.parametrize(
    ("module", "imports", "parent"),
    [
        ("twc_env.kernels.packs", "from twc_env.running.terminal import Bar", ""),
        ("twc_env.running.terminal", "from twc_env.pictures.video import film_name", ""),
        ("twc_env.suite.models", "from twc_env.commands.train import SEEDS", ""),
        ("training.run_folder", "from twc_env.agents import make_policy", ""),
        ("twc_env.world.sensors.noise", "from twc_env.world.people.sight import shorten", "twc_env.world"),
        ("twc_env.world.motion.starts", "from twc_env.world.link import Link", "twc_env.world"),
        ("twc_env.exploration.drawing.frame", "from ..assessment import rewards", "twc_env.exploration"),
        ("twc_env.slam.scans.cell_kinds", "from twc_env.slam.team import Team", "twc_env.slam"),
    ],
)
def test_the_checker_finds_a_circle_between_rooms(module, imports, parent):
    circle = circle_of_rooms(ARROWS | {module: ARROWS[module] | targets_of(imports, module)}, parent)
    assert room_of(module, parent) in circle


@cache
def names_in(module: str) -> set[str]:
    """Every name that a module binds anywhere, its submodules, and the names that it may load when asked for them."""
    path = MODULES[module]
    found = {each.stem for each in path.parent.iterdir()} if path.name == "__init__.py" else set()
    nodes = list(ast.walk(ast.parse(path.read_text())))
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Name):
            found.add(node.id)
        elif isinstance(node, ast.alias):
            found.add(node.asname or node.name)
    if "__getattr__" in found:
        found |= {node.value for node in nodes if isinstance(node, ast.Constant)}
    return found


def test_what_tests_import_is_there():
    missing = []
    for path in sorted((ROOT / "tests").rglob("*.py")):
        named = imports_of(path.read_text(), ".".join(path.relative_to(ROOT).with_suffix("").parts))
        named = {
            (in_clone(base), name) for base, name in named if base.split(".")[0] in ("twc_env", "agents", "training")
        }
        for base, name in sorted(named):
            if base not in MODULES or (name not in ("", "*") and name not in names_in(base)):
                missing.append(f"{path.relative_to(ROOT)}: {base}.{name}")
    assert missing == []


@pytest.mark.parametrize("module", [name for name in MODULES if is_below(name, "twc_env")])
def test_modules_import_only_what_their_package_allows(module):
    path = MODULES[module]
    assert wrong_arrows(path.read_text(), module, path.name == "__init__.py") == []


@pytest.mark.parametrize("module", [name for name in MODULES if not is_below(name, "twc_env")])
def test_agents_and_training_use_public_names_only(module):
    own = module.split(".")[0]
    may_import = ("agents",) if own == "agents" else ("agents", "training")
    assert private_uses(MODULES[module].read_text(), module, may_import) == []


@pytest.mark.parametrize("path", sorted((ROOT / "notebooks").glob("*.ipynb")), ids=lambda path: path.name)
def test_notebooks_use_public_names_only(path):
    cells = [cell["source"] for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == "code"]
    source = "\n".join("".join(lines) for lines in cells)
    code = re.sub(r"^( *)[%!].*$", r"\1pass", source, flags=re.MULTILINE)
    recipes = set(re.findall(r"from (twc_env[\w.]+) import", (ROOT / "docs" / "library.md").read_text()))
    used = private_uses(code, path.stem, ("agents", "training"))
    assert [name for name in used if name.rpartition(".")[0] not in recipes] == []  # what recipes show is public


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("twc_env.slam.team", "import twc_env.world.world"),
        ("twc_env.slam.team", "from twc_env.world import lidar"),
        ("twc_env.slam.team", "from twc_env.records import random_streams"),
        ("twc_env.slam.team", "from ..world import lidar"),
        ("twc_env.slam.team", "from .. import world"),
        ("twc_env.slam.team", "import twc_env"),
        ("twc_env.slam.team", "def late():\n    from twc_env.exploration import environment"),
        ("twc_env.slam.team", "import importlib\nimportlib.import_module('twc_env.world')"),
        ("twc_env.slam.team", "import importlib\nimportlib.import_module('twc_env.' + 'world')"),
        ("twc_env.world.world", "from twc_env.slam import robot"),
        ("twc_env.world.world", "from twc_env.metrics import trajectory"),
        ("twc_env.metrics.mapping", "from twc_env.world.building.floorplan import Floorplan"),
        ("twc_env.records.geometry", "from twc_env import slam"),
        ("twc_env.datasets.logs.tum", "from twc_env.world import world"),
        ("twc_env.exploration.environment", "import agents"),
        ("twc_env.slam.team", "from twc_env.agents import Policy"),
        ("twc_env.bench.rates", "from twc_env.agents.policy import make_policy"),
        ("twc_env.vector.sb3", "from twc_env import training"),
        ("twc_env.vector.sb3", "from twc_env.commands import train"),
        ("twc_env.bench.rates", "from twc_env.suite import runs"),
        ("twc_env.pictures.video", "import twc_env"),
        ("twc_env.reproduce.runner", "from twc_env.commands.train import SEEDS"),
        ("twc_env.suite.models", "from twc_env.commands.train import SEEDS"),
        ("twc_env.running.terminal", "from twc_env.slam import engine"),
        ("twc_env.replaying.run", "from twc_env.pictures import style"),
        ("twc_env.offline.map_merge", "import importlib\nimportlib.import_module('twc_env.' + 'world')"),
        ("twc_env.kernels.packs", "from twc_env.running import terminal"),
        ("twc_env.new_room.file", "from twc_env.exploration import episode\nfrom twc_env.commands import train"),
        ("twc_env.maps", "def late():\n    import twc_env.training.ppo"),
    ],
)
def test_the_checker_finds_a_forbidden_import(module, source):
    assert wrong_arrows(source, module) != []


def test_the_checker_accepts_allowed_imports():
    assert (
        wrong_arrows(
            "import numpy\nfrom twc_env.records.geometry import compose\nfrom . import keyframe", "twc_env.slam.team"
        )
        == []
    )
    assert wrong_arrows("from twc_env.agents.explore import explore", "twc_env.commands.explore") == []
    assert (
        wrong_arrows("from twc_env.world import world\nimport twc_env.slam.team", "twc_env.exploration.environment")
        == []
    )


@pytest.mark.parametrize(
    "source",
    [
        "from twc_env.slam import team",
        "import twc_env.world.world",
        "import twc_env\nprint(twc_env.slam.team)",
        "from twc_env import world",
        "from twc_env.config import _number",
        "import training.ppo",
        "from twc_env.training import ppo",
        "import twc_env.training.ppo",
        "from twc_env import training",
        "import importlib\nTABLE = {'x': 'twc_env.world.world:World'}\nimportlib.import_module(TABLE['x'])",
    ],
)
def test_the_checker_finds_a_private_use(source):
    assert private_uses(source, "agents.example", ("agents",)) != []


def test_the_checker_accepts_public_uses():
    source = "import twc_env\nfrom twc_env.records.messages import Belief\nenv = twc_env.parallel_env(map='twin-01')"
    assert private_uses(source, "agents.example", ("agents",)) == []
