"""What else may be odd when a command begins: teams in files, tables of readings in other forms, finished parts that it
goes on from. A team's own exception is told with its line."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from twc_env.agents.policy import make_policy

from tests.soak.attempts import Attempt, workplace
from tests.soak.malformed.mutations import OF_JSON, OF_TEXT, mutated
from twc_env.datasets.logs.column_units import Span
from twc_env.datasets.logs.readings_table import read_signs, read_wifi
from twc_env.errors import TwcError
from twc_env.records.random_streams import random_stream
from twc_env.running.finished_parts import FinishedParts
from twc_env.running.user_code import told_of_user_code

Random = np.random.Generator
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
RESULT = {"coverage": [0.1, 0.25, 0.5], "merged_s": None, "ate_m": 0.0123, "steps": 3}
Door = Callable[[Path, Random], tuple[str, Callable]]


def odd_doors(count: int, seed: int = 0) -> Iterator[Attempt]:
    """`count` attempts at all doors in turn; equal seeds give the same."""
    random = random_stream(seed, "door-fuzz")
    with workplace() as folder:
        for number, door in zip(range(count), itertools.cycle(DOORS), strict=False):
            what, work = door(folder, random)
            yield f"#{number} {door.__name__.strip('_')}: {what}", work


_numbers = itertools.count()


def _team(folder: Path, random: Random) -> tuple[str, Callable]:
    """Teams in files that cannot be made, or called."""
    act = ACTS[int(random.integers(len(ACTS)))]
    code = TEAMS[int(random.integers(len(TEAMS)))].format(act=act)
    if random.random() < 0.2:
        code = mutated(code.encode(errors="surrogateescape"), random)[0].decode(errors="surrogateescape")
    place = folder / f"team{next(_numbers)}"  # a file is loaded once
    place.mkdir()
    (place / "mine.py").write_bytes((HEAD + code).encode(errors="surrogateescape"))
    names = ("mine.py:T", "mine.py:T", "mine.py:T", "mine.py:", "mine.py", "mine.py:Other", "mine.py:np")
    return f"{code!r:.150}", partial(_make, f"{place}/{names[int(random.integers(len(names)))]}")


def _make(name: str) -> None:
    try:
        make_policy(name)
    except TwcError:
        raise
    except Exception as error:
        if told_of_user_code(error) is None:
            raise


def _table(folder: Path, random: Random) -> tuple[str, Callable]:
    """Tables of readings in other forms."""
    texts, read = (WIFI, read_wifi) if random.random() < 0.5 else (SIGNS, read_signs)
    sound = texts[int(random.integers(len(texts)))].format(BEGUN_S, BEGUN_S + 1)
    raw, what = mutated(sound.encode(), random, OF_TEXT)
    path = folder / "odd.csv"
    path.write_bytes(raw)
    robots = ((("",), ("", ""), ("1", "2"), ("north", "south"))[int(random.integers(4))]) if "robot" in sound else ("",)
    return f"{what}: {raw!r:.120}", partial(read, path, Span(BEGUN_S, BEGUN_S + 100.0, robots))


def _part(folder: Path, random: Random) -> tuple[str, Callable]:
    """Finished parts that are damaged: each is as it was written, or is computed again."""
    parts = FinishedParts(folder / "parts", "trial", {})
    parts.keep("a", RESULT)
    (path,) = parts.folder.glob("*.json")
    raw, what = mutated(path.read_bytes(), random, OF_JSON)
    path.write_bytes(raw)

    def work() -> None:
        found = parts.find("a", "none")
        assert found in (RESULT, "none"), f"another result: {found}"

    return what, work


DOORS: tuple[Door, ...] = (_team, _table, _table, _table, _part)
