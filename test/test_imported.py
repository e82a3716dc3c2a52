"""A flight taken apart into files and imported again measures what it measured before, for every kind of depth file."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from plyfile import PlyData, PlyElement
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.calibration import load_calibration, points_from_depth
from rgbd_dic_acquisition.messages import depth_from_message, image_from_message
from system import rgbd_dic


def openings(out: Path, method: str) -> np.ndarray:
    with (out / "crack_opening.csv").open(newline="") as file:
        return np.array([float(row["opening_mm"]) for row in csv.DictReader(file) if row["method"] == method])


def take_apart(flight: Path, folder: Path, kind: str) -> None:
    """Images, depth files of this kind and stamps of both."""
    tof = load_calibration(flight / "calibration.yaml").tof
    stamps: dict[str, list[str]] = {"image": ["image,stamp_s"], "depth": ["depth,stamp_s"]}
    for name in stamps:
        (folder / name).mkdir(parents=True)
    with BagReader(flight) as bag:
        for topic, _, message in bag.messages(["/camera/image_raw", "/tof/depth/image_raw"]):
            stream = "image" if topic == "/camera/image_raw" else "depth"
            path = folder / stream / f"{stream}{len(stamps[stream])}.{'png' if stream == 'image' else kind}"
            stamp = message.header.stamp
            stamps[stream].append(f"{path.name},{stamp.sec}.{stamp.nanosec:09d}")
            if stream == "image" or kind == "png":
                cv2.imwrite(str(path), image_from_message(message))
            elif kind == "npy":
                np.save(path, depth_from_message(message))
            else:
                points = points_from_depth(tof, depth_from_message(message))
                vertices = np.array([tuple(p) for p in points], [(axis, "f4") for axis in "xyz"])
                PlyData([PlyElement.describe(vertices, "vertex")]).write(str(path))
    for name, lines in stamps.items():
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")


@pytest.fixture(scope="module")
def original(flight: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("original")
    assert rgbd_dic("process", flight, "--method", "h_pose,h_3d", "--out", out).returncode == 0
    return out


@pytest.mark.parametrize("kind", ["png", "npy", "ply"])
def test_import_measures_the_same(flight: Path, original: Path, tmp_path: Path, kind: str) -> None:
    take_apart(flight, tmp_path, kind)
    done = rgbd_dic(
        "import",
        tmp_path / "image",
        "--stamps",
        tmp_path / "image.csv",
        "--depth",
        tmp_path / "depth",
        "--depth-stamps",
        tmp_path / "depth.csv",
        "--calibration",
        flight / "calibration.yaml",
        "--out",
        tmp_path / "bag",
    )
    assert done.returncode == 0, done.stderr
    done = rgbd_dic(
        "process",
        tmp_path / "bag",
        "--regions",
        flight / "regions.yaml",
        "--method",
        "h_pose,h_3d",
        "--out",
        tmp_path / "out",
    )
    assert done.returncode == 0, done.stderr
    for method in ("h_pose", "h_3d"):
        # float32 in between rounds depths to 0.1 um
        np.testing.assert_allclose(openings(tmp_path / "out", method), openings(original, method), atol=1e-4)


def test_clouds_through_the_graph(flight: Path, original: Path, tmp_path: Path) -> None:
    take_apart(flight, tmp_path, "ply")
    options = ("--stamps", tmp_path / "image.csv", "--depth", tmp_path / "depth")
    options += ("--depth-stamps", tmp_path / "depth.csv", "--calibration", flight / "calibration.yaml")
    assert rgbd_dic("import", tmp_path / "image", *options, "--out", tmp_path / "bag").returncode == 0
    done = rgbd_dic(
        "up",
        tmp_path / "bag",
        "--regions",
        flight / "regions.yaml",
        "--method",
        "h_pose,h_3d",
        "--as-fast-as-possible",
        "--domain",
        "78",
        "--out",
        tmp_path / "out",
    )
    assert done.returncode == 0, done.stderr
    assert "frames lost: 0" in done.stdout
    for method in ("h_pose", "h_3d"):
        np.testing.assert_allclose(openings(tmp_path / "out", method), openings(original, method), atol=1e-4)
