"""What several sub-commands ask for and print in the same way."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.calibration import Calibration
from rgbd_dic_acquisition.errors import RgbdDicError

from ..core.displacement import SOLVERS
from ..core.regions_file import read_entries
from ..core.settings import ProcessingSettings, load_settings
from ..found_regions import find_regions
from ..results import read_truth
from ..runs import TRUTH_NAME, Run
from ..summary import SUMMARY_NAME, summary

NOTHING_VALID = 3
ESTIMATES_NAME = "estimates.yaml"  # that `rgbd-dic calibrate` writes beside calibration.yaml


def add_inputs(parser: argparse.ArgumentParser) -> None:
    """Options of the sub-commands that look at the panel in a bag."""
    parser.add_argument(
        "--regions",
        type=Path,
        help="regions.yaml (default: the one inside the bag's directory); without a panel, it is found by its depth",
    )
    parser.add_argument(
        "--calibration", type=Path, help="calibration.yaml (default: the one inside the bag's directory)"
    )
    parser.add_argument("--settings", type=Path, help="settings.yaml, grouped by stage (docs/parameters.md)")


def add_measurement(parser: argparse.ArgumentParser) -> None:
    """Options of the sub-commands that measure a bag."""
    add_inputs(parser)
    parser.add_argument(
        "--method",
        help=f"compensation method, or several with commas: {', '.join(SOLVERS)}; or all (default: that of the "
        "settings, h_pose)",
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for the results; made if missing")
    parser.add_argument("--truth", type=Path, help="CSV with stamp_ns [ns] and opening_mm [mm] to compare with")
    parser.add_argument(
        "--maps-at",
        type=float,
        nargs="+",
        default=[],
        metavar="S",
        help="moments since the first image [s] of which displacement maps are kept too, beside those of the widest "
        "opening and of the last valid frame",
    )


def measurement_settings(options: argparse.Namespace) -> tuple[ProcessingSettings, tuple[str, ...]]:
    """The settings, with the first method asked for, and all of these methods."""
    settings = load_settings(options.settings)
    names = (settings.compensation.method,)
    if options.method is not None:
        names = _methods(options.method)
    return replace(settings, compensation=replace(settings.compensation, method=names[0])), names


def _methods(text: str) -> tuple[str, ...]:
    names = tuple(SOLVERS) if text == "all" else tuple(text.split(","))
    unknown = [name for name in names if name not in SOLVERS]
    if unknown:
        raise RgbdDicError(f"--method {','.join(unknown)}: choose from {', '.join(SOLVERS)}, or all")
    return tuple(dict.fromkeys(names))


def beside(bag: Path, name: str) -> Path | None:
    """A file inside the bag's directory, or beside its .mcap file, if it is there."""
    path = (bag if bag.is_dir() else bag.parent) / name
    return path if path.exists() else None


def required_file(given: Path | None, bag: Path, name: str) -> Path:
    """The file given, or else the one inside the bag's directory.

    Raises:
        RgbdDicError: if neither is there.
    """
    path = given or beside(bag, name)
    if path is None:
        raise RgbdDicError(f"no {name} in {bag}: give it with --{name.removesuffix('.yaml')} (see docs/files.md)")
    return path


def complete_regions(
    bag: BagReader, calibration: Calibration, given: Path | None, settings: ProcessingSettings, folder: Path
) -> Path:
    """The regions.yaml given, if it has a panel; else one with the panel found, which is written into a folder.

    Raises:
        MeasurementError: if no panel can be found.
    """
    if given is not None and "panel" in read_entries(given):
        return given
    found, path = find_regions(bag, calibration, given, settings), folder / "regions.yaml"
    found.save(path)
    print(f"{found}: {path}")
    return path


def finish(run: Run, folder: Path, regions: Path, calibration: Path | None, truth_path: Path | None) -> int:
    """Save a run with its inputs and its summary, print the summary; returns the exit code."""
    copies = {"regions.yaml": regions, "calibration.yaml": calibration, TRUTH_NAME: truth_path}
    if calibration is not None and (estimates := calibration.parent / ESTIMATES_NAME).exists():
        copies[ESTIMATES_NAME] = estimates
    run.save(folder, copies)
    text = summary(run, read_truth(truth_path) if truth_path else None)
    (folder / SUMMARY_NAME).write_text(text)
    print(text)
    print(f"results: {folder}; figures and page: rgbd-dic report {folder}")
    return 0 if any(opening.valid for opening in run.openings) or run.maps else NOTHING_VALID
