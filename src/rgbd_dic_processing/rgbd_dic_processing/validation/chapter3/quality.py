"""How good a pattern is for DIC, before any is done."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from .measuring import panel_regions
from .rendering import Renderer, exposed
from .shots import REFERENCES
from .tasks import QUANTISATION, SUBSET

SIDE_PX = 256  # of the part that is looked at, on the left plate
HALF = 0.5  # of the autocorrelation's peak, at which the radius is taken


def pattern_quality(folder: Path, pattern: str) -> Any:
    """Of the first reference image: mean intensity gradient (Pan et al. 2010), radius at half height of the
    autocorrelation, and the standard deviation of a subset's x that rounding both images causes."""
    corner = np.ceil(panel_regions(REFERENCES[0], SUBSET).fixed[0].min(axis=0)).astype(int) + SUBSET
    image = exposed(Renderer(folder).radiance(REFERENCES[0], pattern))
    part = image[corner[1] : corner[1] + SIDE_PX, corner[0] : corner[0] + SIDE_PX].astype(float)
    down, right = np.gradient(part)
    sums = cv2.boxFilter(right**2, -1, (SUBSET, SUBSET), normalize=False)
    inner = sums[SUBSET:-SUBSET, SUBSET:-SUBSET]
    return {
        "mean_gradient": float(np.hypot(down, right).mean()),
        "contrast": float(part.std()),
        "radius_px": autocorrelation_radius(part),
        "floor_px": float(QUANTISATION * np.sqrt(2) / np.sqrt(np.median(inner))),
    }


def autocorrelation_radius(grey: NDArray[np.float64]) -> float:
    """Distance [px] at which the autocorrelation, averaged over all directions, has fallen to half."""
    spectrum = np.abs(fft.fft2(grey - grey.mean())) ** 2
    correlation = fft.fftshift(fft.ifft2(spectrum).real)
    rows, cols = np.indices(correlation.shape)
    middle = np.array(correlation.shape) // 2
    distance = np.hypot(rows - middle[0], cols - middle[1])
    rings = np.arange(0, 20, 0.25)
    profile = [correlation[np.abs(distance - ring) <= 0.5].mean() for ring in rings] / correlation.max()
    profile[0] = 1.0
    below = int(np.argmax(profile < HALF))
    return float(np.interp(-HALF, -profile[below - 1 : below + 1], rings[below - 1 : below + 1]))
