"""Files of a run beside crack_opening.csv: what each image and each ToF frame was like, and each opening's budget."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rgbd_dic_acquisition.errors import RgbdDicError

from .core.error_sources import ErrorSource
from .core.frame_quality import ImageQuality, PlaneQuality
from .core.opening_budget import OpeningBudget, root_of_part
from .core.search import SeedSource
from .core.status import FrameStatus

IMAGES_NAME, PLANES_NAME, BUDGETS_NAME = "images.csv", "planes.csv", "uncertainty.csv"
IMAGES_HEADER = (
    "stamp_ns",
    "status",
    "seed",
    "subsets",
    "found",
    "zncc_median",
    "zncc_5th_percentile",
    "sigma_px",
    "depth_offset_s",
)
PLANES_HEADER = (
    "stamp_ns",
    "status",
    "points",
    "inliers",
    "residual_rms_mm",
    "distance_mm",
    "tilt_deg",
    "reason",
)
PARTS = tuple(f"u_{source.name.lower()}_mm" for source in ErrorSource)
BUDGETS_HEADER = ("stamp_ns", "method", "u_opening_mm", *PARTS, "residual_px")


@dataclass(frozen=True)
class FrameRecords:
    """All three; empty where a run did not keep them."""

    images: Sequence[ImageQuality] = field(default_factory=list)
    planes: Sequence[PlaneQuality] = field(default_factory=list)
    budgets: Sequence[OpeningBudget] = field(default_factory=list)

    def save(self, folder: Path) -> None:
        _write(folder / IMAGES_NAME, IMAGES_HEADER, (_image_row(image) for image in self.images))
        _write(folder / PLANES_NAME, PLANES_HEADER, (_plane_row(plane) for plane in self.planes))
        ordered = sorted(self.budgets, key=lambda budget: budget.method)
        _write(folder / BUDGETS_NAME, BUDGETS_HEADER, (_budget_row(budget) for budget in ordered))

    @classmethod
    def load(cls, folder: Path) -> FrameRecords:
        """What a folder holds of them.

        Raises:
            RgbdDicError: if a file is not as it was written.
        """
        return cls(
            [_image(line) for line in _read(folder / IMAGES_NAME, IMAGES_HEADER)],
            [_plane(line) for line in _read(folder / PLANES_NAME, PLANES_HEADER)],
            [_budget(line) for line in _read(folder / BUDGETS_NAME, BUDGETS_HEADER)],
        )


def _image_row(image: ImageQuality) -> list[str]:
    return [
        str(image.stamp_ns),
        image.status.name,
        image.seed.name,
        str(image.subsets),
        str(image.found),
        *(f"{value:.6f}" for value in (image.zncc_median, image.zncc_low, image.sigma_px, image.depth_offset_s)),
    ]


def _image(line: dict[str, str]) -> ImageQuality:
    return ImageQuality(
        int(line["stamp_ns"]),
        FrameStatus[line["status"]],
        SeedSource[line["seed"]],
        int(line["subsets"]),
        int(line["found"]),
        *(float(line[name]) for name in IMAGES_HEADER[5:]),
    )


def _plane_row(plane: PlaneQuality) -> list[str]:
    lengths = (plane.residual_rms_m * 1e3, plane.distance_m * 1e3, math.degrees(plane.tilt_rad))
    return [
        str(plane.stamp_ns),
        plane.status.name,
        str(plane.points),
        str(plane.inliers),
        *(f"{value:.6f}" for value in lengths),
        plane.reason,
    ]


def _plane(line: dict[str, str]) -> PlaneQuality:
    return PlaneQuality(
        int(line["stamp_ns"]),
        FrameStatus[line["status"]],
        line["reason"],
        int(line["points"]),
        int(line["inliers"]),
        float(line["residual_rms_mm"]) * 1e-3,
        float(line["distance_mm"]) * 1e-3,
        math.radians(float(line["tilt_deg"])),
    )


def _budget_row(budget: OpeningBudget) -> list[str]:
    lengths = (budget.u_opening_m, *(root_of_part(part) for part in budget.parts_m2))
    numbers = (*(length * 1e3 for length in lengths), budget.residual_px)
    return [
        str(budget.stamp_ns),
        budget.method,
        *(f"{value:.7f}".replace("-0.0000000", "0.0000000") for value in numbers),
    ]


def _budget(line: dict[str, str]) -> OpeningBudget:
    roots_m = np.array([float(line[name]) for name in PARTS]) * 1e-3
    return OpeningBudget(
        int(line["stamp_ns"]),
        line["method"],
        float(line["u_opening_mm"]) * 1e-3,
        roots_m * np.abs(roots_m),
        float(line["residual_px"]),
    )


def _write(path: Path, header: tuple[str, ...], rows: Iterable[list[str]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def _read(path: Path, header: tuple[str, ...]) -> list[dict[str, str]]:
    if not path.exists():
        return []
    with path.open(newline="") as file:
        lines = csv.DictReader(file)
        if tuple(lines.fieldnames or ()) != header:
            raise RgbdDicError(f"{path}: its columns are not {', '.join(header)} (see docs/files.md)")
        return list(lines)
