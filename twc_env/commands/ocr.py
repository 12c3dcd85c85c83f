"""`twc-env ocr`: measure the table of OCR errors, and show it."""

from __future__ import annotations

import argparse
from pathlib import Path

from twc_env.running.argument_parser import add_verbosity
from twc_env.running.options import add_folder, add_pictures, count, natural


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Fill the command's parser."""
    parser.description = "Measure how a real OCR misreads signs, or show the measured table (docs/ocr.md)."
    parser.epilog = "example:\n  twc-env ocr show --out runs/ocr.png"
    actions = parser.add_subparsers(required=True, metavar="ACTION")

    make = actions.add_parser(
        "measure",
        help="render signs, read them with a real OCR, write the error table (about 10 minutes; extra `ocr`)",
        description="Render signs, read them with a real OCR and write the error table. Resumes if interrupted. The "
        "table in the package was measured with the defaults.",
        epilog="example:\n  twc-env ocr measure --signs 4 --out runs/ocr/table.json",
    )
    make.add_argument("--out", type=Path, required=True, metavar="FILE", help="error table to write, JSON")
    make.add_argument("--seed", type=natural, default=0, help="of signs and views")
    make.add_argument("--signs", type=count, default=40, help="signs per grid point")
    make.add_argument("--jobs", type=count, default=2, help="parallel processes")
    add_folder(make, "--cache", "runs/ocr", "folder of finished parts")
    add_verbosity(make)
    make.set_defaults(run=_measure)

    show = actions.add_parser(
        "show",
        help="draw sample signs and the error rates of the table (extra `ocr`)",
        description="Draw sample signs with their readings and the error rates of the table.",
        epilog="example:\n  twc-env ocr show --out runs/ocr.png",
    )
    show.add_argument("--out", type=Path, required=True, metavar="FILE", help="picture to write: .png, .pdf or .svg")
    add_pictures(show)
    add_verbosity(show)
    show.set_defaults(run=_show)


def _measure(options: argparse.Namespace) -> None:
    from twc_env.reproduce.ocr.ocr_measure import measure

    table = measure(options.out, options.seed, options.signs, options.cache, options.jobs)
    print(
        f"{table['made']['signs_read']} signs read; written: {options.out}, {options.out.stat().st_size / 1000:.0f} kB"
    )


def _show(options: argparse.Namespace) -> None:
    from twc_env.reproduce.ocr.ocr_picture import draw_table

    path = options.out if options.out.suffix else options.out.with_name(f"{options.out.name}.{options.format}")
    print(f"written: {draw_table(path, options.dpi)}")
