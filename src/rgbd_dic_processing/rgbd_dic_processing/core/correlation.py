"""Subset-based DIC: where each subset of the reference lies in another image.

The warp of a subset is x' = S(A(xi)): xi is the offset from the subset's central pixel, A(xi) = (xi + u + u_x xi +
u_y eta, eta + v + v_x xi + v_y eta), with second-order terms if asked for, the increment that IC-GN solves for, and S
the seed, a quadratic map from offsets to raw pixels of the target that the caller predicts. The criterion is the ZNSSD.
"""

from __future__ import annotations

import contextlib
import dataclasses
import enum
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import ImageError, SettingsError
from rgbd_dic_acquisition.settings import Settings, setting

from rgbd_dic_processing import _kernel

Array = NDArray[np.float64]


class SubsetStatus(enum.IntEnum):
    """What became of one subset; the numbers are those of rgbd_dic_msgs/msg/SubsetStatus.msg."""

    CONVERGED = 0
    NOT_CONVERGED = 1
    """It did not come to rest within the iterations, or matched so little that it was given up."""
    LOW_CORRELATION = 2
    """Its ZNCC is below the limit, or the target is uniform there."""
    OUTSIDE_IMAGE = 3
    """A pixel of the subset, warped, leaves the image; or the subset leaves the reference, or its centre is NaN."""
    LOW_TEXTURE = 4
    """The reference subset has too little contrast, or its texture leaves a parameter undetermined."""
    DIVERGED = 5
    """The increment became implausible: a shift beyond max_shift_px or a gradient beyond 0.5."""
    SKIPPED = 6
    """Its seed holds NaN."""
    TORN = 7
    """One part of it matches and another does not, or moved differently: a crack, or something in front of it."""


@dataclasses.dataclass(frozen=True)
class CorrelationSettings(Settings):
    """Settings of the subset correlation."""

    subset_size: int = setting(31, unit="px", low=9, high=201, doc="Side of the square subsets; odd.")
    step: int = setting(10, unit="px", low=1, high=1000, doc="Distance between the centres of the grid.")
    spline_degree: int = setting(5, low=3, high=5, doc="Degree of the interpolating B-spline: 3 or 5.")
    gradient_smoothing_px: float = setting(
        0.8, unit="px", low=0.0, high=2.0, doc="Gaussian that smooths the gradients that weigh the residuals; 0: none."
    )
    increment_order: int = setting(
        1, low=1, high=2, doc="Order of the increment on top of the predicted warp: 1 affine, 2 for curved surfaces."
    )
    max_iterations: int = setting(20, low=1, high=255, doc="Iterations after which a subset is given up.")
    tolerance_px: float = setting(
        1e-4, unit="px", low=1e-6, high=0.1, doc="Converged when no edge is expected to move by more any further."
    )
    min_zncc: float = setting(0.8, low=-1.0, high=1.0, doc="Lowest correlation coefficient of a valid subset.")
    min_contrast: float = setting(
        2.0, unit="grey levels", low=0.0, doc="Lowest standard deviation of the reference subset's pixels."
    )
    max_shift_px: float = setting(10.0, unit="px", low=0.1, high=1000.0, doc="Longest way from the seed, per axis.")
    max_misfit_px: float = setting(
        0.5, unit="px", low=0.001, doc="A subset is torn if a smooth motion leaves more unexplained in it (RMS)."
    )
    threads: int = setting(0, low=0, high=1024, doc="Threads; 0 for all cores. Results do not depend on it.")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.subset_size % 2 == 0:
            raise SettingsError(f"CorrelationSettings.subset_size = {self.subset_size} px: must be odd")
        if self.step * 16 < self.subset_size:
            raise SettingsError(
                f"CorrelationSettings.step = {self.step} px: must be at least a sixteenth of subset_size = "
                f"{self.subset_size} px, as memory grows with how many subsets overlap"
            )
        if self.spline_degree == 4:
            raise SettingsError("CorrelationSettings.spline_degree = 4: must be 3 or 5")


@dataclasses.dataclass(frozen=True)
class Correlation:
    """Subsets in one image: all N of the reference, or the M that were asked for, in that order.

    x_px, y_px and their sigmas are NaN where `status` is not CONVERGED.
    """

    x_px: NDArray[np.float64]
    """(M,) px, column of the subset's point in the target image."""
    y_px: NDArray[np.float64]
    """(M,) px, its row."""
    sigma_x_px: NDArray[np.float32]
    """(M,) px, standard uncertainty of x_px, from the residual of the fit."""
    sigma_y_px: NDArray[np.float32]
    """(M,) px, standard uncertainty of y_px."""
    zncc: NDArray[np.float32]
    """(M,) zero-mean normalised cross-correlation at the last iteration; NaN where none was evaluated."""
    iterations: NDArray[np.uint8]
    """(M,) iterations done."""
    status: NDArray[np.uint8]
    """(M,) values of SubsetStatus."""

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(M,) True where the subset was found."""
        return self.status == SubsetStatus.CONVERGED

    def rows(self, chosen: NDArray) -> Correlation:
        """Some of the rows."""
        return Correlation(*(getattr(self, field.name)[chosen] for field in dataclasses.fields(self)))

    def replaced(self, indices: NDArray, other: Correlation) -> Correlation:
        """These rows taken from another correlation, in its order."""
        columns = {}
        for field in dataclasses.fields(self):
            columns[field.name] = getattr(self, field.name).copy()
            columns[field.name][indices] = getattr(other, field.name)
        return Correlation(**columns)


class Target:
    """An image made ready to be searched. Made by ReferenceSubsets.target()."""

    def __init__(self, image: NDArray, settings: CorrelationSettings) -> None:
        with _kernel_errors():
            self.spline = _kernel.Target(_pixels(image), settings.spline_degree)


class ReferenceSubsets:
    """The subsets of a reference image; all work that concerns the reference alone is done once, here."""

    def __init__(self, image: NDArray, centres_px: NDArray, settings: CorrelationSettings) -> None:
        """Prepare the subsets.

        Args:
            image: (rows, cols) grey values, of any integer or float type.
            centres_px: (N, 2) x, y of the points to be followed; each subset is centred at the pixel nearest to it.
                A subset that leaves the image, or NaN, is never found: its status is OUTSIDE_IMAGE.
            settings: of the correlation.

        Raises:
            ImageError: if the image or the centres cannot be used.
        """
        self.settings = settings
        self.centres_px: Array = np.array(centres_px, dtype=np.float64, order="C")
        if self.centres_px.ndim != 2 or self.centres_px.shape[1] != 2:
            raise ImageError(f"centres_px: expected shape (N, 2), got {self.centres_px.shape}")
        with _kernel_errors():
            self._reference = _kernel.Reference(
                _pixels(image),
                self.centres_px,
                settings.subset_size,
                settings.spline_degree,
                settings.increment_order,
                settings.gradient_smoothing_px,
                settings.threads,
            )

    def __len__(self) -> int:
        return len(self.centres_px)

    def itself(self) -> Correlation:
        """All subsets in the reference itself, where they are for certain if they have texture."""
        status = self._reference.status(self.settings.min_contrast)
        found = status == SubsetStatus.CONVERGED
        certain = np.where(found, 0, np.nan).astype(np.float32)
        x_px, y_px = np.where(found, self.centres_px.T, np.nan)
        return Correlation(x_px, y_px, certain, certain, 1 + certain, np.zeros(len(self), np.uint8), status)

    def expected_sigma_px(self, noise: float) -> NDArray[np.float32]:
        """(N, 2) standard uncertainty of x and y [px] that the texture allows; NaN for a subset without texture.

        Args:
            noise: standard deviation of the noise of a pixel, in the reference and in the image to come [grey levels].
        """
        sigma = self._reference.expected_sigma(noise)
        sigma[self.itself().status != SubsetStatus.CONVERGED] = np.nan
        return sigma

    def target(self, image: NDArray) -> Target:
        """Make (rows, cols) grey values ready for any number of calls of correlate()."""
        return Target(image, self.settings)

    def correlate(self, target: Target, seeds: NDArray, indices: NDArray | None = None) -> Correlation:
        """Find subsets in the target.

        Args:
            target: the image to search.
            seeds: (N, 2, 6) float64, for every subset of the reference the predicted x' and y' in px of the
                target as polynomials of the offset from the centre in px, basis [1, xi, eta, xi^2, xi eta,
                eta^2]; NaN: not to be tried.
            indices: (M,) the subsets to find; None for all N.
        """
        seeds = np.ascontiguousarray(seeds, dtype=np.float64)
        if seeds.shape != (len(self), 2, 6):
            raise ImageError(f"seeds: expected shape ({len(self)}, 2, 6), one seed a subset, got {seeds.shape}")
        if indices is not None:
            indices = self._checked(np.asarray(indices))
        settings = self.settings
        columns = _kernel.correlate(
            self._reference,
            target.spline,
            seeds,
            indices,
            max_iterations=settings.max_iterations,
            tolerance_px=settings.tolerance_px,
            min_zncc=settings.min_zncc,
            min_contrast=settings.min_contrast,
            max_shift_px=settings.max_shift_px,
            max_misfit_px=settings.max_misfit_px,
            threads=settings.threads,
        )
        return Correlation(*columns)

    def _checked(self, indices: NDArray) -> NDArray[np.int32]:
        if indices.ndim != 1 or (indices.size and not np.issubdtype(indices.dtype, np.integer)):
            raise ImageError(f"indices: expected integers of shape (M,), got {indices.dtype} of {indices.shape}")
        outside = (indices < 0) | (indices >= len(self))
        if outside.any():
            raise ImageError(f"indices: {int(indices[outside][0])} is not one of the {len(self)} subsets")
        return np.ascontiguousarray(indices, dtype=np.int32)


def _pixels(image: NDArray) -> NDArray:
    """The image as the kernel takes it: C-contiguous uint8 or float32."""
    image = np.asarray(image)
    if image.ndim != 2:
        raise ImageError(f"image of shape {image.shape}: expected a grey image (rows, cols)")
    if image.dtype.kind not in "uif":
        raise ImageError(f"image of {image.dtype}: expected integer or floating-point grey values")
    return np.ascontiguousarray(image, dtype=np.uint8 if image.dtype == np.uint8 else np.float32)


@contextlib.contextmanager
def _kernel_errors() -> Iterator[None]:
    """Raise as ImageError what the kernel finds wrong with an image or with the subsets in it."""
    try:
        yield
    except ValueError as error:
        raise ImageError(str(error)) from error
