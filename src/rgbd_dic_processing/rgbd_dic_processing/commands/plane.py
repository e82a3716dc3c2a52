"""rgbd-dic plane: the panel's plane of one ToF frame, as .ply files and a picture (Figures 4.9 to 4.11)."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rgbd_dic_acquisition.bag import BagReader

from ..core.regions_file import load_regions
from ..core.settings import load_settings
from ..plane_view import view_plane
from ..recorded import calibration_of
from .options import add_inputs, beside, complete_regions


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("plane", help="the plane of one ToF frame, as .ply and a picture", description=__doc__)
    parser.add_argument("bag", type=Path, help="bag: a directory with metadata.yaml, or a .mcap file")
    parser.add_argument("--at", type=_not_negative, default=0.0, metavar="S", help="time since the first image [s]")
    add_inputs(parser)
    parser.add_argument("--out", type=Path, required=True, help="folder for the files; made if missing")
    parser.set_defaults(run=run)


def _not_negative(text: str) -> float:
    value = float(text)
    if not value >= 0:
        raise argparse.ArgumentTypeError("must not be negative")
    return value


def run(options: argparse.Namespace) -> int:
    from ..report.plane_figure import draw_plane, words  # matplotlib takes its time

    settings = load_settings(options.settings)
    with BagReader(options.bag) as bag:
        calibration = calibration_of(bag, options.calibration or beside(options.bag, "calibration.yaml"))
        given = options.regions or beside(options.bag, "regions.yaml")
        regions = load_regions(complete_regions(bag, calibration, given, settings, options.out))
        view = view_plane(bag, calibration, regions, settings, options.at)
    view.save_ply(options.out)
    draw_plane(view, options.out / "plane.png")
    print(f"ToF frame of stamp {view.stamp_ns * 1e-9:.6f} s")
    print("\n".join(words(view)))
    print(f"cloud.ply, selection.ply, plane.ply and plane.png: {options.out}")
    return 0
