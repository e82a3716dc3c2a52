"""sun-dic: AKAZE features for the first points, IC-GN with cubic interpolation, Gaussian blur of 5 px.

It takes images as files only; reading them is part of its run.
"""

import tempfile
from pathlib import Path

import cv2
from serve import serve
from sundic import sundic
from sundic.settings import Settings


def prepare(reference, setup):
    x0, y0, x1, y1 = setup["region"]
    half = setup["subset_size"] // 2
    folder = tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None)
    images = Path(folder.name) / "images"
    images.mkdir()
    cv2.imwrite(str(images / "0.tif"), reference)
    settings = Settings()
    settings.ImageFolder = str(images)
    settings.CPUCount = 1
    settings.SubsetSize = setup["subset_size"]
    settings.StepSize = setup["step"]
    settings.ConvergenceThreshold = setup["tolerance_px"]
    settings.ROI = [x0 + half, y0 + half, x1 - x0 - 2 * half + 1, y1 - y0 - 2 * half + 1]

    def correlate(target):
        cv2.imwrite(str(images / "1.tif"), target)
        (points,) = sundic.planarDICLocal(settings, str(Path(folder.name) / "result.sdic"))
        columns = sundic.CompID
        found = points.reshape(-1, points.shape[2])
        names = {"x": columns.XCoordID, "y": columns.YCoordID, "u": columns.XDispID, "v": columns.YDispID}
        return {name: found[:, column] for name, column in names.items()}

    correlate.folder = folder  # kept as long as it is used
    return correlate


serve(prepare)
