"""The speckle on the panel of the laboratory, as large as four pixels at the working distance (thesis 4.1.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..settings import Settings, setting
from .speckle import FWHM_SIGMAS, SpeckleSettings, spot_centres

Array = NDArray[np.float64]
Image32 = NDArray[np.float32]

SAMPLES_PER_SIGMA = 4
REACH_SIGMAS = 5


@dataclass(frozen=True)
class PatternSettings(Settings):
    """The painted pattern; grey levels are those of the image at full light."""

    spot_px: float = setting(
        4.0,
        unit="px",
        low=1.0,
        high=100.0,
        doc="width of a spot's paint at half height, seen from the average distance",
    )
    spacing: float = setting(
        1.7, unit="spot widths", low=0.5, high=10.0, doc="distance between neighbouring spots before jitter"
    )
    variability: float = setting(
        0.3, low=0.0, high=0.5, doc="largest random shift of a spot, as a part of the spacing, in x and in y"
    )
    opacity: float = setting(
        3.0, low=0.01, high=10.0, doc="of the paint in the middle of a spot: exp(-opacity) shines on"
    )
    dark: float = setting(10.0, unit="grey levels", low=0.0, high=255.0, doc="matt black")
    light: float = setting(215.0, unit="grey levels", low=0.0, high=255.0, doc="the ground between spots")


class Texture:
    """Grey levels of the unloaded panel: dark + (light - dark) exp(-opacity * sum of Gaussian spots).

    The cubic spline through samples every quarter of a spot's sigma *is* the pattern. It is smooth enough for a pixel
    to be one value of it: 3e-5 of its power is above 0.45 cycles a pixel. The spots are those that are left after the
    lens and a pixel's area.
    """

    def __init__(
        self,
        settings: PatternSettings,
        pixel_m: float,
        width_m: float,
        height_m: float,
        rng: np.random.Generator,
    ) -> None:
        """pixel_m: length on the panel of a pixel, at the average distance."""
        s, size_m = settings, settings.spot_px * pixel_m
        sigma, lattice = size_m / FWHM_SIGMAS, SpeckleSettings("blobs", size_m, s.spacing, s.variability)
        self._step, self._origin = sigma / SAMPLES_PER_SIGMA, -np.array([width_m, height_m]) / 2 - 2 * sigma
        cols, rows = (np.array([width_m, height_m]) / self._step).astype(int) + 4 * SAMPLES_PER_SIGMA + 2
        density, reach = np.zeros((rows, cols)), REACH_SIGMAS * SAMPLES_PER_SIGMA
        for x, y in (spot_centres(lattice, width_m, height_m, rng).reshape(-1, 2) - self._origin) / self._step:
            left, top = max(0, int(x) - reach), max(0, int(y) - reach)
            across, down = np.arange(left, min(cols, int(x) + reach)), np.arange(top, min(rows, int(y) + reach))
            if len(across) and len(down):
                profiles = (np.exp(-0.5 * ((v - at) / SAMPLES_PER_SIGMA) ** 2) for v, at in ((down, y), (across, x)))
                density[top : top + len(down), left : left + len(across)] += np.outer(*profiles)
        grey = s.dark + (s.light - s.dark) * np.exp(-s.opacity * density)
        self._coefficients = ndimage.spline_filter(grey, order=3, mode="mirror").astype(np.float32)

    def grey(self, x_m: Array, y_m: Array) -> Image32:
        """Grey level at material coordinates [m], arrays of one shape."""
        at = [(y_m - self._origin[1]) / self._step, (x_m - self._origin[0]) / self._step]
        return ndimage.map_coordinates(self._coefficients, at, np.float32, order=3, mode="mirror", prefilter=False)
