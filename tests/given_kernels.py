"""The kernels of this clone, given to another copy of the package, which spares it minutes of compilation. Without them
all runs as well."""

import hashlib
import json
import os
import shutil
from pathlib import Path

from twc_env.kernels.cache_folder import cache_folder

ROOT = Path(__file__).parents[1]


def give_kernels(site: Path, cache: Path) -> None:
    """Copy compiled kernels to where they are found for the files in `site`: numba names folders by the path of the
    source, and looks at its time. `cache` is what XDG_CACHE_HOME then has to name."""
    there = {}
    for source in (path for top in ("twc_env", "agents", "training") for path in (ROOT / top).rglob("*.py")):
        inside = source.relative_to(ROOT)
        installed = site / inside if (site / inside).exists() else site / "twc_env" / inside
        os.utime(installed, ns=(source.stat().st_atime_ns, source.stat().st_mtime_ns))
        there[numba_folder(source)] = numba_folder(installed)
    copy = shutil.copytree(cache_folder(), cache / "twc_env" / "kernels" / cache_folder().name)
    for file in copy.glob("*/sums.json"):
        for folder in [path for path in file.parent.iterdir() if path.is_dir()]:
            if folder.name in there:
                folder.rename(file.parent / there[folder.name])
            else:
                shutil.rmtree(folder)
        sums = {tuple(name.split("/")): value for name, value in json.loads(file.read_text()).items()}
        file.write_text(json.dumps({f"{there[at]}/{name}": value for (at, name), value in sums.items() if at in there}))


def numba_folder(source: Path) -> str:
    return f"{source.parent.name}_{hashlib.sha1(str(source.parent).encode()).hexdigest()}"
