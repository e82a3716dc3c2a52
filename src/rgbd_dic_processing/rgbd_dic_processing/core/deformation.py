"""A low-order in-plane deformation of the panel on each side of its crack, and how far it can pass for motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class DeformationBasis:
    """In-plane displacements of points of the panel, linear in q coefficients.

    Each side has all polynomials up to an order but for its rigid motion. If both sides are there, the last three
    coefficients are how far they part, slide and turn against each other. Half of it is given to each, as nothing tells
    which side moved: so the motion's axes are those that turn with the crack. Points are in panel coordinates from an
    origin on the crack, x across it.

    modes: (q, M, 2), displacement of the points used [m] by each coefficient.
    energies: (order, q, q), c^T energies[d - 1] c is the mean over the points of e_xx^2 + e_yy^2 + 2 e_xy^2 by the
        polynomials of degree d: the strain energy of a plate of unit stiffness without Poisson's effect.
    counts: (order,), how many coefficients have each degree.
    """

    modes: Array
    energies: Array
    counts: NDArray[np.intp]

    @classmethod
    def of(cls, points_m: Array, right: Mask, order: int) -> DeformationBasis:
        """Of points (M, 2) [m], of which some lie right of the crack (M,)."""
        length = float(np.sqrt(np.mean(np.sum(points_m**2, axis=1))))
        scaled = points_m / length
        sides = [side for side in (~right, right) if side.any()]
        fields, gradients, degrees = _polynomials(scaled, order)
        modes = [np.where(side[:, None], field, 0) for side in sides for field in fields]
        strains = [np.where(side[:, None], _strain(gradient), 0) for side in sides for gradient in gradients]
        stiff = len(strains)
        if len(sides) == 2:
            modes += [*parting_modes(scaled, right)]
        strain, degree = np.reshape(strains, (stiff, -1)), np.tile(degrees, len(sides))
        gram = strain @ strain.T / len(points_m)
        energies = np.zeros((order, len(modes), len(modes)))
        for group, energy in enumerate(energies, start=1):
            energy[:stiff, :stiff] = np.where(np.logical_and.outer(degree == group, degree == group), gram, 0)
        return cls(length * np.array(modes), energies, np.bincount(degree)[1:])


def parting_modes(points: Array, right: Mask) -> Array:
    """(3, M, 2): the sides of the crack apart, along each other, and turned against each other; half of it for each."""
    x, y = points.T
    half = np.where(right, 0.5, -0.5)
    zero = np.zeros_like(x)
    return np.array([np.stack([half, zero], 1), np.stack([zero, half], 1), np.stack([-half * y, half * x], 1)])


def _polynomials(points: Array, order: int) -> tuple[list[Array], list[Array], list[int]]:
    """Displacements (M, 2), their gradients du_i / dx_j (M, 2, 2), and their degrees; no rigid motion is among them."""
    x, y = points.T
    zero, one = np.zeros_like(x), np.ones_like(x)
    # of first order only the strains: along x, along y, and shear without a turn
    fields = [np.stack([x, zero], 1), np.stack([zero, y], 1), np.stack([y, x], 1)]
    gradients = [_gradient(one, zero, zero, zero), _gradient(zero, zero, zero, one), _gradient(zero, one, one, zero)]
    degrees = [1, 1, 1]
    for degree in range(2, order + 1):
        for i in range(degree + 1):
            power = x ** (degree - i) * y**i
            by_x = (degree - i) * x ** max(degree - i - 1, 0) * y**i
            by_y = i * x ** (degree - i) * y ** max(i - 1, 0)
            fields += [np.stack([power, zero], 1), np.stack([zero, power], 1)]
            gradients += [_gradient(by_x, by_y, zero, zero), _gradient(zero, zero, by_x, by_y)]
            degrees += [degree, degree]
    return fields, gradients, degrees


def _gradient(xx: Array, xy: Array, yx: Array, yy: Array) -> Array:
    """(M, 2, 2) from du/dx, du/dy, dv/dx, dv/dy (M,)."""
    return np.stack([np.stack([xx, xy], 1), np.stack([yx, yy], 1)], 1)


def _strain(gradient: Array) -> Array:
    """(M, 3): e_xx, e_yy, sqrt(2) e_xy, whose squares add up to the energy."""
    return np.stack(
        [gradient[:, 0, 0], gradient[:, 1, 1], (gradient[:, 0, 1] + gradient[:, 1, 0]) / np.sqrt(2)], axis=1
    )
