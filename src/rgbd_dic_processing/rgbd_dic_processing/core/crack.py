"""Step 9 of the method: the opening between the zones on the two sides of the crack (thesis 4.4.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import MeasurementError
from scipy.sparse import csr_matrix

from .crack_line import CrackLine
from .crack_uncertainty import variance_parts
from .displacement_field import DisplacementField
from .error_sources import ErrorSource
from .regions import CrackZones
from .settings import CrackSettings
from .status import FrameStatus
from .uncertainty import overlap_correlation

Array = NDArray[np.float64]
NAN3 = np.full(3, np.nan)
OUTLIER = 6.0  # distance from its zone's median, in robust standard deviations, beyond which a subset is left out


@dataclass(frozen=True)
class CrackOpening:
    """Right zone minus left zone in crack axes [m]; NaN where it is not valid or not known.

    opening: normal to the crack, positive when the sides part. sliding: along it. out_of_plane: into the wall, pc_3d
    only. magnitude: of the components that are known. u_...: standard uncertainties.
    latency_s: from the arrival of the image to the publishing of this; NaN offline.
    """

    stamp_ns: int
    reference_stamp_ns: int
    method: str
    status: FrameStatus
    reason: str
    opening_m: float
    sliding_m: float
    out_of_plane_m: float
    magnitude_m: float
    u_opening_m: float
    u_sliding_m: float
    u_out_of_plane_m: float
    u_magnitude_m: float
    n_left: int
    n_right: int
    depth_offset_s: float
    latency_s: float = math.nan

    @property
    def valid(self) -> bool:
        return self.status == FrameStatus.OK


class CrackMeasurement:
    """The mean displacement of one zone minus that of the other, with its standard uncertainty.

    The uncertainty has the DIC's part, with the correlation of overlapping subsets; the compensation's, whose modes act
    on both zones alike but for their distance; their covariance, as a zone may be in the fixed region too; and that of
    the scale.
    """

    def __init__(self, camera: Camera, zones: CrackZones, settings: CrackSettings):
        self._camera, self._zones, self._settings = camera, zones, settings
        self._layout: _ZoneLayout | None = None

    def measure(self, field: DisplacementField) -> CrackOpening:
        return self.measure_with_parts(field)[0]

    def measure_with_parts(self, field: DisplacementField) -> tuple[CrackOpening, Array]:
        """The opening, and the parts (sources,) by `ErrorSource` that the variance of it is the sum of [m^2]; NaN where
        it is not valid."""
        if field.status != FrameStatus.OK:
            return _invalid(field, field.status, field.reason)
        layout = self._zone_layout(field)
        found = np.isfinite(field.displacement_m[:, :2]).all(axis=1)
        left, right = (steady(field, zone[found[zone]]) for zone in (layout.left, layout.right))
        weights = []
        for name, zone, whole in (("left", left, layout.left), ("right", right, layout.right)):
            whole = whole[np.isfinite(field.position_m[whole]).all(axis=1)]
            least = max(self._settings.min_subsets, math.ceil(self._settings.min_found * len(whole)))
            weights.append(_weights(field.position_m[zone], field.position_m[whole]) if len(zone) >= least else None)
            if weights[-1] is None:
                return _invalid(
                    field,
                    FrameStatus.EMPTY_ZONE,
                    f"{len(zone)} of {len(whole)} subsets in the {name} zone are valid, at least {least} needed",
                    len(left),
                    len(right),
                )
        try:
            axes = layout.line.axes(field.position_m)
        except MeasurementError as error:
            return _invalid(field, FrameStatus.NOT_COMPENSATED, str(error), len(left), len(right))
        sides = [(left, weights[0]), (right, weights[1])]
        means = [shares @ field.displacement_m[zone] for zone, shares in sides]
        apart = means[1] - means[0]
        jump = np.append(axes @ apart[:2], apart[2])
        parts = variance_parts(field, layout.correlations, axes, sides, jump)
        variance = parts.sum(axis=0)
        variance[2] += field.u_step_m**2
        magnitude, u_magnitude = _magnitude(jump, variance)
        sigma = np.sqrt(variance)
        opening = CrackOpening(
            field.stamp_ns,
            field.reference_stamp_ns,
            field.method,
            FrameStatus.OK,
            "",
            *(float(value) for value in jump),
            magnitude,
            *(float(value) for value in sigma),
            u_magnitude,
            len(left),
            len(right),
            field.depth_offset_s,
        )
        return opening, parts[:, 0]

    def _zone_layout(self, field: DisplacementField) -> _ZoneLayout:
        if self._layout is None or not self._layout.fits(field):
            self._layout = _ZoneLayout.of(self._camera, self._zones, field)
        return self._layout


@dataclass(frozen=True)
class _ZoneLayout:
    """Which subsets belong to each zone, and how the errors of either correlate; the same for all frames of a
    keyframe."""

    left: NDArray[np.intp]
    right: NDArray[np.intp]
    line: CrackLine
    centres_px: Array
    subset_px: float
    correlations: tuple[csr_matrix, csr_matrix]

    @classmethod
    def of(cls, camera: Camera, zones: CrackZones, field: DisplacementField) -> _ZoneLayout:
        centres = field.centres_px.astype(float)
        line = CrackLine(camera, zones, centres)
        members = zones.members(centres)
        left, right = (overlap_correlation(centres, field.subset_px, zone) for zone in members)
        return cls(*members, line, centres, field.subset_px, (left, right))

    def fits(self, field: DisplacementField) -> bool:
        """Whether it is that of a field."""
        return self.subset_px == field.subset_px and np.array_equal(self.centres_px, field.centres_px)


def steady(field: DisplacementField, zone: NDArray[np.intp]) -> NDArray[np.intp]:
    """The subsets of a zone without those that were found in a wrong place, far from all others.

    The scale is the median distance from the median, or what the DIC states, if that is more: a deforming zone keeps
    all of its subsets.
    """
    if len(zone) < 3:
        return zone
    away = np.abs(field.displacement_m[zone, :2] - np.median(field.displacement_m[zone, :2], axis=0))
    scale = np.maximum(1.4826 * np.median(away, axis=0), field.sigma_m[zone, :2])
    return zone[(away <= OUTLIER * scale).all(axis=1)]


def _weights(found_m: Array, whole_m: Array) -> Array | None:
    """(n,) of the found subsets in the mean over a zone, for a displacement that is linear in it.

    A half-hidden zone of a panel that turns or stretches does not move like its other half: a plane through what was
    found, taken at the middle of the whole zone, does. If all were found, all weigh the same.

    Args:
        found_m, whole_m: (n, 2) and (N, 2), panel coordinates of the found subsets and of all of the zone.

    Returns:
        None if they do not determine that plane.
    """
    if len(found_m) == len(whole_m):
        return np.full(len(found_m), 1 / len(found_m))
    middle = whole_m.mean(axis=0)
    design = np.column_stack([np.ones(len(found_m)), found_m - middle])
    scaled = design / np.abs(design).max(axis=0)
    if len(found_m) < 3 or np.linalg.cond(scaled) > 1e3:
        return None
    return np.linalg.pinv(scaled)[0]


def _magnitude(jump: Array, variance: Array) -> tuple[float, float]:
    """Length of the known components of the jump, and its standard uncertainty to first order.

    At a jump of zero, where the length has no derivative, the uncertainty is that of all components together.
    """
    known = np.isfinite(jump)
    length = math.sqrt(np.sum(jump[known] ** 2))
    share = jump[known] / length if length > 0 else np.ones(known.sum())
    return length, math.sqrt(np.sum(share**2 * variance[known]))


def _invalid(
    field: DisplacementField, status: FrameStatus, reason: str, n_left: int = 0, n_right: int = 0
) -> tuple[CrackOpening, Array]:
    opening = CrackOpening(
        field.stamp_ns,
        field.reference_stamp_ns,
        field.method,
        status,
        reason,
        *NAN3,
        math.nan,
        *NAN3,
        math.nan,
        n_left,
        n_right,
        field.depth_offset_s,
    )
    return opening, np.full(len(ErrorSource), np.nan)
