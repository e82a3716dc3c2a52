"""The files of a run: crack_opening.csv, and the truth or reference that it is compared with."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import RgbdDicError

from .core.crack import CrackOpening
from .core.status import FrameStatus

CSV_NAME = "crack_opening.csv"
HEADER = (
    "stamp_ns",
    "method",
    "opening_mm",
    "sliding_mm",
    "out_of_plane_mm",
    "magnitude_mm",
    "u_opening_mm",
    "n_left",
    "n_right",
    "depth_offset_s",
    "latency_s",
    "valid",
    "reason",
    "reference_stamp_ns",
)


def row(opening: CrackOpening) -> list[str]:
    """One line of crack_opening.csv: lengths to the nanometre, times to the microsecond, NaN as `nan`."""
    lengths = (
        opening.opening_m,
        opening.sliding_m,
        opening.out_of_plane_m,
        opening.magnitude_m,
        opening.u_opening_m,
    )
    reason = "" if opening.valid else f"{opening.status.name}: {opening.reason}"
    return [
        str(opening.stamp_ns),
        opening.method,
        *(f"{value * 1e3:.6f}".replace("-0.000000", "0.000000") for value in lengths),
        str(opening.n_left),
        str(opening.n_right),
        f"{opening.depth_offset_s:.6f}",
        f"{opening.latency_s:.6f}",
        str(int(opening.valid)),
        reason,
        str(opening.reference_stamp_ns),
    ]


def write_openings(openings: Iterable[CrackOpening], path: Path) -> None:
    """Write crack_opening.csv, ordered by method, and each as its images came."""
    ordered = sorted(openings, key=lambda opening: opening.method)
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEADER)
        writer.writerows(row(opening) for opening in ordered)


def read_openings(path: Path) -> list[CrackOpening]:
    """Read crack_opening.csv back. What the file does not hold (the other uncertainties) is NaN.

    Raises:
        RgbdDicError: if it is missing or not such a file.
    """
    try:
        with path.open(newline="") as file:
            lines = list(csv.DictReader(file))
    except OSError as error:
        raise RgbdDicError(f"cannot read {path}: {error.strerror}; run `rgbd-dic process` first") from error
    try:
        return [_opening(line) for line in lines]
    except (KeyError, TypeError, ValueError) as error:
        raise RgbdDicError(f"{path} is not a crack_opening.csv: {error!r} (see docs/files.md)") from error


def _opening(line: dict[str, str]) -> CrackOpening:
    status, _, reason = line["reason"].partition(": ")
    metres = {name: float(line[f"{name}_mm"]) * 1e-3 for name in ("opening", "sliding", "out_of_plane", "magnitude")}
    return CrackOpening(
        int(line["stamp_ns"]),
        int(line["reference_stamp_ns"]),
        line["method"],
        FrameStatus.OK if line["valid"] == "1" else FrameStatus[status],
        reason,
        *metres.values(),
        float(line["u_opening_mm"]) * 1e-3,
        math.nan,
        math.nan,
        math.nan,
        int(line["n_left"]),
        int(line["n_right"]),
        float(line["depth_offset_s"]),
        float(line["latency_s"]),
    )


@dataclass(frozen=True)
class Truth:
    """A known history: stamps (N,) [ns] and opening, sliding, out-of-plane jump (N, 3) [m]."""

    stamps_ns: NDArray[np.int64]
    jump_m: NDArray[np.float64]


def read_truth(path: Path) -> Truth:
    """Read a CSV with stamp_ns, opening_mm and, if known, sliding_mm and out_of_plane_mm.

    Raises:
        RgbdDicError: if it is missing or lacks those columns.
    """
    try:
        with path.open(newline="") as file:
            lines = list(csv.DictReader(file))
        stamps = np.array([int(line["stamp_ns"]) for line in lines], np.int64)
        columns = ("opening_mm", "sliding_mm", "out_of_plane_mm")
        jump = np.array([[float(line.get(name) or "nan") for name in columns] for line in lines]).reshape(-1, 3)
    except OSError as error:
        raise RgbdDicError(f"cannot read {path}: {error.strerror}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise RgbdDicError(f"{path}: expected columns stamp_ns and opening_mm: {error!r}") from error
    return Truth(stamps, jump * 1e-3)


@dataclass(frozen=True)
class Comparison:
    """A method against the truth, over its valid frames.

    error_m: measured minus true opening (n,); rms_m: by Eq. 3.1 of the thesis' summary (n - 1).
    """

    method: str
    frames: int
    valid: int
    error_m: NDArray[np.float64]

    @property
    def rms_m(self) -> float:
        count = len(self.error_m)
        return math.sqrt(np.sum(self.error_m**2) / (count - 1)) if count > 1 else math.nan


def compare(openings: Sequence[CrackOpening], truth: Truth) -> list[Comparison]:
    """Each method's opening against the truth of the same stamps.

    What is measured is the change since the reference, so the truth at the reference is subtracted, or, if there is
    none of that stamp, at the first row.
    """
    index = {int(stamp): i for i, stamp in enumerate(truth.stamps_ns)}
    comparisons = []
    for method in dict.fromkeys(opening.method for opening in openings):
        mine = [opening for opening in openings if opening.method == method]
        known = [opening for opening in mine if opening.stamp_ns in index]
        first = min((opening.stamp_ns for opening in known), default=0)
        error = np.array(
            [
                opening.opening_m
                - truth.jump_m[index[opening.stamp_ns], 0]
                + truth.jump_m[index.get(opening.reference_stamp_ns, index[first]), 0]
                for opening in known
                if opening.valid
            ]
        )
        comparisons.append(Comparison(method, len(mine), len(error), error))
    return comparisons
