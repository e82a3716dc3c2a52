"""The subsets as material of the panel: laid once, on the image that the regions are drawn on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from scipy.spatial import cKDTree

from .correlation import CorrelationSettings
from .geometry import apply_homography
from .regions import Regions

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class SubsetLayout:
    """N subsets and the regions that they belong to, whatever image they are seen in later.

    drawn_px: (N, 2), their centres in the raw image that the regions are drawn on, row by row.

    Raises:
        RegionsError: if the regions do not fit the image.
    """

    def __init__(self, camera: Camera, regions: Regions, settings: CorrelationSettings):
        grid = (camera.width, camera.height, settings.subset_size, settings.step)
        drawn = regions.check(*grid).astype(float)
        self.drawn_px = drawn[np.isfinite(camera.undistort(drawn)).all(axis=1)]
        self._camera, self._half_px = camera, settings.subset_size // 2
        self._regions = {"panel": np.ones(len(self), bool), "fixed region": regions.fixed_members(self.drawn_px)}
        if regions.crack is not None:
            left, right = regions.crack.members(self.drawn_px)
            self._regions |= {"left zone": self.mask(left), "right zone": self.mask(right)}

    def __len__(self) -> int:
        return len(self.drawn_px)

    def mask(self, chosen: NDArray[np.intp]) -> Mask:
        """(N,) of some of the subsets."""
        return np.isin(np.arange(len(self)), chosen)

    def places(self, homography: Array, moved_px: Array) -> Array:
        """Where all subsets (N, 2) lie in a raw image, of which moved_px (N, 2) tells some, NaN for the rest.

        These are put where the homography (image of the drawing -> image, ideal pixels) does, and moved from there by
        as much as the nearest one that is known.
        """
        expected = self._camera.distort(apply_homography(homography, self._camera.undistort(self.drawn_px)))
        away = moved_px - expected
        known = np.isfinite(away).all(axis=1)
        nearest = cKDTree(self.drawn_px[known]).query(self.drawn_px)[1]
        return expected + away[known][nearest]

    def whole(self, places_px: Array) -> Mask:
        """(N,) whether a subset centred there lies wholly in the image; not if that is NaN."""
        last = np.array([self._camera.width, self._camera.height]) - 1 - self._half_px
        pixels = np.rint(places_px)
        return ((pixels >= self._half_px) & (pixels <= last)).all(axis=1)

    def shortage(self, chosen: Mask, least: float, of: Mask | None = None) -> str:
        """The first region of which fewer subsets are chosen (N,) than this share, as "20% of the left zone's subsets".

        Args:
            of: (N,) the subsets that count; None for all.

        Returns:
            Empty if there is none.
        """
        for name, members in self._regions.items():
            counted = members if of is None else members & of
            share = np.mean(chosen[counted]) if counted.any() else 0.0
            if share < least:
                return f"{share:.0%} of the {name}'s subsets"
        return ""
