"""rgbd-dic process: a bag through the method, offline; the same numbers as the graph's."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from rgbd_dic_acquisition.bag import BagReader
from tqdm import tqdm

from ..core.pipeline import Pipeline
from ..core.regions import load_regions
from ..recorded import calibration_of, frame_count, measure_bag
from ..results import CSV_NAME, read_truth
from ..runs import MapSelection, Run
from .options import (
    NOTHING_VALID,
    add_measurement,
    beside,
    measurement_settings,
    print_summary,
    required_file,
)


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("process", help="measure a bag offline", description=__doc__)
    parser.add_argument("bag", type=Path, help="bag: a directory with metadata.yaml, or a .mcap file")
    add_measurement(parser)
    parser.add_argument(
        "--threads", type=int, help="threads of the DIC (default: all cores); results do not depend on it"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    settings, methods = measurement_settings(options)
    if options.threads is not None:
        settings = replace(settings, correlation=replace(settings.correlation, threads=options.threads))
    regions_path = required_file(options.regions, options.bag, "regions.yaml")
    regions = load_regions(regions_path)
    calibration_path = options.calibration or beside(options.bag, "calibration.yaml")
    truth_path = options.truth or beside(options.bag, "truth.csv")
    truth = read_truth(truth_path) if truth_path else None
    selection, openings = MapSelection(), []
    with BagReader(options.bag) as bag:
        pipeline = Pipeline(calibration_of(bag, calibration_path), regions, settings, methods)
        with tqdm(total=frame_count(bag), unit="frame", file=sys.stderr, disable=None) as progress:
            for measurements in measure_bag(bag, pipeline):
                for measurement in measurements:
                    selection.add(measurement.field, measurement.opening)
                    if measurement.opening is not None:
                        openings.append(measurement.opening)
                progress.update()
    inputs = {
        "bag": str(options.bag),
        "regions": str(regions_path),
        "calibration": str(calibration_path or "in the bag"),
    }
    result = Run(openings, selection.maps(), pipeline.tracking.reference, inputs, settings.as_dict())
    copies = [path for path in (regions_path, calibration_path, truth_path) if path is not None]
    result.save(options.out, copies)
    if regions.crack is None:
        print("no crack zones in the regions: displacement maps only")
        print(f"maps: {options.out}; figures: rgbd-dic report {options.out}")
        return 0 if result.maps else NOTHING_VALID
    code = print_summary(openings, truth)
    print(f"openings: {options.out / CSV_NAME}; figures: rgbd-dic report {options.out}")
    return code
