"""Patterns: the grey level of the panel as a function of material coordinates.

Two kinds of speckle: `blobs`, a band-limited sum of Gaussian spots that can be interpolated to the last digits, and
`disks`, sharp dark dots; the thesis' have a spacing of 1.3 widths and a variability of 0.49. And the checkerboard.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..settings import Settings, setting

Array = NDArray[np.float64]

SAMPLES_PER_SIGMA = 8  # of the texture that holds the blobs
REACH_SIGMAS = 6  # where a blob is cut off: 1e-8 of its height
FWHM_SIGMAS = 2.0 * np.sqrt(2.0 * np.log(2.0))


class Pattern(Protocol):
    """What a panel can be painted with."""

    def grey(self, x_m: Array, y_m: Array) -> Array:
        """Grey level (0-255, not rounded) at material coordinates [m], arrays of one shape."""


@runtime_checkable
class FlatPattern(Pattern, Protocol):
    """A pattern of flat parts with sharp borders, most of which need not be supersampled."""

    def uniform(self, x_m: Array, y_m: Array, reach_m: Array) -> NDArray[np.bool_]:
        """Where the grey level is certainly the same up to a distance [m]; arrays of one shape."""


@dataclass(frozen=True)
class SpeckleSettings(Settings):
    """The pattern painted on the panel."""

    kind: str = setting("blobs", doc="blobs (band-limited) or disks (sharp)", choices=("blobs", "disks"))
    size_m: float = setting(0.006, unit="m", low=1e-5, high=1.0, doc="width of a spot: at half height, or of a disk")
    spacing: float = setting(
        1.45, unit="spot widths", low=0.5, high=10.0, doc="distance between neighbouring spots before jitter"
    )
    variability: float = setting(
        0.35, low=0.0, high=0.5, doc="largest random shift of a spot, as a part of the spacing, in x and in y"
    )
    dark: float = setting(20.0, unit="grey levels", low=0.0, high=255.0, doc="the darkest point")
    light: float = setting(225.0, unit="grey levels", low=0.0, high=255.0, doc="the ground between spots")


def spot_centres(settings: SpeckleSettings, width_m: float, height_m: float, rng: np.random.Generator) -> Array:
    """Centres (rows, cols, 2), x and y [m], of spots on a jittered lattice that covers the panel and more."""
    spacing = settings.size_m * settings.spacing
    cols, rows = (int(np.ceil(side / spacing / 2)) * 2 + 3 for side in (width_m, height_m))
    lattice = np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1).astype(float)
    lattice -= np.array([cols - 1, rows - 1]) / 2
    jitter = rng.uniform(-settings.variability, settings.variability, lattice.shape)
    return spacing * (lattice + jitter)


class BlobPattern:
    """light - (light - dark) * sum of Gaussians / its maximum; a texture for cubic splines."""

    def __init__(self, settings: SpeckleSettings, width_m: float, height_m: float, rng: np.random.Generator) -> None:
        self._settings = settings
        self._sigma = settings.size_m / FWHM_SIGMAS
        self.step_m = self._sigma / SAMPLES_PER_SIGMA
        self.centres_m = spot_centres(settings, width_m, height_m, rng).reshape(-1, 2)
        self._origin = -np.array([width_m, height_m]) / 2 - 4 * self._sigma
        cols, rows = (np.array([width_m, height_m]) / self.step_m).astype(int) + 8 * SAMPLES_PER_SIGMA + 1
        density = np.zeros((rows, cols))
        for x, y in self.centres_m:
            columns, across = self._profile(x - self._origin[0], cols)
            lines, down = self._profile(y - self._origin[1], rows)
            density[lines, columns] += down[:, None] * across[None, :]
        self._peak = density.max()
        grey = settings.light - (settings.light - settings.dark) * density / self._peak
        self._coefficients = ndimage.spline_filter(grey, order=3, mode="mirror")

    def grey(self, x_m: Array, y_m: Array) -> Array:
        row = (y_m - self._origin[1]) / self.step_m
        col = (x_m - self._origin[0]) / self.step_m
        return ndimage.map_coordinates(self._coefficients, [row, col], order=3, mode="mirror", prefilter=False)

    def grey_exact(self, x_m: Array, y_m: Array) -> Array:
        """The same from the formula, spot by spot: slow; what the texture is tested against."""
        x, y = np.asarray(x_m, float)[..., None], np.asarray(y_m, float)[..., None]
        squared = (x - self.centres_m[:, 0]) ** 2 + (y - self.centres_m[:, 1]) ** 2
        density = np.exp(-0.5 * squared / self._sigma**2).sum(axis=-1)
        s = self._settings
        return s.light - (s.light - s.dark) * density / self._peak

    def _profile(self, position: float, count: int) -> tuple[slice, Array]:
        centre, reach = position / self.step_m, REACH_SIGMAS * SAMPLES_PER_SIGMA
        first, last = max(0, int(np.ceil(centre - reach))), min(count, int(np.floor(centre + reach)) + 1)
        samples = np.arange(first, max(first, last))
        return slice(first, max(first, last)), np.exp(-0.5 * ((samples - centre) / SAMPLES_PER_SIGMA) ** 2)


class DiskPattern:
    """Sharp dark disks; exact at every point, so that only supersampling smooths their edges."""

    def __init__(self, settings: SpeckleSettings, width_m: float, height_m: float, rng: np.random.Generator) -> None:
        self._settings = settings
        self._centres = spot_centres(settings, width_m, height_m, rng)

    def grey(self, x_m: Array, y_m: Array) -> Array:
        inside = np.zeros(np.shape(x_m), bool)
        for squared in self._squared_distances(x_m, y_m):
            inside |= squared <= (self._settings.size_m / 2) ** 2
        return np.where(inside, self._settings.dark, self._settings.light)

    def uniform(self, x_m: Array, y_m: Array, reach_m: Array) -> NDArray[np.bool_]:
        radius = self._settings.size_m / 2
        covered, free = np.zeros(np.shape(x_m), bool), np.ones(np.shape(x_m), bool)
        for squared in self._squared_distances(x_m, y_m):
            covered |= squared < np.maximum(radius - reach_m, 0) ** 2
            free &= squared > (radius + reach_m) ** 2
        return covered | free

    def _squared_distances(self, x_m: Array, y_m: Array) -> Iterator[Array]:
        """From the centres of the nine spots of the lattice around each point [m^2]; no other is within a spacing."""
        rows, cols = self._centres.shape[:2]
        spacing = self._settings.size_m * self._settings.spacing
        col = np.clip(np.rint(x_m / spacing + (cols - 1) / 2).astype(int), 1, cols - 2)
        row = np.clip(np.rint(y_m / spacing + (rows - 1) / 2).astype(int), 1, rows - 2)
        index = row * cols + col
        x, y = np.ascontiguousarray(self._centres.reshape(-1, 2).T)
        for down in (-cols, 0, cols):
            for right in (-1, 0, 1):
                at = index + (down + right)
                yield (x_m - x[at]) ** 2 + (y_m - y[at]) ** 2


class Checkerboard:
    """Squares, dark and light, centred on the origin; a light margin around them."""

    def __init__(self, rows: int, cols: int, square_m: float, dark: float = 20.0, light: float = 225.0) -> None:
        self.rows, self.cols, self.square_m = rows, cols, square_m
        self._dark, self._light = dark, light

    @property
    def corners_m(self) -> Array:
        """The inner corners ((rows - 1) (cols - 1), 2), row by row [m]."""
        col, row = np.meshgrid(np.arange(1, self.cols), np.arange(1, self.rows))
        return self.square_m * (np.stack([col, row], axis=-1).reshape(-1, 2) - np.array([self.cols, self.rows]) / 2)

    def grey(self, x_m: Array, y_m: Array) -> Array:
        col, row = self._cells(x_m, y_m)
        on_board = (col >= 0) & (col < self.cols) & (row >= 0) & (row < self.rows)
        dark = on_board & ((np.floor(col) + np.floor(row)) % 2 == 0)
        return np.where(dark, self._dark, self._light)

    def uniform(self, x_m: Array, y_m: Array, reach_m: Array) -> NDArray[np.bool_]:
        col, row = self._cells(x_m, y_m)
        reach = reach_m / self.square_m
        return (np.abs(col - np.rint(col)) > reach) & (np.abs(row - np.rint(row)) > reach)

    def _cells(self, x_m: Array, y_m: Array) -> tuple[Array, Array]:
        return x_m / self.square_m + self.cols / 2, y_m / self.square_m + self.rows / 2


def make_pattern(settings: SpeckleSettings, width_m: float, height_m: float, rng: np.random.Generator) -> Pattern:
    """The pattern of a panel that is centred on the origin."""
    kind = BlobPattern if settings.kind == "blobs" else DiskPattern
    return kind(settings, width_m, height_m, rng)
