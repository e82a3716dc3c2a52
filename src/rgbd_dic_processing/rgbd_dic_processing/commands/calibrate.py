"""rgbd-dic calibrate: both sensors and the transform between them, from images of a checkerboard or a ChArUco board."""

from __future__ import annotations

import argparse
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml
from rgbd_dic_acquisition.calibration import save_calibration
from rgbd_dic_acquisition.errors import RgbdDicError, SettingsError

from ..calibrating.board import Board, BoardSettings
from ..calibrating.settings import CalibratingSettings
from .progress import progress

FILE_NAME, ESTIMATES_NAME, PAGE_NAME = "calibration.yaml", "estimates.yaml", "calibration.html"


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("calibrate", help="calibrate the sensors from images of a board", description=__doc__)
    parser.add_argument("bag", type=Path, nargs="?", help="bag with the board in it; or give folders")
    parser.add_argument("--camera", type=Path, metavar="DIR", help="folder of camera images (PNG or TIFF)")
    parser.add_argument("--tof", type=Path, metavar="DIR", help="folder of ToF intensity images (PNG or TIFF)")
    parser.add_argument("--depth", type=Path, metavar="DIR", help="folder of ToF depth images (PNG [mm] or .npy)")
    parser.add_argument("--out", type=Path, required=True, help="folder for the results; made if missing")
    defaults, chosen = BoardSettings(), CalibratingSettings()
    parser.add_argument(
        "--board",
        default=f"{defaults.rows}x{defaults.cols}",
        metavar="ROWSxCOLS",
        help="squares (not inner corners) from top to bottom and from left to right (default: %(default)s)",
    )
    parser.add_argument(
        "--square-mm", type=float, default=30.0, metavar="MM", help="side of a square [mm] (default: %(default)g)"
    )
    parser.add_argument("--charuco", action="store_true", help="a ChArUco board instead of a checkerboard")
    parser.add_argument(
        "--marker-mm", type=float, metavar="MM", help="ChArUco: side of a marker [mm] (default: 3/4 of a square)"
    )
    parser.add_argument("--dictionary", default=defaults.dictionary, help="ChArUco: markers (default: %(default)s)")
    parser.add_argument("--legacy", action="store_true", help="ChArUco: laid out as by OpenCV before 4.6")
    parser.add_argument(
        "--principal-point",
        choices=("centre", "free"),
        help=f"taken in the middle of the image, as the thesis does, or estimated (default: {chosen.principal_point})",
    )
    parser.add_argument("--tof-distortion", action="store_true", help="estimate the ToF sensor's distortion too")
    parser.add_argument(
        "--every", type=float, metavar="S", help=f"bags: one ToF frame every so often [s] (default: {chosen.every_s:g})"
    )
    parser.add_argument("--settings", type=Path, help="YAML with what else differs (docs/calibration.md)")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    from ..calibrating.calibrate import calibrate
    from ..calibrating.page import write_page
    from ..calibrating.sources import Bag, Folders
    from ..calibrating.summary import rows, save_estimates
    from ..runs import versions

    folders = (options.camera, options.tof, options.depth)
    if any(folders) if options.bag is not None else options.camera is None:
        raise RgbdDicError("give either a bag, or folders with --camera (and --tof, --depth)")
    board = Board(_board(options))
    settings = _settings(options)
    source = Folders(*folders) if options.bag is None else Bag(options.bag, settings.every_s)
    with progress(len(source), "pose") as bar:
        result = calibrate(source, board, settings, bar.update)

    inputs = {n: str(getattr(options, n)) for n in ("bag", "camera", "tof", "depth") if getattr(options, n) is not None}
    options.out.mkdir(parents=True, exist_ok=True)
    save_calibration(result.estimate.calibration, options.out / FILE_NAME)
    save_estimates(result, options.out / ESTIMATES_NAME, inputs, versions())
    with progress(len(result.views), "picture") as bar:
        write_page(options.out / PAGE_NAME, result, inputs, versions(), bar.update)
    for note in result.notes:
        print(f"note: {note}")
    print(f"{len(result.views)} boards used; {len(result.skipped)} images were not, see the page")
    for row in rows(result):
        print(f"  {row.name:22s} {row.value:>12s} ± {row.sigma:<9s} {row.unit}")
    print(f"{options.out / FILE_NAME}; how it was found, and how well: {options.out / PAGE_NAME}")
    return 0


def _settings(options: argparse.Namespace) -> CalibratingSettings:
    values: dict[str, Any] = {}
    if options.settings is not None:
        try:
            values = yaml.safe_load(options.settings.read_text()) or {}
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise SettingsError(f"cannot read settings {options.settings}: {error}") from error
    given = {"principal_point": options.principal_point, "every_s": options.every}
    given["tof_distortion"] = options.tof_distortion or None
    settings = CalibratingSettings.from_mapping(values, str(options.settings))
    return replace(settings, **{name: value for name, value in given.items() if value is not None})


def _board(options: argparse.Namespace) -> BoardSettings:
    match = re.fullmatch(r"(\d+)\s*[xX×]\s*(\d+)", options.board.strip())
    if match is None:
        raise SettingsError(f"--board {options.board}: give squares as ROWSxCOLS, such as 9x12")
    marker_mm = 0.75 * options.square_mm if options.marker_mm is None else options.marker_mm
    return BoardSettings(
        kind="charuco" if options.charuco else "checkerboard",
        rows=int(match[1]),
        cols=int(match[2]),
        square_m=options.square_mm * 1e-3,
        marker_m=marker_mm * 1e-3,
        dictionary=options.dictionary,
        legacy=options.legacy,
    )
