"""rgbd-dic validate: the thesis' validations repeated, their tables and figures beside ours."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from .progress import progress

CHAPTERS = {
    "chapter3": "the simulator, Tables 3.3 to 3.16",
    "chapter4": "the experiment in the simulated laboratory, Table 4.6",
}


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("validate", help="the thesis' tables beside ours", description=__doc__)
    words = "; ".join(f"{name}: {what}" for name, what in CHAPTERS.items())
    parser.add_argument("chapter", choices=tuple(CHAPTERS), help=words)
    parser.add_argument(
        "--out",
        type=Path,
        help="folder for tables, figures and, to go on after an interruption, results of the parts "
        "(default: results/ and the chapter's name)",
    )
    parser.add_argument("--quick", action="store_true", help="a small part of it, in less than three minutes")
    parser.add_argument(
        "--seeds", type=int, choices=range(1, 6), help="chapter4: laboratories of each kind (default: 5)"
    )
    parser.add_argument("--workers", type=int, help="processes (default: all cores)")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    from ..validation.page import TABLES

    measure, write, scope = _chapter(options)
    folder = options.out or Path("results") / options.chapter
    workers = options.workers or os.cpu_count() or 1
    with progress(None, "part") as bar:

        def show(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        data = measure(folder, scope, workers, show)
    reached = write(data, folder, folder)
    for one in reached:
        print(f"{'met    ' if one.met else 'NOT MET'}  {one.what}: {one.measured:.3g} {one.unit}")
    met = sum(one.met for one in reached)
    print(f"{met} of {len(reached)} numbers are met; tables and figures: {folder / TABLES}")
    return 0


def _chapter(options: argparse.Namespace) -> tuple[Any, Any, Any]:
    """What measures a chapter, what writes its page, and what is to be measured."""
    if options.chapter == "chapter3":
        from ..validation.chapter3 import chapter, presentation

        return chapter.run_chapter3, presentation.write_chapter3, chapter.QUICK if options.quick else chapter.FULL
    from ..validation.chapter4 import chapter, presentation

    scope = chapter.QUICK if options.quick else chapter.FULL
    return chapter.run_chapter4, presentation.write_chapter4, scope.with_seeds(options.seeds or len(chapter.SEEDS))
