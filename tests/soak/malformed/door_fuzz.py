"""What else may be odd when a command begins: maps that last and are played in, teams in files, trained policies,
results that a command goes on from, tables of readings in other forms, pages of damaged runs, and --set.

Commands run in this process, and may only end well, or with one line that begins with "error"; a team's own exception
is told with its line.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import shutil
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from twc_env.agents.explore import explore, write_run

from tests.soak.attempts import Attempt, workplace
from tests.soak.malformed.array_fuzz import SMALL, _rewritten
from tests.soak.malformed.mutations import ODD_VALUES, OF_JSON, OF_TEXT, mutated
from twc_env.__main__ import main
from twc_env.bench.rates import wander
from twc_env.config import EnvConfig, override, to_dict
from twc_env.datasets.buildings.ros_map import write_ros_maps
from twc_env.datasets.lasting_maps import save_map
from twc_env.datasets.logs.readings_table import Span, read_signs, read_wifi
from twc_env.errors import DataError
from twc_env.exploration.environment import ExplorationEnv
from twc_env.pictures.replay_page import write_page
from twc_env.records.random_streams import random_stream

Random = np.random.Generator
QUICK = ("explore", "--robots", "1", "--steps", "2", "--no-pictures", "--set", "lidar.beam_count=36")
ACTS = (
    "return None", "return {}", "return 5", "return [ZEROS]", "return {'robot_9': ZEROS}", "return {0: ZEROS}",
    "return {a: np.zeros(3) for a in beliefs}", "return {a: np.zeros((2, 1)) for a in beliefs}",
    "return {a: 'x' for a in beliefs}", "return {a: None for a in beliefs}", "return {a: [1, 'x'] for a in beliefs}",
    "return {a: np.full(2, np.nan) for a in beliefs}", "return {a: [1e300, 0] for a in beliefs}",
    "return {a: ZEROS + 1j for a in beliefs}", "return {a: {} for a in beliefs}", "return {a: [[]] for a in beliefs}",
    "beliefs.clear(); return {}", "beliefs['robot_0'] = None; return {}", "raise ValueError('two\\nlines')",
    "raise RuntimeError", "1 / 0", "return self.act(beliefs)", "yield 1", "assert False", "import none_such",
    "return {a: ZEROS for a in beliefs}", "class Odd(Exception):\n   __str__ = None\n  raise Odd",
    "raise StopIteration",
    "return {a: np.ma.masked_array([1.0, 1.0], [1, 0]) for a in beliefs}", "return {a: b'xx' for a in beliefs}",
    "return {a: ZEROS for a in [*beliefs, *beliefs, 'x']}", "raise MemoryError", "raise OSError(28, 'No space')",
    "raise BrokenPipeError", "raise SystemError", "return {a: (v for v in ZEROS) for a in beliefs}",
)  # fmt: skip
TEAMS = (
    "class T(Policy):\n def act(self, beliefs):\n  {act}\n",
    "class T(Policy):\n def __init__(self):\n  pass\n def act(self, beliefs):\n  {act}\n",
    "class T(Policy):\n def act(self):\n  {act}\n",
    "class T(Policy):\n def reset(self, seed, agents):\n  beliefs = {{a: 0 for a in agents}}\n  {act}\n"
    " def act(self, beliefs):\n  return {{a: ZEROS for a in beliefs}}\n",
    "class T(Policy):\n def finished(self, beliefs):\n  {act}\n def act(self, beliefs):\n"
    "  return {{a: ZEROS for a in beliefs}}\n",
    "class T(Policy):\n def finished(self, beliefs):\n  return np.ones(2)\n def act(self, beliefs):\n  {act}\n",
    "class T:\n def act(self, beliefs):\n  {act}\n",
    "def T(config):\n {act}\n",
    "class T(Policy):\n async def act(self, beliefs):\n  {act}\n",
    "T = 5\n", "", "class T(Policy)\n", "\tclass T: pass\n x", "raise ValueError('at import')\n",
    "class T(Policy):\n pass\n", "import none_such\n", "class T(Policy):\n act = reset = finished = None\n",
    "# \udcff\n",
    "class Meta(type):\n def __call__(cls, *_):\n  raise KeyError('x')\nclass T(Policy, metaclass=Meta):\n"
    " def act(self, beliefs):\n  {act}\n",
)  # fmt: skip
HEAD = "import numpy as np\nfrom twc_env.agents import Policy\nZEROS = np.zeros(2, np.float32)\n"
WIFI = (
    "t;MAC;level\n{0:.0f},0;aa:bb:cc:dd:ee:02;-60,0\n{1:.0f},5;aa:bb:cc:dd:ee:01;-50,0\n",
    "time,mac,aa:bb:cc:dd:ee:01,aa:bb:cc:dd:ee:02,note\n{0},x,-50,-60,y\n{1},x,,-61,y\n",
    "# survey of {0}\n%time bssid rssi\n{0} AA-BB-CC-DD-EE-01 -50dBm\n{1} aabb.ccdd.ee02 -60dBm\n",
    "date|ap|signal [dBm]|robot\n14.11.2023 22:13:21|a|-50|0\n14.11.2023 10:13:22 PM|b|-60|0\n",
)
SIGNS = (
    "time,text,bearing,range\n{0},A 101,-45 deg,2.5 m\n{1},\"Room 5, west\",10 deg,3 m\n",
    "timestamp_ms;label;angle [deg];distance (mm)\n{0}000;A;0,5;900\n{1}000;\"B\";-90,0;1500\n",
)  # fmt: skip
BEGUN_S = 1_700_000_000.0
Door = Callable[[Path, Random], tuple[str, Callable]]


def odd_doors(count: int, seed: int = 0) -> Iterator[Attempt]:
    """`count` attempts at all doors in turn; equal seeds give the same."""
    random = random_stream(seed, "door-fuzz")
    with workplace() as folder:
        _prepare(folder)
        doors = [door for door in DOORS if door is not _policy or (find_spec("torch") and find_spec("safetensors"))]
        for number, door in zip(range(count), itertools.cycle(doors), strict=False):
            what, work = door(folder, random)
            yield f"#{number} {door.__name__.strip('_')}: {what}", work


def _prepare(folder: Path) -> None:
    """Sound samples; what compiles does so here."""
    config = override(EnvConfig(), SMALL)
    env = ExplorationEnv(config=config)
    env.reset(seed=0)
    for actions in wander(env, 0):
        env.step(actions)
    save_map(folder / "prior.npz", env.engine)
    write_ros_maps(env.result().grids, folder)
    write_run(explore(override(config, {"max_cycles": 5}), "random", 0), folder / "run", pictures=False)
    _command(*QUICK, "--out", str(folder / "quick"), "--prior", str(folder / "prior.npz"))
    _compared(folder)
    shutil.copytree(folder / "parts", folder / "sound-parts")
    write_page(folder / "run", folder / "page.html")
    if find_spec("torch"):
        from twc_env.training.shipped import shipped

        shutil.copytree(shipped("twc/ExploreQuick-v1"), folder / "policy")


def _command(*words: str) -> None:
    """Run a command. Raises DataError with its line if it refuses, AssertionError for anything else but success."""
    told, printed = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stderr(told), contextlib.redirect_stdout(printed):
            status = main(list(words))
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 1
    lines = told.getvalue().strip().splitlines()
    assert "Traceback" not in told.getvalue(), f"a traceback: {told.getvalue()[-300:]}"
    if status == 1 and any(line.startswith("error in your code") for line in lines):
        return
    errors = [k for k, line in enumerate(lines) if "error: " in line]
    if status == 2:
        assert errors and errors[-1] == len(lines) - 1, f"not one line: {lines[-4:]}"
        raise DataError(lines[-1].partition("error: ")[2])
    assert status == 0, f"status {status}: {lines[-3:]}"


def _prior(folder: Path, random: Random) -> tuple[str, Callable]:
    """Episodes in a map that lasts, or in one of ROS."""
    if random.random() < 0.7:
        path = folder / "odd-prior.npz"
        what = _rewritten(folder / "prior.npz", random)
    else:
        raw, what = mutated((folder / "map.yaml").read_bytes(), random, OF_TEXT)
        path = folder / "odd.yaml"
        path.write_bytes(raw)
    return f"{path.name}: {what}", partial(_play, override(EnvConfig(), {**SMALL, "slam.prior": str(path)}))


def _play(config: EnvConfig) -> None:
    env = ExplorationEnv(config=override(config, {"max_cycles": 12}))
    env.reset(seed=1)
    for actions in wander(env, 1):
        env.step(actions)
    if config.slam.prior.endswith(".npz"):
        save_map(Path(config.slam.prior).with_name("later.npz"), env.engine)
    env.close()


def _save(folder: Path, random: Random) -> tuple[str, Callable]:
    """Odd places for a map, and odd files to begin with."""
    (folder / "file").write_text("x")
    names = (
        ".", "..", "none/such/place.npz", "file/a.npz", "x" * 300, "x" * 300 + "/a.npz", "/dev/full", "a", "a.yaml",
        "run", "\u00e9\u2028.npz", "-", "~/a.npz", "/dev/null", "file", "run/report.json", "quick/config.json",
    )  # fmt: skip
    name, option = names[int(random.integers(len(names)))], ("--save", "--prior", "--out", "--config", "--json")
    option = option[int(random.integers(len(option)))]
    place = name if name.startswith(("/", "-", "~")) else str(folder / "odd" / ".." / name)
    (folder / "odd").mkdir(exist_ok=True)
    words = (*QUICK, *(("--out", str(folder / "quick")) if option != "--out" else ()), f"{option}={place}")
    return f"{option} {name:.40}", partial(_command_at, folder, *words)


def _command_at(folder: Path, *words: str) -> None:
    with contextlib.chdir(folder):
        _command(*words)


_numbers = itertools.count()


def _team(folder: Path, random: Random) -> tuple[str, Callable]:
    """Teams in files that raise, or return what no team should."""
    act = ACTS[int(random.integers(len(ACTS)))]
    code = TEAMS[int(random.integers(len(TEAMS)))].format(act=act)
    if random.random() < 0.2:
        code = mutated(code.encode(errors="surrogateescape"), random)[0].decode(errors="surrogateescape")
    place = folder / f"team{next(_numbers)}"  # a file is loaded once
    place.mkdir()
    (place / "mine.py").write_bytes((HEAD + code).encode(errors="surrogateescape"))
    name = ("mine.py:T", "mine.py:T", "mine.py:T", "mine.py:", "mine.py", "mine.py:Other", "mine.py:np")
    team = f"{place}/{name[int(random.integers(len(name)))]}"
    return f"{code!r:.150}", partial(_command, *QUICK, "--out", str(folder / "quick"), "--agent", team)


def _policy(folder: Path, random: Random) -> tuple[str, Callable]:
    """Folders of trained policies."""
    place = folder / "odd-policy"
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(folder / "policy", place)
    if random.random() < 0.8:
        path = place / "config.json"
        raw, what = mutated(path.read_bytes(), random, OF_JSON)
        path.write_bytes(raw)
    else:
        path = place / "model.safetensors"
        what = _rewritten(path, random)
        (place / "odd-model.safetensors").replace(path)
    return f"{path.name}: {what}", partial(_choose, str(place))


def _choose(place: str) -> None:
    from twc_env.suite.entries import entries
    from twc_env.suite.models import model_in_task
    from twc_env.suite.player import digest_of_team

    (entry,) = entries(["twc/ExploreQuick-v1"], [place], "validation", 1)
    digest_of_team(entry)
    env, choose = model_in_task(entry)
    observations, _ = env.reset(seed=0)
    env.step(choose(observations))
    env.close()


def _compared(folder: Path) -> None:
    words = ("compare", "--agents", "random", "--maps", "twin-01", "--robots", "1", "--steps", "3", "--no-pictures")
    _command(*words, "--out", str(folder / "parts"), "--json", str(folder / "rows.json"))


def _resume(folder: Path, random: Random) -> tuple[str, Callable]:
    """A comparison that goes on from damaged parts has the same rows."""
    shutil.rmtree(folder / "parts", ignore_errors=True)
    shutil.copytree(folder / "sound-parts", folder / "parts")
    paths = sorted(path for path in (folder / "parts").rglob("*.json"))
    path = paths[int(random.integers(len(paths)))]
    raw, what = mutated(path.read_bytes(), random, OF_JSON)
    path.write_bytes(raw)
    wanted = json.loads((folder / "rows.json").read_text())

    def work() -> None:
        _compared(folder)
        assert json.loads((folder / "rows.json").read_text()) == wanted, "other rows"

    return f"{path.name}: {what}", work


def _page(folder: Path, random: Random) -> tuple[str, Callable]:
    """The page of a damaged run."""
    place = folder / "odd-run"
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(folder / "run", place)
    if random.random() < 0.5:
        raw, what = mutated((place / "report.json").read_bytes(), random, OF_JSON)
        (place / "report.json").write_bytes(raw)
    else:
        what = _rewritten(place / "trace.npz", random)
        (place / "odd-trace.npz").replace(place / "trace.npz")
    return what, partial(write_page, place, folder / "page.html")


def _table(folder: Path, random: Random) -> tuple[str, Callable]:
    """Tables of readings in other forms."""
    texts, read = (WIFI, read_wifi) if random.random() < 0.5 else (SIGNS, read_signs)
    sound = texts[int(random.integers(len(texts)))].format(BEGUN_S, BEGUN_S + 1)
    raw, what = mutated(sound.encode(), random, OF_TEXT)
    path = folder / "odd.csv"
    path.write_bytes(raw)
    robots = ((("",), ("", ""), ("1", "2"), ("north", "south"))[int(random.integers(4))]) if "robot" in sound else ("",)
    return f"{what}: {raw!r:.120}", partial(read, path, Span(BEGUN_S, BEGUN_S + 100.0, robots))


def _set(folder: Path, random: Random) -> tuple[str, Callable]:
    """One setting by --set, of any name and value."""
    names = [*_names(to_dict(EnvConfig())), "", "x", "slam", "slam.", ".", "lidar.beam_count.x", "robots=", "map"]
    name = names[int(random.integers(len(names)))]
    values = (
        *map(str, ODD_VALUES),
        "1",
        "0.5",
        "[1, 2]",
        '{"a": 1}',
        "train",
        "gen:x",
        "true",
        "FILE.py:CLASS",
        "=",
        "'",
    )
    value = values[int(random.integers(len(values)))].replace("\x00", "\\0")
    words = (*QUICK, "--out", str(folder / "quick"), f"--set={name}={value}")
    return f"{name}={value:.40}", partial(_command, *words)


def _names(values: dict, prefix: str = "") -> Iterator[str]:
    for key, value in values.items():
        yield from _names(value, f"{prefix}{key}.") if isinstance(value, dict) else (f"{prefix}{key}",)


DOORS: tuple[Door, ...] = (_team, _set, _table, _prior, _resume, _page, _table, _policy, _save, _set, _team, _table)
