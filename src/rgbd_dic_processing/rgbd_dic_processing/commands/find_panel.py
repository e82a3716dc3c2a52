"""rgbd-dic find-panel: find the panel by its depth, and write regions.yaml with it and a picture of it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.errors import RgbdDicError

from ..core.settings import load_settings
from ..found_regions import find_regions
from ..recorded import calibration_of
from .options import beside

GREEN = (115, 158, 0)  # BGR


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("find-panel", help="find the panel, and write regions.yaml", description=__doc__)
    parser.add_argument("bag", type=Path, help="bag: a directory with metadata.yaml, or a .mcap file")
    parser.add_argument("--regions", type=Path, help="regions.yaml whose other entries are kept (default: none)")
    parser.add_argument(
        "--calibration", type=Path, help="calibration.yaml (default: the one inside the bag's directory)"
    )
    parser.add_argument("--settings", type=Path, help="settings.yaml, grouped by stage (docs/parameters.md)")
    parser.add_argument("--out", type=Path, required=True, help="file to write; a .png of the same name goes beside it")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    if options.out.exists():
        raise RgbdDicError(f"{options.out} exists already: choose another --out, or remove it first")
    settings = load_settings(options.settings)
    with BagReader(options.bag) as bag:
        calibration = calibration_of(bag, options.calibration or beside(options.bag, "calibration.yaml"))
        found = find_regions(bag, calibration, options.regions, settings)
    found.save(options.out)
    picture = cv2.cvtColor(found.image, cv2.COLOR_GRAY2BGR)
    outline = np.round(found.panel.outline_px).astype(np.int32)
    cv2.polylines(picture, [outline], True, GREEN, max(2, found.image.shape[1] // 400), cv2.LINE_AA)
    path = options.out.with_suffix(".png")
    if not cv2.imwrite(str(path), picture):
        raise RgbdDicError(f"cannot write {path}")
    print(f"{found}: {options.out}; look at {path}")
    return 0
