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
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    from ..report import write_report

    print(write_report(options.run_folder, options.truth))
    return 0
