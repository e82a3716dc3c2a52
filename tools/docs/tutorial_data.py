"""Stands in for one's own recordings in docs/tutorial.md: folders of images and depth, and images of a board.

    tools/run python tools/docs/tutorial_data.py FOLDER

All of it is simulated, with sensors of half the thesis' pixels.
"""

from __future__ import annotations

import argparse
import csv
import shutil
import tempfile
from pathlib import Path

import cv2
import numpy as np
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.messages import depth_from_message, image_from_message, stamp_to_ns
from rgbd_dic_acquisition.simulator.board import BoardRig, board_poses
from rgbd_dic_acquisition.simulator.flight import FlightSettings
from rgbd_dic_acquisition.simulator.flight_bag import simulate_flight
from rgbd_dic_acquisition.simulator.sensors import CameraSettings, TofSettings, sensor_rig
from rgbd_dic_acquisition.simulator.speckle import Checkerboard

CAMERA, TOF = {"width_px": 720, "height_px": 540}, {"width_px": 320, "height_px": 240}
SECONDS, BOARDS = 1.2, 24


def write_recording(folder: Path) -> None:
    """A flight in front of the cracked panel as folders of PNG files with their stamps, and its regions and truth."""
    settings = {"duration_s": SECONDS, "seed": 5, "camera": CAMERA, "tof": TOF}
    with tempfile.TemporaryDirectory() as made:
        bag = Path(made) / "flight"
        simulate_flight(FlightSettings.from_mapping(settings), bag)
        for name in ("regions.yaml", "truth.csv"):
            shutil.copyfile(bag / name, folder / name)
        with BagReader(bag) as reader:
            for what, topic, read in (
                ("image", "/camera/image_raw", image_from_message),
                ("depth", "/tof/depth/image_raw", lambda message: in_millimetres(depth_from_message(message))),
            ):
                (folder / f"{what}s").mkdir()
                with (folder / f"{what}s.csv").open("w", newline="") as file:
                    rows = csv.writer(file)
                    rows.writerow([what, "stamp_s"])
                    for index, (_, _, message) in enumerate(reader.messages([topic])):
                        name, stamp_ns = f"{what}{index:03d}.png", stamp_to_ns(message.header.stamp)
                        cv2.imwrite(str(folder / f"{what}s" / name), read(message))
                        rows.writerow([name, f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}"])


def write_boards(folder: Path) -> None:
    """A checkerboard before both sensors: images, ToF intensity and depth."""
    rig = sensor_rig(CameraSettings(**CAMERA), TofSettings(**TOF))
    board, random = BoardRig(rig, Checkerboard(9, 12, 0.03)), np.random.default_rng(2)
    poses = board_poses(rig.camera, (board.width_m, board.height_m), BOARDS, random, distance_m=(0.8, 1.2))
    for index, pose in enumerate(poses):
        frame = board.expose(pose, random)
        for name, image in (("camera", frame.camera), ("tof", frame.tof), ("depth", in_millimetres(frame.depth_m))):
            (folder / name).mkdir(exist_ok=True)
            cv2.imwrite(str(folder / name / f"board{index:02d}.png"), image)


def in_millimetres(depth_m: np.ndarray) -> np.ndarray:
    return np.nan_to_num(np.rint(1e3 * depth_m)).astype(np.uint16)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    for name, write in (("recording", write_recording), ("boards", write_boards)):
        (folder / name).mkdir(parents=True)
        write(folder / name)
        print(f"{folder / name}: {', '.join(sorted(path.name for path in (folder / name).iterdir()))}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
