"""The result of steps 5 to 8 of the method for one frame."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .status import FrameStatus

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DisplacementField:
    """Displacement of the N subset centres in the panel frame since the reference, camera motion removed.

    keyframe_stamp_ns, subset_px: as of `SubsetField`.
    centres_px: (N, 2) raw pixels of the image that the regions were drawn on. position_m: (N, 2) panel coordinates in
        the reference; NaN for a subset that it lacks.
    displacement_m: (N, 3), NaN where invalid; z is NaN for all methods but pc_3d.
    sigma_m: (N, 3) float32, standard uncertainty from the DIC alone, NaN like the displacement.
    modes: (k, 3, 6) independent errors of the compensation of one standard deviation each: mode m displaces (x, y) by
        modes[m] @ [1, x, y, x^2, x y, y^2] metres.
    mode_sources: (k,), the `ErrorSource` of each.
    zone_coupling: (j, 2, 3), for the first j modes, which come from the DIC's noise: covariance of the mode's unit
        error with the mean error of the left and the right measuring zone [m].
    scale_uncertainty: relative standard uncertainty of all lengths, from the distance of the reference plane.
    u_step_m: pc_3d: standard uncertainty of the step in z across the crack; else NaN.
    residual_px: RMS reprojection error of the fixed region's subsets that agree with the estimated motion.
    """

    stamp_ns: int
    reference_stamp_ns: int
    keyframe_stamp_ns: int
    method: str
    status: FrameStatus
    reason: str
    depth_offset_s: float
    subset_px: float
    centres_px: NDArray[np.float32]
    position_m: Array
    displacement_m: Array
    sigma_m: NDArray[np.float32]
    modes: Array
    mode_sources: NDArray[np.uint8]
    zone_coupling: Array
    scale_uncertainty: float
    u_step_m: float
    residual_px: float
    image_received_ns: int = field(default=0, compare=False)
