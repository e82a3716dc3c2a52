"""The numbers to reach, and what was reached."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...page import Criterion
from ..chapter import NOISE, Chapter3
from .statistics import ORDER, coverage, crack_slopes, opening_ratios, trend

RIGID = ("h_3d", "pc_3d")


def criteria(data: Chapter3) -> list[Criterion]:
    """All that the run can tell."""
    return [
        *_band_limited(data),
        *_disks(data),
        *(_trends(data) if len(data.series("yaw")) > 2 else ()),
        *(_cracks(data) if len(data.scope.growing) > 1 else ()),
        *(_coverage(data) if len(data.scope.references) > 2 else ()),
    ]


def _worst(data: Chapter3, pattern: str, variant: str, methods: tuple[str, ...]) -> float:
    return max(float(np.abs(data.errors(pattern, variant, method)).max()) for method in methods)


def _spread(data: Chapter3, pattern: str, variant: str, methods: tuple[str, ...]) -> float:
    return max(float(data.errors(pattern, variant, method).std(axis=1, ddof=1).max()) for method in methods)


def _largest(data: Chapter3, pattern: str, variant: str, quantity: str) -> float:
    return max(float(data.values(pattern, variant, method, quantity).max()) for method in ORDER)


def _band_limited(data: Chapter3) -> Iterator[Criterion]:
    yield Criterion(
        "unrounded, any method: farthest average of an image", _worst(data, "blobs", "unrounded", ORDER), 2e-4
    )
    yield Criterion("8 bit, `h_3d` and `pc_3d`: farthest average", _worst(data, "blobs", "8 bit", RIGID), 4e-4)
    yield Criterion("the same: spread of the averages of a reference", _spread(data, "blobs", "8 bit", RIGID), 2e-4)
    yield Criterion("8 bit, `h_pose`: farthest average", _worst(data, "blobs", "8 bit", ("h_pose",)), 1e-3)
    yield Criterion("8 bit, `h_2d`: farthest average", _worst(data, "blobs", "8 bit", ("h_2d",)), 2e-3)
    largest = _largest(data, "blobs", "8 bit", "std_dev")
    yield Criterion("8 bit, any method: largest standard deviation in an image", largest, 1.4e-3)
    ratio = max(
        result["summaries"]["8 bit"][method]["std_dev"] / result["floor_mm"]
        for (_, number), result in data.blobs.items()
        if number in data.scope.moving
        for method in ORDER
    )
    yield Criterion("the same over the quantisation floor of that pair", ratio, 1.3, unit="")


def _disks(data: Chapter3) -> Iterator[Criterion]:
    yield Criterion("disks, `h_3d` and `pc_3d`: farthest average", _worst(data, "disks", "8 bit", RIGID), 2e-3)
    yield Criterion("the same: spread of the averages of a reference", _spread(data, "disks", "8 bit", RIGID), 6e-4)
    yield Criterion("disks, `h_2d`: farthest average", _worst(data, "disks", "8 bit", ("h_2d",)), 1e-2)
    yield Criterion("disks, any method: largest RMS error", _largest(data, "disks", "8 bit", "rms_error"), 1e-2)
    largest = _largest(data, "disks", "pre-filtered", "rms_error")
    yield Criterion("the same with a pre-filter", largest, 8e-3)


def _trends(data: Chapter3) -> Iterator[Criterion]:
    for pattern in ("blobs", "disks"):
        slopes = [trend(data, pattern, "8 bit", method, series) for method in ORDER for series in ("yaw", "pitch")]
        worst = max(abs(slope.value) / slope.half_width for slope in slopes)
        words = "largest slope of the averages against yaw or pitch, over the half width of its 95 % interval"
        yield Criterion(f"{pattern}, any method: {words}", worst, 1.0, unit="")


def _cracks(data: Chapter3) -> Iterator[Criterion]:
    shots = data.scope.growing
    worst = max(float(np.abs(data.errors("blobs", "8 bit", method, shots=shots)).max()) for method in ORDER)
    yield Criterion("cracks of 2 to 50 mm, any method: farthest average", worst, 1e-3)
    slopes = [np.abs(crack_slopes(data, "blobs", "8 bit", method)).max(initial=0) for method in ORDER]
    yield Criterion("the same: largest slope of the error against the crack", float(max(slopes)), 5e-5, unit="")


def _coverage(data: Chapter3) -> Iterator[Criterion]:
    for noise in NOISE:
        share = coverage(data, noise)
        yield Criterion(f"noise {noise:g}: subsets within two sigma", share, 0.97, unit="", low=0.93)
    for noise in NOISE:
        for method in ORDER:
            share = float(np.mean(np.abs(opening_ratios(data, noise, method)) <= 2))
            yield Criterion(f"noise {noise:g}, `{method}`: openings within two sigma", share, 0.97, "", 0.93)
