"""The regions that the motion is estimated from (thesis 4.3.2)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from rgbd_dic_acquisition.simulator.laboratory import Laboratory

from ...core.regions import Regions
from ...core.regions_file import load_regions

REGIONS = ("near", "half", "whole")
NEAR_M = (0.12, 0.1)  # half the width and half the height of the small region around the crack
BORDER_M, BESIDE_M = 0.03, 0.02  # that the left half keeps from the edges of the panel and from the crack


def usual_region(field: str) -> str:
    """The one that a user would draw: all of the panel, as the thesis chose, or the half that is rigid."""
    return "half" if field == "rigid_half" else "whole"


def regions_of(laboratory: Laboratory, path: Path, region: str) -> Regions:
    """What regions.yaml holds, with another region for the motion.

    Args:
        region: near: around the crack; half: left of it; whole: all of the panel.
    """
    drawn = load_regions(path)
    if region == "whole":
        return replace(drawn, fixed=())
    panel = laboratory.settings.panel
    x, y = panel.width_m / 2 - BORDER_M, panel.height_m / 2 - BORDER_M
    if region == "half":
        corners = np.array([(-x, -y), (-BESIDE_M, -y), (-BESIDE_M, y), (-x, y)])
    else:
        corners = np.array(NEAR_M) * [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    return replace(drawn, fixed=(laboratory.project(*corners.T, laboratory.reference_s),))
