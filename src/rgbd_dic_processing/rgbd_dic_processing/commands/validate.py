"""rgbd-dic validate: the thesis' numerical validation repeated, its tables and figures beside ours."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from .progress import progress


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("validate", help="the thesis' tables beside ours", description=__doc__)
    parser.add_argument("chapter", choices=("chapter3",), help="chapter3: simulator, Tables 3.3 to 3.16")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("results/chapter3"),
        help="folder for tables, figures and, to go on after an interruption, images and results of the parts "
        "(default: results/chapter3)",
    )
    parser.add_argument("--quick", action="store_true", help="a subset of the images, in less than three minutes")
    parser.add_argument("--workers", type=int, help="processes (default: all cores)")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    from ..validation.chapter3.chapter import FULL, QUICK, run_chapter3
    from ..validation.chapter3.presentation import write_chapter3
    from ..validation.page import TABLES

    workers = options.workers or os.cpu_count() or 1
    with progress(None, "part") as bar:

        def show(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        data = run_chapter3(options.out, QUICK if options.quick else FULL, workers, show)
    reached = write_chapter3(data, options.out, options.out)
    for one in reached:
        print(f"{'met    ' if one.met else 'NOT MET'}  {one.what}: {one.measured:.3g} {one.unit}")
    met = sum(one.met for one in reached)
    print(f"{met} of {len(reached)} numbers are met; tables and figures: {options.out / TABLES}")
    return 0
