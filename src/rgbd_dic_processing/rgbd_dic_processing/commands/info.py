"""rgbd-dic info: what a bag holds, and whether it can be measured; repair of one that was cut off."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.bag_repair import repair_bag
from rgbd_dic_acquisition.errors import RgbdDicError

from ..recorded import calibration_of, check_topics
from .options import beside


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("info", help="what a bag holds", description=__doc__)
    parser.add_argument("bag", type=Path, help="bag: a directory with metadata.yaml, or a .mcap file")
    parser.add_argument(
        "--repair",
        action="store_true",
        help="first make a new bag of what is whole in one that was cut off (power loss, a full disk) or has no "
        "metadata.yaml; the old one is only read",
    )
    parser.add_argument(
        "--out", type=Path, help="with --repair: directory of the new bag (default: NAME_repaired beside the old one)"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    path = _repaired(options.bag, options.out) if options.repair else options.bag
    with BagReader(path) as bag:
        duration_s = (bag.end_ns - bag.start_ns) * 1e-9
        print(f"{bag.path}: {sum(topic.count for topic in bag.topics.values())} messages in {duration_s:.3f} s")
        for name, topic in bag.topics.items():
            rate = topic.count / duration_s if duration_s > 0 else float("nan")
            print(f"  {topic.count:6d}  {rate:7.2f} Hz  {name}  ({topic.type})")
        problems = []
        try:
            check_topics(bag)
            calibration = calibration_of(bag, beside(path, "calibration.yaml"))
            camera = calibration.camera
            print(f"camera: {camera.width} x {camera.height} px, focal length {camera.fx:.2f}, {camera.fy:.2f} px")
        except RgbdDicError as error:
            problems.append(str(error))
    for name in ("regions.yaml", "calibration.yaml", "truth.csv"):
        print(f"{name}: {'in the bag' if beside(path, name) else 'not in the bag'}")
    for problem in problems:
        print(f"cannot be measured as it is: {problem}")
    return 1 if problems else 0


def _repaired(path: Path, output: Path | None) -> Path:
    """The new bag, or the old one if there is nothing to repair; says which."""
    repair = repair_bag(path, output)
    if repair.path is None:
        print(f"nothing to repair: all {repair.messages} messages of {path} are whole")
        return path
    print(
        f"repaired: {repair.messages} messages into {repair.path}; lost: {repair.lost_bytes / 1e6:.3f} MB that are no "
        f"whole chunk, {repair.damaged_chunks} damaged chunks among them"
    )
    return repair.path
