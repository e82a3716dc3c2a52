"""Least-squares homographies in double precision (OpenCV's findHomography rounds the points to single)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .geometry import apply_homography, homography_jacobian

Array = NDArray[np.float64]


def fit_homography(source: Array, target: Array, refinements: int = 3) -> Array | None:
    """The homography (3, 3), [2, 2] = 1, that takes source (N, 2) to target (N, 2), N >= 4; None if degenerate.

    Normalised direct linear transform (Hartley and Zisserman 2004, algorithm 4.2), then Gauss-Newton on the distances
    in the target.
    """
    to_source, to_target = _normalisation(source), _normalisation(target)
    x, u = apply_homography(to_source, source), apply_homography(to_target, target)
    homogeneous = np.column_stack([x, np.ones(len(x))])
    zero = np.zeros_like(homogeneous)
    rows = np.concatenate(
        [
            np.hstack([homogeneous, zero, -u[:, :1] * homogeneous]),
            np.hstack([zero, homogeneous, -u[:, 1:] * homogeneous]),
        ]
    )
    _, singular, vt = np.linalg.svd(np.linalg.qr(rows, mode="r"))
    if singular[7] < 1e-10 * singular[0]:
        return None
    H = vt[8].reshape(3, 3)
    H = H if (H[2] @ homogeneous.T).mean() > 0 else -H
    for _ in range(refinements):
        moved = apply_homography(H, x)
        jacobian = target_jacobian(moved).reshape(8, -1)
        residual = (u - moved).ravel()
        if not np.all(np.isfinite(residual)):
            return None
        step = np.linalg.solve(jacobian @ jacobian.T, jacobian @ residual)
        H = (np.eye(3) + np.append(step, 0).reshape(3, 3)) @ H
    H = np.linalg.inv(to_target) @ H @ to_source
    return H / H[2, 2] if np.all(np.isfinite(H)) and H[2, 2] != 0 else None


def fit_homography_beside(
    H: Array, source: Array, target: Array, modes: Array, refinements: int = 5
) -> tuple[Array, Array]:
    """The homography (3, 3) near H that takes source (N, 2) to target (N, 2) while the points may move along modes.

    Gauss-Newton on the distances in the target of H(source + sum c_k modes_k) over H and c.

    Args:
        modes: (k, N, 2), displacements of the source by each coefficient.

    Returns:
        The homography, and where it puts the displaced points (N, 2).
    """
    c = np.zeros(len(modes))
    for _ in range(refinements):
        displaced = source + np.tensordot(c, modes, 1)
        jacobian, normalise = jacobian_beside(H, displaced, modes)
        flat = jacobian.reshape(len(jacobian), -1)
        step = np.linalg.solve(flat @ flat.T, flat @ (target - apply_homography(H, displaced)).ravel())
        H, c = changed(H, normalise, step[:8]), c + step[8:]
    return H, apply_homography(H, source + np.tensordot(c, modes, 1))


def jacobian_beside(H: Array, source: Array, modes: Array) -> tuple[Array, Array]:
    """(8 + k, N, 2), how the points move in the target by the step of `changed` and by each of k modes (k, N, 2) of the
    source; and the similarity that `changed` takes."""
    target = apply_homography(H, source)
    normalise = _normalisation(target)
    by_step = target_jacobian(apply_homography(normalise, target)) / normalise[0, 0]
    return np.concatenate([by_step, np.einsum("nij,knj->kni", homography_jacobian(H, source), modes)]), normalise


def changed(H: Array, normalise: Array, step: Array) -> Array:
    """(1 + E) H, E a step (8,) in the coordinates that the similarity makes of the target's."""
    return np.linalg.inv(normalise) @ (np.eye(3) + np.append(step, 0).reshape(3, 3)) @ normalise @ H


def target_jacobian(target: Array) -> Array:
    """(8, N, 2): how each entry of E (row-major, without the last) moves the points under (1 + E) H.

    The homogeneous point p = (u, v, 1) moves by (E p)_1 - u (E p)_3 and (E p)_2 - v (E p)_3. Well conditioned for
    points normalised to unit size about the origin.
    """
    u, v = target.T
    one, zero = np.ones_like(u), np.zeros_like(u)
    along_u = np.stack([u, v, one, zero, zero, zero, -u * u, -u * v])
    along_v = np.stack([zero, zero, zero, u, v, one, -u * v, -v * v])
    return np.stack([along_u, along_v], axis=-1)


def _normalisation(points: Array) -> Array:
    """The similarity that centres points and gives them unit standard deviation."""
    centre, spread = points.mean(axis=0), points.std() + 1e-300
    return np.array([[1 / spread, 0, -centre[0] / spread], [0, 1 / spread, -centre[1] / spread], [0, 0, 1]])
