"""Views far beyond those of the thesis: strongly oblique, turned, near and far, with other lenses and pixels.

Each series is followed like a video, one step after another, from a reference that faces the panel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rgbd_dic_acquisition.calibration import Camera

from ...core.settings import RenewalSettings, SearchSettings
from ...core.status import FrameStatus
from ...core.tracking import SubsetTracking
from .measuring import Tracked, measure, panel_regions, track_again
from .rendering import Renderer, exposed
from .shots import CAMERA, PATTERNS, Shot, in_view
from .tasks import SETTINGS, SUBSET, summarise

CRACK_MM = 10.0
LENSES = {
    "as in the thesis": CAMERA,
    "pixels 10 % higher than wide": replace(CAMERA, fy=CAMERA.fy / 1.1),
    "k1 = -0.2": replace(CAMERA, k1=-0.2),
}


@dataclass(frozen=True)
class Series:
    """One quantity varied. values: degrees, or metres of distance."""

    name: str
    unit: str
    values: tuple[float, ...]


SERIES = (
    Series("yaw", "degrees", tuple(range(0, 46, 5))),
    Series("pitch", "degrees", tuple(range(0, 46, 5))),
    Series("roll", "degrees", tuple(range(0, 181, 15))),
    Series("distance", "m", (0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0)),
)


def shot_of(series: str, value: float, camera: Camera) -> Shot:
    """The view of a series at a value, the panel opened by CRACK_MM."""
    angles = {"yaw": 0.0, "pitch": 0.0, "roll": 0.0}
    if series == "distance":
        return Shot(1, (1.0, -1.0, 1.0), (1e3 * (1 - value), 17.5 * value, -17.5 * value), CRACK_MM, camera=camera)
    angles[series] = float(value)
    orientation = tuple(angles.values())
    return Shot(1, orientation, in_view(orientation, (0.0, 0.0), camera), CRACK_MM, camera=camera)


def follow(folder: Path, series: str, lens: str, only: list[float] | None = None) -> Any:
    """Each value's errors and standard uncertainties of the opening [mm], by method; or why it could not be measured.

    "methods" are as the product measures, "each plate" with maps from a homography of each plate (`track_again`).

    At another distance the pattern is another too: its spots are 4 px wide wherever the camera is.
    """
    camera = LENSES[lens]
    values = only or next(s.values for s in SERIES if s.name == series)
    results, tracking = [], None
    for stamp, value in enumerate(values, start=2):
        distance = value if series == "distance" else 1.0
        pattern = replace(PATTERNS["blobs"], size_m=PATTERNS["blobs"].size_m * distance)
        view = shot_of(series, value, camera)
        if tracking is None or series == "distance":
            start = Shot(0, (0.0, 0.0, 0.0), (1e3 * (1 - distance), 0.0, 0.0), camera=camera)
            tracking = SubsetTracking(
                camera, panel_regions(start, SUBSET), SETTINGS, SearchSettings(), RenewalSettings(after_frames=0)
            )
            faced = exposed(Renderer(folder).radiance(start, pattern))
            first = tracking.track(1, faced)
        image = exposed(Renderer(folder).radiance(view, pattern))
        field = tracking.track(stamp, image)
        if field.status != FrameStatus.OK:
            results.append({"value": value, "reason": field.reason})
            continue
        # `measure` joins planes by their stamps
        tracked = Tracked(tracking.reference, (first, replace(field, stamp_ns=2)))
        results.append(
            {
                "value": value,
                "found": float(np.mean(np.isfinite(field.moved_px[:, 0]))),
                "methods": summarise(measure(tracked, start, view), start, view),
                "each plate": summarise(
                    measure(track_again(tracked, start, (faced, image), SETTINGS), start, view), start, view
                ),
            }
        )
    return results
