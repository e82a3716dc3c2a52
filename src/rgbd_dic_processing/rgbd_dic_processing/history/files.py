"""The numbers of the comparison and of the zones as CSV, beside the run they belong to (docs/files.md)."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from .comparison import HistoryComparison, MethodComparison
from .zone_sensitivity import Misplacement

COMPARISON_NAME, SENSITIVITY_NAME = "history_comparison.csv", "zone_sensitivity.csv"
COMPARISON_HEADER = (
    "method",
    "interpolation",
    "samples",
    "delay_s",
    "u_delay_s",
    "correlation",
    "offset_mm",
    "rms_mm",
    "rms_as_is_mm",
    "sliding_offset_mm",
    "sliding_rms_mm",
    "frequency_hz",
    "amplitude_mm",
    "reference_frequency_hz",
    "reference_amplitude_mm",
    "reason",
)
SENSITIVITY_HEADER = ("method", "moved", "axis", "shift_px", "opening_mm", "slope_mm_px")


def write_comparison(methods: Sequence[MethodComparison], path: Path) -> None:
    """One row for each method and interpolation, or one with the reason."""
    rows: list[list[str]] = []
    for one in methods:
        if one.comparison is None:
            empty = [_number(math.nan)] * (len(COMPARISON_HEADER) - 4)
            rows.append([one.method, "", "0", *empty, one.reason])
        else:
            rows += [[one.method, name, *_numbers(one.comparison, name), ""] for name in one.comparison.alignments]
    _write(path, COMPARISON_HEADER, rows)


def write_sensitivity(methods: Mapping[str, Sequence[Misplacement]], path: Path) -> None:
    """One row for each method, way of giving zones, axis and shift."""
    rows = (
        [method, one.moved, one.axis, f"{shift:g}", _number(opening * 1e3), _number(one.slope * 1e3)]
        for method, misplacements in methods.items()
        for one in misplacements
        for shift, opening in zip(one.shift_px, one.opening_m, strict=True)
    )
    _write(path, SENSITIVITY_HEADER, rows)


def _numbers(comparison: HistoryComparison, name: str) -> list[str]:
    alignment, sliding = comparison.alignments[name], comparison.sliding[name]
    opening = alignment.opening
    values = (
        alignment.delay_s,
        alignment.u_delay_s,
        opening.correlation,
        opening.offset_m * 1e3,
        opening.rms_m * 1e3,
        opening.rms_as_is_m * 1e3,
        sliding.offset_m * 1e3,
        sliding.rms_m * 1e3,
        comparison.ours.dominating_hz,
        comparison.ours.dominating * 1e3,
        comparison.reference.dominating_hz,
        comparison.reference.dominating * 1e3,
    )
    return [str(opening.n), *(_number(value) for value in values)]


def _number(value: float) -> str:
    return f"{value:.6f}".replace("-0.000000", "0.000000")


def _write(path: Path, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
