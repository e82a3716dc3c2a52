"""rgbd-dic report: figures and one self-contained page of a run."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("report", help="figures and page of a run", description=__doc__)
    parser.add_argument("run_folder", type=Path, metavar="RUN", help="folder that process or up wrote")
    parser.add_argument(
        "--truth",
        type=Path,
        help="CSV with stamp_ns [ns] and opening_mm [mm] (default: truth.csv in RUN, if any)",
    )
    parser.add_argument(
        "--reference",
        type=Path,
        metavar="CSV",
        help="history of another rate and clock to align the run with: time_s [s] or stamp_ns [ns], opening_mm, and "
        "sliding_mm if known (docs/history.md)",
    )
    parser.add_argument(
        "--shifts",
        type=float,
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="range in which the delay of the reference is sought [s] (default: -1 1)",
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    from ..history.settings import AlignmentSettings
    from ..report import write_report

    alignment = AlignmentSettings(*options.shifts) if options.shifts else None
    print(write_report(options.run_folder, options.truth, options.reference, alignment))
    return 0
