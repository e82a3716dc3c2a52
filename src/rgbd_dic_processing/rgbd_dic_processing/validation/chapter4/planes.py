"""The planes of a laboratory's ToF frames, kept."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from ...core.geometry import Plane
from ...core.plane import PanelPlane, PlaneEstimate
from ...core.regions_file import load_regions
from ...core.settings import PlaneSettings
from ...core.status import FrameStatus
from .recording import load_recording, regions_file
from .scenes import Values, open_laboratory

Settled = list[list[dict[str, Any]]]


def fit_planes(folder: Path, laboratory: Values, recording: str) -> Settled:
    """The planes that are settled when each exposure arrives, in the order of arrival, and last those of the end."""
    lab = open_laboratory(laboratory)
    planes = PanelPlane(lab.calibration, load_regions(regions_file(folder, recording)), PlaneSettings())
    tracked = load_recording(folder, recording)
    settled = []
    for exposure in lab.exposures():
        if exposure.sensor == "tof":
            depth_m = lab.depth(exposure.time_s, exposure.index).depth_m
            settled.append(planes.add_depth(exposure.stamp_ns, depth_m))
        else:
            settled.append(planes.add_view(exposure.stamp_ns, tracked.track(exposure.stamp_ns, None).view))
    return [[_plain(one) for one in estimates] for estimates in (*settled, planes.flush())]


class RecordedPlanes:
    """In the place of the pipeline's `PanelPlane`, for the same exposures in the same order."""

    def __init__(self, settled: Settled) -> None:
        self._settled = iter(settled)

    def add_depth(self, stamp_ns: int, depth_m: None, reason: str = "") -> list[PlaneEstimate]:
        return [_estimate(entry) for entry in next(self._settled)]

    def add_view(self, stamp_ns: int, homography: Any) -> list[PlaneEstimate]:
        return self.add_depth(stamp_ns, None)

    def flush(self) -> list[PlaneEstimate]:
        return self.add_depth(0, None)


def _plain(estimate: PlaneEstimate) -> dict[str, Any]:
    """As JSON can write it: arrays as lists."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: plain(one) for key, one in value.items()}
        return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value

    return plain(dataclasses.asdict(estimate))


def _estimate(entry: dict[str, Any]) -> PlaneEstimate:
    def arrays(values: dict[str, Any]) -> dict[str, Any]:
        return {key: np.array(value) if isinstance(value, list) else value for key, value in values.items()}

    plane = None if entry["plane"] is None else Plane(**arrays(entry["plane"]))
    return PlaneEstimate(**(arrays(entry) | {"status": FrameStatus(entry["status"]), "plane": plane}))
