"""rgbd-dic import: a folder of images, with depth files or a known distance, becomes a bag."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rgbd_dic_acquisition.calibration import load_calibration

from .progress import progress


def add_parser(commands: Any) -> None:
    parser = commands.add_parser("import", help="folders of images become a bag", description=__doc__)
    parser.add_argument(
        "images", type=Path, help="folder of images: PNG or TIFF, 8 or 16 bit, in the order of their names"
    )
    parser.add_argument("--out", type=Path, required=True, help="directory of the bag; must not exist")
    parser.add_argument(
        "--depth",
        type=Path,
        help="folder of depth files: 16-bit PNG [mm], .npy [m, or integers in mm], .ply [m]",
    )
    parser.add_argument(
        "--distance",
        type=float,
        metavar="M",
        help="distance of a constant plane [m], where there is no depth",
    )
    parser.add_argument("--stamps", type=Path, help="CSV with columns image and stamp_s [s]")
    parser.add_argument("--depth-stamps", type=Path, help="CSV with columns depth and stamp_s [s]")
    parser.add_argument(
        "--frame-rate",
        type=float,
        default=30.0,
        metavar="HZ",
        help="of images without stamps [Hz] (default: 30)",
    )
    parser.add_argument("--calibration", type=Path, help="calibration.yaml of the recording")
    parser.add_argument(
        "--focal",
        type=float,
        metavar="PX",
        help="focal length [px], without a calibration (default: image width)",
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    from rgbd_dic_acquisition.recordings import import_recording

    calibration = load_calibration(options.calibration) if options.calibration else None
    with progress(None, "image") as bar:

        def show(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        summary = import_recording(
            options.images,
            options.out,
            depth=options.depth,
            stamps=options.stamps,
            depth_stamps=options.depth_stamps,
            distance_m=options.distance,
            calibration=calibration,
            focal_px=options.focal,
            frame_rate_hz=options.frame_rate,
            progress=show,
        )
    print(f"{summary.path}: {', '.join(f'{count} {topic}' for topic, count in sorted(summary.counts.items()))}")
    for note in summary.notes:
        print(f"note: {note}")
    print(f"next: draw regions.yaml (docs/files.md), then rgbd-dic process {summary.path} --regions regions.yaml ...")
    return 0
