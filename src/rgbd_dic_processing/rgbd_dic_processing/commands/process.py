"""rgbd-dic process: a bag through the method, offline; the same numbers as the graph's."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.calibration import save_calibration
from rgbd_dic_acquisition.errors import BagError
from threadpoolctl import threadpool_limits

from ..core.pipeline import Pipeline
from ..core.regions_file import load_regions
from ..core.sensor_delay import TOLD_AS
from ..frame_files import FrameRecords
from ..recorded import calibration_of, calibration_warning, frame_count, measure_bag
from ..results import read_truth
from ..runs import MapSelection, Run
from .options import add_measurement, beside, complete_regions, finish, measurement_settings
from .progress import progress


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("process", help="measure a bag offline", description=__doc__)
    parser.add_argument("bag", type=Path, help="bag: a directory with metadata.yaml, or a .mcap file")
    add_measurement(parser)
    parser.add_argument(
        "--threads", type=int, help="threads of the DIC (default: all cores); results do not depend on it"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    threadpool_limits(1, user_api="blas")  # matrices are small: threads would but wait for each other, busily
    settings, methods = measurement_settings(options)
    if options.threads is not None:
        settings = replace(settings, correlation=replace(settings.correlation, threads=options.threads))
    calibration_path = options.calibration or beside(options.bag, "calibration.yaml")
    truth_path = options.truth or beside(options.bag, "truth.csv")
    if truth_path is not None:
        read_truth(truth_path)  # a malformed one is refused before the work, not after
    selection, openings, budgets, failure = MapSelection(options.maps_at), [], [], None
    with BagReader(options.bag) as bag:
        calibration = calibration_of(bag, calibration_path)
        if warning := calibration_warning(bag, calibration):
            print(f"warning: {warning}", file=sys.stderr)
        given = options.regions or beside(options.bag, "regions.yaml")
        regions_path = complete_regions(bag, calibration, given, settings, options.out)
        pipeline = Pipeline(calibration, load_regions(regions_path), settings, methods)
        with progress(frame_count(bag), "frame") as bar:
            try:
                for measurements in measure_bag(bag, pipeline):
                    for measurement in measurements:
                        selection.add(measurement.field, measurement.opening)
                        if measurement.opening is not None:
                            openings.append(measurement.opening)
                        if measurement.budget is not None:
                            budgets.append(measurement.budget)
                    bar.update(min(1, bar.total - bar.n))
            except BagError as error:  # what was measured before is kept
                failure = error
    inputs = {
        "bag": str(options.bag),
        "regions": str(regions_path),
        "calibration": str(calibration_path or "in the bag"),
        "methods": ", ".join(methods),
    }
    if calibration_path is None:
        calibration_path = options.out / "calibration.yaml"
        options.out.mkdir(parents=True, exist_ok=True)
        save_calibration(calibration, calibration_path)
    reference = pipeline.tracking.reference
    delay = pipeline.sensor_delay()
    if delay.warning:
        print(f"warning: {delay.warning}", file=sys.stderr)
    facts = {**selection.facts(), TOLD_AS: str(delay)}
    frames = FrameRecords(pipeline.quality.images(), pipeline.quality.planes, budgets)
    result = Run(openings, selection.maps(), reference, inputs, settings.as_dict(), facts, frames=frames)
    code = finish(result, options.out, regions_path, calibration_path, truth_path)
    if failure is not None:
        raise failure
    return code
