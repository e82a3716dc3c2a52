"""rgbd-dic info: what a bag holds, and whether it can be measured."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.errors import RgbdDicError

from ..recorded import calibration_of, check_topics
from .options import beside


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("info", help="what a bag holds", description=__doc__)
    parser.add_argument("bag", type=Path, help="bag: a directory with metadata.yaml, or a .mcap file")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    with BagReader(options.bag) as bag:
        duration_s = (bag.end_ns - bag.start_ns) * 1e-9
        print(f"{bag.path}: {sum(topic.count for topic in bag.topics.values())} messages in {duration_s:.3f} s")
        for name, topic in bag.topics.items():
            rate = topic.count / duration_s if duration_s > 0 else float("nan")
            print(f"  {topic.count:6d}  {rate:7.2f} Hz  {name}  ({topic.type})")
        problems = []
        try:
            check_topics(bag)
            calibration = calibration_of(bag, beside(options.bag, "calibration.yaml"))
            camera = calibration.camera
            print(f"camera: {camera.width} x {camera.height} px, focal length {camera.fx:.2f}, {camera.fy:.2f} px")
        except RgbdDicError as error:
            problems.append(str(error))
    for name in ("regions.yaml", "calibration.yaml", "truth.csv"):
        print(f"{name}: {'in the bag' if beside(options.bag, name) else 'not in the bag'}")
    for problem in problems:
        print(f"cannot be measured as it is: {problem}")
    return 1 if problems else 0
