"""The linear problem of h_joint: pose, shape and deformation at once, and how strained the panel is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..deformation import DeformationBasis

Array = NDArray[np.float64]

POSE = 6  # unknowns: rotation vector and translation; then those of the shape, then the deformation's
STRAIN_ITERATIONS = 30  # of the strains, in each iteration of the fit
CONCENTRATED = 6.0  # a real field puts its energy into few of the coefficients: a sixth of them is taken to carry it
LEAST_STRAIN = 1e-8  # a panel is not believed to be stiffer
POOLED = 0.1  # how much the strain of all degrees counts in that of each, as a part of its number of coefficients


@dataclass(frozen=True)
class JointProblem:
    """The linear problem of one iteration for n unknowns: step of the pose, k of the shape, q of the basis.

    normal, by_data: (n, n) and (n,), without what is believed beforehand. known: (k, k), information about the shape.
    """

    normal: Array
    by_data: Array
    known: Array
    basis: DeformationBasis

    def stiffness(self, strains: Array) -> Array:
        """(n, n), what the energy of the strains adds to `normal`."""
        added, deforming = np.zeros_like(self.normal), POSE + len(self.known)
        added[deforming:, deforming:] = np.tensordot(strains**-2, self.basis.energies, 1)
        return added

    def known_before(self) -> Array:
        """(n, n), what is known of the shape adds to it."""
        added, shape = np.zeros_like(self.normal), slice(POSE, POSE + len(self.known))
        added[shape, shape] = self.known
        return added

    def solve(self, strains: Array) -> tuple[Array, Array]:
        """Solution (n,) and covariance (n, n)."""
        covariance = np.linalg.inv(self.normal + self.stiffness(strains) + self.known_before())
        return covariance @ self.by_data, covariance

    def likely_strains(self, strains: Array) -> Array:
        """The strains (order,) that make the image most likely.

        T_d^2 is the energy of degree d over the number of its coefficients that the image determines (MacKay, Bayesian
        interpolation, Neural Computation 4 (1992) 415). Few coefficients leave it uncertain, and a degree that is not
        seen would be taken as absent; so some of the energy of all degrees is added to each.
        """
        energies, counts, deforming = self.basis.energies, self.basis.counts, POSE + len(self.known)
        for _ in range(STRAIN_ITERATIONS):
            solution, covariance = self.solve(strains)
            c = solution[deforming:]
            undetermined = np.einsum("dpq,pq->d", energies, covariance[deforming:, deforming:]) / strains**2
            determined = np.maximum(counts - undetermined, 0)
            energy = np.maximum(np.einsum("p,dpq,q->d", c, energies, c), 0)
            common, trust = energy.sum() / max(determined.sum(), 1.0), POOLED * counts
            before, strains = strains, np.sqrt((energy + trust * common) / (determined + trust))
            strains = np.maximum(strains, LEAST_STRAIN)
            if np.all(np.abs(strains - before) < 1e-2 * before):
                break
        return strains
