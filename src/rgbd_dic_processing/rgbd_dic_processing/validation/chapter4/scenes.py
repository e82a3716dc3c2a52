"""The laboratories that are measured, and the regions that the motion is estimated from (thesis 4.3.2)."""

from __future__ import annotations

import functools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.simulator.laboratory import Laboratory, laboratory_settings

from ...core.regions import Regions, load_regions

Array = NDArray[np.float64]
Values = dict[str, Any]

FIELDS = ("beam", "plate", "rigid_half")
REGIONS = ("near", "half", "whole")
NEAR_M = (0.12, 0.1)  # half the width and half the height of the small region around the crack
BORDER_M, BESIDE_M = 0.03, 0.02  # that the regions keep from the edges of the panel and, on one half, from the crack


def laboratory_values(field: str, seed: int, duration_s: float, scale: float = 1.0) -> Values:
    """What differs from the preset `laboratory`."""
    return {"seed": seed, "duration_s": duration_s, "camera": {"scale": scale}, "deformation": {"field": field}}


def open_laboratory(values: Values) -> Laboratory:
    """The laboratory with these settings; the last one stays open."""
    return _open(json.dumps(values, sort_keys=True))


@functools.lru_cache(maxsize=1)
def _open(values: str) -> Laboratory:
    return Laboratory(laboratory_settings("laboratory", json.loads(values)))


def usual_region(field: str) -> str:
    """The region of `Laboratory.regions`: all of the panel, or the half that is rigid."""
    return "half" if field == "rigid_half" else "whole"


def regions_of(laboratory: Laboratory, path: Path, region: str) -> Regions:
    """What regions.yaml holds, with another region for the motion: near the crack, the left half, all of the panel."""
    drawn = load_regions(path)
    if region == "whole":
        return replace(drawn, fixed=())
    panel = laboratory.settings.panel
    x, y = panel.width_m / 2 - BORDER_M, panel.height_m / 2 - BORDER_M
    left, right, low, high = (-x, -BESIDE_M, -y, y) if region == "half" else (-NEAR_M[0], NEAR_M[0], -NEAR_M[1], NEAR_M[1])
    corners = np.array([(left, low), (right, low), (right, high), (left, high)])
    return replace(drawn, fixed=(laboratory.project(*corners.T, laboratory.reference_s),))
