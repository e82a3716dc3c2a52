"""The variance of a crack opening, part by part."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from .displacement_field import DisplacementField
from .error_sources import ErrorSource
from .uncertainty import overlaps, quadratic_terms

Array = NDArray[np.float64]
Side = tuple[NDArray[np.intp], Array]  # indices (n,) of the subsets of a zone, and what each weighs in its mean


def variance_parts(
    field: DisplacementField, correlations: Sequence[csr_matrix], axes: Array, sides: Sequence[Side], jump_m: Array
) -> Array:
    """Variances (sources, 3) of the jump between two zones along the crack axes [m^2], row by `ErrorSource`; they add
    up to its variance. NaN for z where it is not known.

    Args:
        correlations: `overlap_correlation` (N, N) of all subsets of either zone.
        axes: rows (2, 2), normal to the crack and along it, in panel coordinates.
        sides: the left and the right zone.
        jump_m: (3,), in crack axes.
    """
    parts = np.zeros((len(ErrorSource), 3))
    for correlation, (zone, shares) in zip(correlations, sides, strict=True):
        squared = field.sigma_m[zone].astype(float) ** 2
        component = np.sqrt(np.column_stack([squared[:, :2] @ (axes**2).T, squared[:, 2]])) * shares[:, None]
        parts[ErrorSource.SUBSETS] += overlaps(correlation, zone, component)
    terms = [shares @ quadratic_terms(field.position_m[zone]) for zone, shares in sides]
    modes = _in_crack_axes(field.modes @ (terms[1] - terms[0]), axes)
    np.add.at(parts, field.mode_sources.astype(int), modes**2)
    coupled = _in_crack_axes(field.zone_coupling[:, 1] - field.zone_coupling[:, 0], axes)
    overlap = 2 * np.sum(modes[: len(coupled)] * coupled, axis=0)
    parts[ErrorSource.OVERLAP] = np.maximum(overlap, -parts.sum(axis=0))
    parts[ErrorSource.SCALE] = (jump_m * field.scale_uncertainty) ** 2
    return parts


def _in_crack_axes(vectors: Array, axes: Array) -> Array:
    """Panel vectors (k, 3) -> normal, along, into the wall (k, 3)."""
    return np.column_stack([vectors[:, :2] @ axes.T, vectors[:, 2]])
