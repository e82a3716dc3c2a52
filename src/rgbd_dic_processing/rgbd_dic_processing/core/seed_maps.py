"""Where each subset is expected under a homography, to second order: what the DIC's kernel starts from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera

from rgbd_dic_processing import _kernel

Array = NDArray[np.float64]

STENCIL = np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)], float)


class SeedMaps:
    """Second-order maps of each subset under distortion o homography o undistortion, for the DIC kernel.

    A first-order subset under perspective carries a second-order bias; so the kernel warps each subset by this map
    composed with the affine increment it solves for. The coefficients come from central differences over the
    subset's own extent (a 3 x 3 stencil), in the basis [1, xi, eta, xi^2, xi eta, eta^2] of offsets from the centre.

    Args:
        centres_px: (N, 2), in the raw reference. reach_px: half of a subset's side.
        threads: that make the seeds of many subsets; 0 for all cores.
    """

    def __init__(self, camera: Camera, centres_px: Array, reach_px: float, threads: int = 1):
        self._lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.k1, camera.k2], float)
        self._reach, self._threads = float(reach_px), threads
        stencil = np.empty((len(STENCIL), len(centres_px), 2))
        for axis in (0, 1):
            np.add(centres_px[:, axis], reach_px * STENCIL[:, None, axis], out=stencil[:, :, axis])
        self._ideal = np.ascontiguousarray(camera.undistort(stencil))

    def seeds(self, H: Array, chosen: NDArray[np.intp] | slice = slice(None), offsets_px: Array | None = None) -> Array:
        """(N, 2, 6) for the homography H (3, 3), reference -> image in ideal pixels; or those of the chosen subsets.

        offsets_px (N, 2), if there are any, are added to where the centres are expected.
        """
        indices = (
            None
            if isinstance(chosen, slice) and chosen == slice(None)
            else np.arange(self._ideal.shape[1], dtype=np.int32)[chosen]
        )
        H = np.ascontiguousarray(H, float)
        offsets_px = None if offsets_px is None else np.ascontiguousarray(offsets_px, float)
        return _kernel.seed_maps(self._ideal, H, self._lens, self._reach, offsets_px, indices, self._threads)
