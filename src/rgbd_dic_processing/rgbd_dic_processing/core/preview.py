"""Before a flight: which subsets the regions give on an image, how well each can be found, and what cannot work."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import RegionsError

from .correlation import ReferenceSubsets
from .layout import SubsetLayout
from .regions import CrackZones, Regions
from .settings import ProcessingSettings
from .tracking import LEAST_TEXTURED
from .uncertainty import overlap_correlation

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
POOR_PX = 0.05  # expected uncertainty above which a subset counts as poor


@dataclass(frozen=True)
class Preview:
    """The N subsets that the regions give on an image, and what is wrong with them.

    centres_px: (N, 2). sigma_px: (N, 2), standard uncertainty of x and y [px] that the texture allows at the given
    noise; NaN for a subset without texture. fixed, left, right: (N,), members of the fixed region and of the zones.
    u_opening_px: standard uncertainty of one opening from the subsets' noise alone [px]; NaN without zones.
    refusals: why nothing can be measured so; empty if it can. warnings: what is likely to make it worse.
    """

    centres_px: Array
    sigma_px: NDArray[np.float32]
    fixed: Mask
    left: Mask
    right: Mask
    u_opening_px: float
    refusals: tuple[str, ...]
    warnings: tuple[str, ...]


def preview(
    image: NDArray[np.uint8], camera: Camera, regions: Regions, settings: ProcessingSettings, noise: float
) -> Preview:
    """Look at the regions on an image (rows, cols) of this camera.

    Args:
        noise: standard deviation of the noise of a pixel, the same in every image [grey levels].
    """
    refusals = _crossing_outlines(regions)
    try:
        layout = SubsetLayout(camera, regions, settings.correlation)
    except RegionsError as error:
        refusals.append(str(error))
        try:  # the panel's subsets are worth seeing even so
            regions = Regions(regions.panel, (), None, None)
            layout = SubsetLayout(camera, regions, settings.correlation)
        except RegionsError:
            nobody = np.zeros(0, bool)
            return Preview(np.zeros((0, 2)), np.zeros((0, 2), np.float32), *[nobody] * 3, math.nan, tuple(refusals), ())
    centres = layout.drawn_px
    sigma = ReferenceSubsets(image, centres, settings.correlation).expected_sigma_px(noise)
    textured = np.isfinite(sigma).all(axis=1)
    fixed = regions.fixed_members(centres)
    left, right = left_right = np.zeros((2, len(centres)), bool)
    u_opening, warnings = math.nan, []
    if not refusals and (short := layout.shortage(textured, LEAST_TEXTURED)):
        refusals.append(f"only {short} have texture, at least {LEAST_TEXTURED:.0%} needed: light, focus or speckle?")
    if regions.crack is not None:
        for zone, members in zip(left_right, regions.crack.members(centres), strict=True):
            zone[members] = True
        refusals += _misplaced(regions, centres, fixed, left, right)
        for name, zone in (("left", left), ("right", right)):
            if (found := int((zone & textured).sum())) < settings.crack.min_subsets:
                refusals.append(
                    f"crack: {name} zone has {found} subsets with texture, at least {settings.crack.min_subsets} "
                    "(crack.min_subsets) needed: make it larger"
                )
        warnings += _torn(regions.crack, centres, left, right, settings.correlation.subset_size)
        u_opening = _u_opening(regions.crack, centres, sigma, (left & textured, right & textured), settings)
    if (found := int((fixed & textured).sum())) < settings.compensation.min_subsets:
        refusals.append(
            f"fixed region has {found} subsets with texture, at least {settings.compensation.min_subsets} "
            "(compensation.min_subsets) needed: make it larger"
        )
    if not refusals:
        warnings += _advice(regions, sigma, {"fixed region": fixed, "left zone": left, "right zone": right})
    return Preview(centres, sigma, fixed, left, right, u_opening, tuple(refusals), tuple(warnings))


def crossing_edges(polygon_px: Array) -> tuple[int, int] | None:
    """The first two edges of a polygon (M, 2) that cross, by the number of the corner that each starts at; or None."""
    start = np.asarray(polygon_px, float)
    end = np.roll(start, -1, axis=0)

    def side(a: Array, b: Array, p: Array) -> float:
        return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])

    for i in range(len(start)):
        for j in range(i + 2, len(start)):
            if (j + 1) % len(start) == i:
                continue
            of_j = side(start[i], end[i], start[j]) * side(start[i], end[i], end[j])
            of_i = side(start[j], end[j], start[i]) * side(start[j], end[j], end[i])
            if of_i < 0 and of_j < 0:
                return i, j
    return None


def _crossing_outlines(regions: Regions) -> list[str]:
    outlines = {"panel": regions.panel}
    outlines |= {f"fixed[{i}]": polygon for i, polygon in enumerate(regions.fixed)}
    outlines |= {f"fixed_holes[{i}]": polygon for i, polygon in enumerate(regions.fixed_holes)}
    return [
        f"{name}: its outline crosses itself, after corners {edges[0] + 1} and {edges[1] + 1}: move a corner"
        for name, polygon in outlines.items()
        if (edges := crossing_edges(polygon))
    ]


def _misplaced(regions: Regions, centres_px: Array, fixed: Mask, left: Mask, right: Mask) -> list[str]:
    """What lies on a side of the crack's line where it cannot be."""
    refusals, beyond = [], regions.crack.beyond(centres_px)
    if regions.fixed and (sides := ((fixed & ~beyond).sum(), (fixed & beyond).sum())) and min(sides) > 0:
        refusals.append(
            f"fixed region lies across the crack line: {sides[0]} of its subsets on the left, {sides[1]} on the right. "
            "The two sides move apart; draw it on one side, or cut the other side out"
        )
    for name, wrong in (("left", left & beyond), ("right", right & ~beyond)):
        if wrong.any():
            refusals.append(
                f"crack: {name} zone reaches across the crack line with {wrong.sum()} subsets: move it to its own side"
            )
    return refusals


def _torn(crack: CrackZones, centres_px: Array, left: Mask, right: Mask, subset_px: int) -> list[str]:
    """Subsets of a zone that hold a piece of the other side."""
    reach = subset_px / 2 * np.abs(crack.normal).sum()
    near = np.abs((centres_px - crack.point) @ crack.normal) < reach
    return [
        f"crack: {(zone & near).sum()} of {zone.sum()} subsets of the {name} zone reach over the crack line and are "
        f"likely to be lost: leave a gap of {reach:.0f} px"
        for name, zone in (("left", left), ("right", right))
        if (zone & near).any()
    ]


def _advice(regions: Regions, sigma_px: Array, members: dict[str, Mask]) -> list[str]:
    warnings = []
    if regions.crack is None:
        warnings.append("no measuring zones: there will be displacement maps, but no crack opening")
    if not regions.fixed:
        warnings.append("no fixed region: all of the panel is taken as rigid, which suits the method h_joint alone")
    for name, mask in members.items():
        poor = ~(sigma_px[mask] <= POOR_PX).all(axis=1)
        if mask.any() and poor.mean() > 0.25:
            warnings.append(
                f"{poor.mean():.0%} of the {name}'s subsets have little texture: more light, focus, speckle?"
            )
    return warnings


def _u_opening(
    crack: CrackZones,
    centres_px: Array,
    sigma_px: Array,
    zones: tuple[Mask, Mask],
    settings: ProcessingSettings,
) -> float:
    """Standard uncertainty [px] of the difference of the zones' mean displacements normal to the crack."""
    variance = 0.0
    for zone in zones:
        if not zone.any():
            return math.nan
        along_normal = np.sqrt(sigma_px[zone].astype(float) ** 2 @ crack.normal**2)
        shared = overlap_correlation(centres_px[zone], settings.correlation.subset_size)
        variance += along_normal @ (shared @ along_normal) / zone.sum() ** 2
    return math.sqrt(variance)
