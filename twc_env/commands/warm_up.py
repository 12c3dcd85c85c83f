"""`twc-env warm-up`: compile all kernels before the first episode."""

from __future__ import annotations

import argparse
import time


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.description = (
        "Compile everything that an episode needs and keep it on disk. The first episode on a machine does so anyway; "
        "this is for images and clusters, whose processes then start at once."
    )
    parser.epilog = (
        "examples:\n  twc-env warm-up\n  NUMBA_CACHE_DIR=/opt/kernels twc-env warm-up\n\n"
        "The kernels go to NUMBA_CACHE_DIR, or to the user's cache folder. In an image: set NUMBA_CACHE_DIR to "
        "a folder of the image and run this as its last step; the folder may be read-only afterwards."
    )
    parser.set_defaults(run=_run)


def _run(_arguments: argparse.Namespace) -> None:
    from twc_env.exploration.warm_up import compile_all
    from twc_env.kernels.cache_folder import cache_folder, is_kept

    begin_s = time.perf_counter()
    count = compile_all()
    done = f"{count} functions compiled" if count else "nothing to compile: all kernels were there"
    kept = f"kept in {cache_folder()}" if is_kept() else "NOT kept: no folder can be written, set NUMBA_CACHE_DIR"
    print(f"{done} ({time.perf_counter() - begin_s:.0f} s); {kept}")
