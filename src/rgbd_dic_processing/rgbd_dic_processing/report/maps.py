"""maps_<method>_<label>.png: displacement of every subset on the reference image (thesis Figures 2.5 and 2.6)."""

from __future__ import annotations

from pathlib import Path

import matplotlib.patheffects as effects
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from ..core.displacement import DisplacementField
from ..core.regions import Regions
from ..runs import Run
from .drawing import ORANGE, SKY, VERMILION, Picture, method_order, new_figure, save

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LABEL_WORDS = {"widest": "at the widest opening", "last": "at the last valid frame"}
NARROWEST_MM = 1e-4  # a colour range is not narrower, so that rounding does not look like displacement
AXIS_WORDS = ("x, along the panel's x axis", "y, along the panel's y axis", "z, into the wall")


def draw(run: Run, regions: Regions | None, folder: Path) -> list[Picture]:
    """Write a figure for each field of the run, but one only where two labels of a method mean the same frame."""
    pictures = []
    start_ns = min((opening.stamp_ns for opening in run.openings), default=None)
    if start_ns is None and run.reference is not None:
        start_ns = run.reference.stamp_ns
    for method in method_order(run.maps):
        drawn: dict[int, str] = {}
        for label, field in run.maps[method].items():
            drawn[field.stamp_ns] = (
                f"{drawn[field.stamp_ns]}, which is also {words}"
                if (words := LABEL_WORDS.get(label, label)) and field.stamp_ns in drawn
                else words
            )
        labels = {field.stamp_ns: label for label, field in reversed(run.maps[method].items())}
        for stamp_ns, label in reversed(labels.items()):
            when = "" if start_ns is None else f", {(stamp_ns - start_ns) * 1e-9:.2f} s after the first frame"
            path = folder / f"maps_{method}_{label}.png"
            pictures.append(
                _draw_field(run, regions, run.maps[method][label], drawn[stamp_ns] + when, path)
            )
    return pictures
