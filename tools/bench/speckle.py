"""Image pairs whose truth is known exactly: a speckle pattern given as a formula, seen under a homography."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SIGMA = 1.5  # px, of each Gaussian blob
SIZE = 1000  # px, side of the images
CELL = 3.0  # px; one blob at a random place of every cell
HEIGHT = 34.0  # grey levels, of each blob, up or down at random: the sum just fits into 8 bits
MARGIN = 480.0  # px that the pattern reaches beyond the reference, for warps that look there
QUANTISATION_VARIANCE = 1 / 12  # grey levels^2 of rounding to whole grey levels


class Speckle:
    """Sum of Gaussian blobs, evaluated at any point without interpolation.

    Its spectrum at the Nyquist frequency is exp(-(1.5 pi)^2 / 2) = 1.5e-5 of that at zero: band-limited.
    """

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng(seed)
        self._count = int(np.ceil((SIZE + 2 * MARGIN) / CELL))
        index = np.arange(self._count)
        jitter = random.uniform(0, 1, (2, self._count, self._count))
        self._x = -MARGIN + (index[None, :] + jitter[0]) * CELL
        self._y = -MARGIN + (index[:, None] + jitter[1]) * CELL
        self._height = HEIGHT * random.choice([-1.0, 1.0], (self._count, self._count))

    def __call__(self, x: Array, y: Array) -> Array:
        """Grey values at points of the pattern [px]."""
        return self._sum(x, y, gradient=False)[0]

    def with_gradient(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Grey values and their exact derivatives along x and y [grey levels / px]."""
        return self._sum(x, y, gradient=True)

    def _sum(self, x: Array, y: Array, gradient: bool) -> tuple[Array, ...]:
        column = np.floor((x + MARGIN) / CELL).astype(int)
        line = np.floor((y + MARGIN) / CELL).astype(int)
        sums = tuple(np.zeros(np.shape(x)) for _ in range(3 if gradient else 1))
        reach = range(-3, 4)  # what is left out is at least 3 cells away: 6 sigma, 1.5e-8 of a blob's height
        for i in reach:
            for j in reach:
                at = np.clip(line + i, 0, self._count - 1), np.clip(column + j, 0, self._count - 1)
                dx, dy = self._x[at] - x, self._y[at] - y
                blob = self._height[at] * np.exp((dx * dx + dy * dy) * (-0.5 / SIGMA**2))
                sums[0][...] += blob
                if gradient:
                    sums[1][...] += blob * dx / SIGMA**2
                    sums[2][...] += blob * dy / SIGMA**2
        sums[0][...] += 127.5
        if sums[0].min() < 0.5 or sums[0].max() > 254.5:
            raise ValueError("the pattern leaves the range of 8 bits: clipping would not be band-limited")
        return sums


@dataclass(frozen=True)
class Motion:
    """How the pattern of the reference lies in the target: a homography, reference -> target, px."""

    name: str
    homography: Array

    def __call__(self, points_px: Array) -> Array:
        """Where points (N, 2) of the reference are in the target."""
        return apply(self.homography, points_px)

    def gradient(self, points_px: Array) -> Array:
        """The warp's derivative (N, 2, 2) at points (N, 2) of the reference."""
        h, w = self.homography, points_px @ self.homography[2, :2] + self.homography[2, 2]
        moved = self(points_px)
        return (h[None, :2, :2] - moved[:, :, None] * h[None, None, 2, :2]) / w[:, None, None]


def apply(homography: Array, points_px: Array) -> Array:
    """Points (N, 2) -> (N, 2)."""
    moved = points_px @ homography[:, :2].T + homography[:, 2]
    return moved[:, :2] / moved[:, 2:]


def shift(x_px: float, y_px: float) -> Motion:
    """A translation."""
    homography = np.eye(3)
    homography[:2, 2] = x_px, y_px
    return Motion(f"shift ({x_px:g}, {y_px:g}) px", homography)


def about_middle(
    name: str,
    angle_deg: float = 0.0,
    scale: float = 1.0,
    shear: float = 0.0,
    perspective: tuple[float, float] = (0.0, 0.0),
    moved_px: tuple[float, float] = (0.0, 0.0),
) -> Motion:
    """Rotation, scale, shear and perspective [1/px] about the middle of the image, then a translation."""
    angle, middle = np.deg2rad(angle_deg), (SIZE - 1) / 2
    to_middle, inner, back = np.eye(3), np.eye(3), np.eye(3)
    to_middle[:2, 2] = -middle
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    inner[:2, :2] = scale * rotation @ np.array([[1, shear], [0, 1]])
    inner[2, :2] = perspective
    back[:2, 2] = middle + moved_px[0], middle + moved_px[1]
    return Motion(name, back @ inner @ to_middle)


def pixels() -> Array:
    """The pixels of an image, (SIZE * SIZE, 2) as x, y."""
    x, y = np.meshgrid(np.arange(SIZE, dtype=float), np.arange(SIZE, dtype=float))
    return np.column_stack([x.ravel(), y.ravel()])


def reference_image(speckle: Speckle) -> Array:
    """The pattern on its own grid, not rounded."""
    return speckle(*pixels().T).reshape(SIZE, SIZE)


def target_image(speckle: Speckle, motion: Motion) -> Array:
    """The moved pattern, evaluated exactly at the inverse-mapped pixels, not rounded."""
    return speckle(*apply(np.linalg.inv(motion.homography), pixels()).T).reshape(SIZE, SIZE)


def camera_image(grey: Array, noise: float = 0.0, seed: int = 0) -> NDArray[np.uint8]:
    """8 bit, with normal noise of this standard deviation [grey levels] added before rounding."""
    if noise:
        grey = grey + np.random.default_rng(seed).normal(0, noise, grey.shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)
