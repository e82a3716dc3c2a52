"""How the panel is bowed about its plane, from one ToF frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .geometry import Plane
from .plane_uncertainty import block_covariance, shared_covariance
from .settings import PlaneSettings
from .uncertainty import quadratic_terms

Array = NDArray[np.float64]

ENOUGH = 5000  # points, evenly taken, are fitted
ITERATIONS = 8  # of the weights; each brings the curvature some five times nearer
LEAST_SIGMA_M = 1e-5  # no height is believed to be better than this
WORST_CONDITION = 1e6  # of the normal matrix; some 20 for points spread evenly over a square
SECOND_ORDER = np.array([2.0, 1.0, 2.0])  # curvatures over the coefficients of x^2, x y, y^2


@dataclass(frozen=True)
class Curvature:
    """Of a surface near a plane: its height is (k_xx x^2 + 2 k_xy x y + k_yy y^2) / 2 but for a linear part.

    Height counts along the plane's normal, away from the camera, so a panel whose middle stands out to the camera has
    positive curvature. x and y are those of `tangents`.

    values: (3,), k_xx, k_xy, k_yy [1/m]. covariance: (3, 3), what other frames do not share. systematic: (3, 3), from
    the sensor's accuracy, which frames share; the two add up.
    """

    values: Array
    covariance: Array
    systematic: Array

    def turned(self, normal: Array, R: Array) -> Curvature:
        """The same in a frame reached by a rotation R, from that in which the plane has this normal (3,)."""
        G = tangents(R @ normal).T @ R @ tangents(normal)
        turn = np.column_stack([_values(G @ matrix(unit) @ G.T) for unit in np.eye(3)])
        return Curvature(turn @ self.values, turn @ self.covariance @ turn.T, turn @ self.systematic @ turn.T)


def tangents(normal: Array) -> Array:
    """Axes on a plane, (3, 2): the camera's x axis laid on it, and that 90 degrees from it about the normal."""
    x = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    x = x / np.linalg.norm(x)
    return np.column_stack([x, np.cross(normal, x)])


def matrix(values: Array) -> Array:
    """(2, 2), symmetric, from (3,)."""
    return np.array([[values[0], values[1]], [values[1], values[2]]])


def _values(curvature: Array) -> Array:
    return np.array([curvature[0, 0], curvature[0, 1], curvature[1, 1]])


def fit_curvature(points_m: Array, plane: Plane, sensor_m: Array, settings: PlaneSettings) -> Curvature | None:
    """From points (N, 3) on the panel and the plane through them, all in the camera frame [m].

    A quadratic of x and y on the plane is fitted to the heights by Tukey's biweight, as the plane was.

    Args:
        sensor_m: (3,), where the ToF sensor is.

    Returns:
        None if the points do not tell, as when they lie on a few lines.
    """
    points_m = points_m[:: max(1, len(points_m) // ENOUGH)]
    rays = points_m / points_m[:, 2:]
    height = points_m @ plane.normal + plane.d
    in_plane = plane.points(rays) @ tangents(plane.normal)
    in_plane -= in_plane.mean(axis=0)
    length = float(np.sqrt(np.mean(in_plane**2)))
    terms = quadratic_terms(in_plane / length)

    coefficients = np.zeros(6)
    for _ in range(ITERATIONS):
        residuals = height - terms @ coefficients
        near = np.abs(residuals) <= settings.max_residual_m
        sigma = max(1.4826 * float(np.median(np.abs(residuals[near]))), LEAST_SIGMA_M)
        u2 = np.square(residuals / (4.685 * sigma))
        weights = np.where(near & (u2 < 1), np.square(1 - u2), 0)
        weighted = terms * weights[:, None]
        normal_matrix = weighted.T @ terms
        if not np.linalg.cond(normal_matrix) < WORST_CONDITION:
            return None
        coefficients = np.linalg.solve(normal_matrix, weighted.T @ height)

    used = weights > 0
    terms, scores = terms[used], weighted[used] * residuals[used, None]
    slope = np.mean(((1 - u2) * (1 - 5 * u2))[used])  # as for the plane
    information = terms.T @ terms
    covariance = block_covariance(rays[used], scores, slope * information) + LEAST_SIGMA_M**2 * np.linalg.inv(
        information
    )
    from_sensor = points_m[used] - sensor_m
    distance = np.linalg.norm(from_sensor, axis=1)
    systematic = shared_covariance(terms, from_sensor @ plane.normal / distance, distance, settings)
    scale = SECOND_ORDER / length**2
    return Curvature(
        coefficients[3:] * scale,
        covariance[3:, 3:] * np.outer(scale, scale),
        systematic[3:, 3:] * np.outer(scale, scale),
    )
