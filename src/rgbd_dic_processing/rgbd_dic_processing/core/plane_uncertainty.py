"""How sure the plane of one ToF frame is: noise that is not white over the image, and the sensor's accuracy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .geometry import Plane
from .settings import PlaneSettings

Array = NDArray[np.float64]

BLOCKS = 10  # along each side of the points' extent in the ToF image
DISTANCES = 40  # bins over the points' range of distance
ENOUGH = 4000  # points, evenly taken, show how the distances lie on the plane
CONSTANT = 0.5  # part of the systematic variance that does not change with the distance


def block_covariance(rays: Array, scores: Array, information: Array) -> Array:
    """Covariance (p, p) of an M-estimate of p parameters from the scatter of its scores' sums over blocks of the image.

    The sandwich B^-1 (sum_b s_b s_b^T) B^-1, s_b the sum of the scores in a block (Liang and Zeger 1986): neighbours
    may depend on each other in any way, blocks do not. So it holds spots and pixels' own offsets, which are larger than
    a pixel or stay where they are, and the bow of the panel or the bend that the sensor gives it.

    Args:
        rays: (N, 3), z = 1.
        scores: (N, p), of each point; they sum to zero at the estimate.
        information: (p, p), the derivative B of that sum with respect to pi.
    """
    x, y = rays[:, 0], rays[:, 1]
    low_x, low_y = x.min(), y.min()
    column = ((x - low_x) * (BLOCKS / max(x.max() - low_x, 1e-12))).astype(np.intp)
    row = ((y - low_y) * (BLOCKS / max(y.max() - low_y, 1e-12))).astype(np.intp)
    block = np.minimum(row, BLOCKS - 1) * BLOCKS + np.minimum(column, BLOCKS - 1)
    sums = np.column_stack([np.bincount(block, score, BLOCKS**2) for score in scores.T])
    used = np.count_nonzero(np.bincount(block))
    halved = np.linalg.solve(information, sums.T)
    return halved @ halved.T * (used / max(used - len(information), 1))


def systematic_covariance(points_m: Array, plane: Plane, sensor_m: Array, settings: PlaneSettings) -> Array:
    """Covariance (4, 4) of (n_x, n_y, n_z, d) from an error of the sensor along its rays that depends on the distance.

    What is common to all points shifts the plane; what changes over a panel that is seen at a slant, or reaches far to
    the side, tilts it.

    Args:
        points_m: (N, 3), those that the plane rests on.
        sensor_m: (3,), where the sensor is.
    """
    points_m = points_m[:: max(1, len(points_m) // ENOUGH)]
    pi, z = plane.inverse_depth, points_m[:, 2]
    scaled = points_m * z[:, None]  # z^2 times the ray: the fit weighs a point's 1/z by z^4
    rays = points_m - sensor_m
    distance = np.sqrt(np.einsum("ij,ij->i", rays, rays))
    gain = -z * (rays @ pi) / distance  # an error e along the ray moves 1/z by gain e / z^2 across the plane
    return Plane.from_inverse_depth(pi, shared_covariance(scaled, gain, distance, settings)).covariance


def shared_covariance(design: Array, gain: Array, distance: Array, settings: PlaneSettings) -> Array:
    """Covariance (p, p) of parameters fitted to points, from an error of the sensor that depends on the distance.

    The error is a random function of the distance, of standard deviation `systematic_m`: half of its variance is
    constant, half has the correlation exp(-D^2 / 2 L^2) with the length `systematic_length_m`.

    Args:
        design: (N, p), of the least squares.
        gain: (N,), what a unit of error along the ray adds to the fitted value.
        distance: (N,), of the points from the sensor [m].
    """
    low = distance.min()
    width = max((distance.max() - low) / DISTANCES, 1e-12)
    bins = np.minimum((distance - low) / width, DISTANCES - 1).astype(np.intp)
    sums = np.column_stack([np.bincount(bins, part * gain, DISTANCES) for part in design.T])
    at = width * np.arange(DISTANCES)
    changing = np.exp(-0.5 * np.square((at[:, None] - at) / settings.systematic_length_m))
    correlation = CONSTANT + (1 - CONSTANT) * changing
    errors = np.linalg.solve(design.T @ design, sums.T) * settings.systematic_m
    return errors @ correlation @ errors.T
