"""Which way a crack runs on the panel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import MeasurementError

from .geometry import apply_homography
from .homography import fit_homography
from .regions import CrackZones

Array = NDArray[np.float64]
POINTS = 60  # subsets that the map from pixels to the panel is fitted to; it is exact, so a few do


class CrackLine:
    """The crack as it was drawn, among the subsets (N, 2) in raw pixels of the same image."""

    def __init__(self, camera: Camera, zones: CrackZones, centres_px: Array):
        self._ends_px = camera.undistort(zones.point + np.outer((-0.5, 0.5), zones.direction))
        self._ideal_px = camera.undistort(centres_px)
        self._latest: tuple[tuple[Array, Array], Array] | None = None  # what was asked, as most images ask the same
        self._mixed = np.random.default_rng(0).permutation(len(centres_px))  # every so-manieth could be one column

    def axes(self, position_m: Array) -> Array:
        """Rows: normal to the crack and along it, in panel coordinates (2, 2).

        The crack's direction in the raw image that it was drawn on becomes one on the panel by the homography from
        ideal pixels of that image to panel coordinates, taken where the direction was given.

        Args:
            position_m: (N, 2), of the subsets on the panel; NaN if not known.

        Raises:
            MeasurementError: if the subsets do not determine that homography.
        """
        some = self._mixed[np.isfinite(position_m[self._mixed, 0])][:POINTS]
        seen = self._ideal_px[some], position_m[some]
        if self._latest is None or not all(map(np.array_equal, self._latest[0], seen)):
            self._latest = seen, self._axes(*seen)
        return self._latest[1]

    def _axes(self, ideal_px: Array, position_m: Array) -> Array:
        to_panel = fit_homography(ideal_px, position_m, refinements=0)
        if to_panel is None:
            raise MeasurementError("the direction of the crack on the panel is undetermined: too few subsets")
        ends = apply_homography(to_panel, self._ends_px)
        along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        return np.array([[along[1], -along[0]], [along[0], along[1]]])
