"""Import rules: packages of estimates cannot import ground truth, and users need no private names."""

import ast
import json
import re
from functools import cache
from graphlib import TopologicalSorter
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


# What modules may import from twc_env besides their own package, by prefix of their name; the longest prefix counts.
ALLOWED = {
    "twc_env.errors": set(),
    "twc_env._version": set(),
    "twc_env.kernels": {"twc_env.running.file_lock"},
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
    "twc_env.exploration": LEAVES
    | {"twc_env.world", "twc_env.slam", "twc_env.metrics", "twc_env.planning", "twc_env.maps", "twc_env.datasets"}
    | {"twc_env.tasks", "twc_env.running.threads", "twc_env.running.file_lock"},
    "twc_env": {"twc_env"},  # the top: commands, bench, vector, pictures, reproduce
}
USERS = {"twc_env.agents", "twc_env.training"}
"""In a clone, they stand beside the package, as `agents` and `training`."""
PEOPLE = ("twc_env.commands", "twc_env.reproduce", "twc_env.suite")
"""Modules that may import them."""
WITHOUT_RANDOM = ("twc_env.slam", "twc_env.metrics", "twc_env.planning")
COMPUTED = "<a name computed at run time>"
PUBLIC_MODULES = {
    "twc_env.agents",
    "twc_env.config",
    "twc_env.datasets",
    "twc_env.errors",
    "twc_env.metrics",
    "twc_env.pictures",
    "twc_env.planning",
    "twc_env.records",
    "twc_env.running",
    "twc_env.training",
    "twc_env.vector",
    "twc_env.suite.learned",
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
    own = set() if rule == "twc_env" else {rule}
    wrong = []
    for base, name in imports_of(source, module, is_package):
        if base == COMPUTED and rule == "twc_env":
            continue  # the lazy names of __init__
        target = f"{base}.{name}" if name and f"{base}.{name}" in MODULES else base
        if in_clone(target) != target and any(is_below(module, people) for people in PEOPLE):
            continue
        if in_clone(f"{base}.{name}") != f"{base}.{name}":
            wrong.append(in_clone(f"{base}.{name}"))
        is_ours = is_below(target, "twc_env") or target.split(".")[0] in ("agents", "training", "tests")
        needs_seed = target in RANDOM and any(is_below(module, p) for p in WITHOUT_RANDOM)
        if needs_seed or target == COMPUTED or (is_ours and not any(is_below(target, p) for p in ALLOWED[rule] | own)):
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


FILES_MAX, ROOT_FILES_MAX = 20, 10


@pytest.mark.parametrize("top", ["twc_env", "agents", "training", "tests"])
def test_no_folder_has_more_than_twenty_files(top):
    folders = [ROOT / top, *(path for path in (ROOT / top).rglob("*") if path.is_dir() and path.name != "__pycache__")]
    counts = {str(folder.relative_to(ROOT)): sum(path.is_file() for path in folder.iterdir()) for folder in folders}
    assert {folder: count for folder, count in counts.items() if count > FILES_MAX} == {}


def test_the_package_root_has_ten_files_at_most():
    assert sum(path.is_file() for path in (ROOT / "twc_env").iterdir()) <= ROOT_FILES_MAX


def test_no_modules_import_each_other_in_a_circle():
    packages = {name for name, path in MODULES.items() if path.name == "__init__.py"}
    arrows = {}
    for module, path in MODULES.items():
        named = imports_of(path.read_text(), module, module in packages)
        named = {(in_clone(base), name) for base, name in named}
        targets = {f"{base}.{name}" if f"{base}.{name}" in MODULES else base for base, name in named}
        arrows[module] = (targets & set(MODULES)) - packages - {module}
    TopologicalSorter(arrows).prepare()  # raises CycleError, which names the circle


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
