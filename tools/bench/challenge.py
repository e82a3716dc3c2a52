"""Real and rendered images that the pyvale wheel carries, read from where it is installed, as a regression.

The star of the DIC Challenge 2.0 (Reu et al. 2022, doi 10.1007/s11340-021-00806-6; 4000 x 501 px, with noise): only
v = 0.5 cos(2 pi (y - 250) / p(x)) px, with a period p that grows from 10 px at the left edge to 300 px at the right.
A subset with an affine warp sees that field's mean over itself, so that is its truth; what the mean takes from the
field is the price of the subset's size, stated apart. The rigid plate (rendered, without noise): shifts by the frame's
number in tenths of a pixel up to frame 10, in pixels in frames 25 and 50.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import engine
import numpy as np
from comparison import COMMON, DEGREES
from engine import STEP, SUBSET
from numpy.typing import NDArray
from rgbd_dic_processing.core.correlation import Correlation, CorrelationSettings, ReferenceSubsets
from workers import BENCH_PYTHON, EngineError, Worker

AMPLITUDE_PX, MIDDLE_PX = 0.5, 250
PERIODS_PX = (10.0, 300.0)
SMOOTH = 5  # subsets in a period: where the field is smooth enough for the noise alone to be seen
SIZES = (17, 21, 31, 41)
BLUR_PX = 1.0
RIGID_PX = {4: 0.4, 8: 0.8, 10: 1.0, 25: 25.0, 50: 50.0}  # frame: shift along x; the same upwards along y


def images() -> Path | None:
    """The folder of the installed package that holds them; None if it is not installed."""
    return next(iter(sorted((BENCH_PYTHON.parents[1] / "lib").glob("python*/site-packages/pyvale/data/dic"))), None)


class Star:
    """The star's images and its truth."""

    def __init__(self, folder: Path) -> None:
        prefix = str(folder / "challenge/DIC_Challenge_Star_Noise_")
        self.reference, self.target = (cv2.imread(f"{prefix}{name}.tiff", -1) for name in ("Ref", "Def"))
        rows, columns = self.reference.shape
        y, x = np.mgrid[:rows, :columns]
        self._period = PERIODS_PX[0] + (PERIODS_PX[1] - PERIODS_PX[0]) * x / (columns - 1)
        self._v = AMPLITUDE_PX * np.cos(2 * np.pi * (y - MIDDLE_PX) / self._period)

    def region(self) -> tuple[int, int, int, int]:
        """Where subsets are laid, x0, y0, x1, y1 inclusive [px]."""
        rows, columns = self.reference.shape
        return 20, 20, columns - 21, rows - 21

    def centres(self, subset_size: int) -> NDArray[np.int32]:
        """A grid of subset centres (N, 2)."""
        x0, y0, x1, y1 = self.region()
        half = subset_size // 2
        grid = np.meshgrid(np.arange(x0 + half, x1 - half + 1, STEP), np.arange(y0 + half, y1 - half + 1, STEP))
        return np.stack(grid, axis=-1).reshape(-1, 2).astype(np.int32)

    def period_px(self, centres: NDArray) -> NDArray[np.float64]:
        """The period of the field at points."""
        return self._period[centres[:, 1], centres[:, 0]]

    def v_px(self, centres: NDArray, subset_size: int = 1) -> NDArray[np.float64]:
        """The true v, averaged over a square about each point."""
        averaged = cv2.boxFilter(self._v, -1, (subset_size, subset_size))
        return averaged[centres[:, 1], centres[:, 0]]

    def found(self, centres: NDArray, settings: CorrelationSettings, blur_px: float = 0.0) -> Correlation:
        """The subsets in the target, sought where they are in the reference."""
        pair = (self.reference, self.target)
        if blur_px:
            pair = tuple(cv2.GaussianBlur(image.astype(np.float32), (0, 0), blur_px) for image in pair)
        return _in_place(*pair, centres, settings)


def _in_place(
    reference: NDArray, target: NDArray, centres: NDArray, settings: CorrelationSettings, moved_px: float = 0.0
) -> Correlation:
    subsets = ReferenceSubsets(reference, centres, settings)
    seeds = np.zeros((len(centres), 2, 6))
    seeds[:, :, 0] = centres + np.array([moved_px, -moved_px])
    seeds[:, 0, 1] = seeds[:, 1, 2] = 1
    return subsets.correlate(subsets.target(target), seeds)


def choices(star: Star, quick: bool) -> list[dict[str, Any]]:
    """What each subset size, interpolant and pre-filter makes of the star.

    noise_px: RMS error against the field's mean over the subset where a period holds SMOOTH subsets or more.
    sigma_px: what the engine states there. rms_px: RMS error against the field itself where its period is 100 px or
    more. resolution_px: the period at which a tenth of the amplitude is lost.
    """
    filters = [{}, {"gradient_smoothing_px": 0.0}]
    cases = [(size, degree, chosen, 0.0) for size in SIZES for degree in DEGREES for chosen in filters]
    cases += [(size, 5, {}, BLUR_PX) for size in SIZES]
    rows = []
    for size, degree, chosen, blur in [case for case in cases if not quick or case[0] == SUBSET]:
        settings = engine.settings(subset_size=size, spline_degree=degree, **chosen)
        centres = star.centres(size)
        found = star.found(centres, settings, blur)
        v, period = found.y_px - centres[:, 1], star.period_px(centres)
        smooth, slow = period >= SMOOTH * size, period >= 100
        rows.append(
            {
                "subset_size": size,
                "degree": degree,
                "gradient_smoothing_px": getattr(settings, "gradient_smoothing_px", None),
                "blur_px": blur,
                "failed": float(1 - found.valid[smooth].mean()),
                "noise_px": _rms((v - star.v_px(centres, size))[smooth]),
                "sigma_px": float(np.nanmedian(found.sigma_y_px[smooth])),
                "rms_px": _rms((v - star.v_px(centres))[slow]),
                "resolution_px": _resolution(v, star.v_px(centres), period),
            }
        )
    return rows


def _resolution(v: NDArray, truth: NDArray, period: NDArray) -> float:
    """The shortest period above which at least 0.9 of the amplitude is measured throughout."""
    edges = np.arange(30, 300, 10.0)
    number = np.digitize(period, edges)
    known = [np.isfinite(v) & (number == i) for i in range(1, len(edges))]
    shares = [np.sum(v[of] * truth[of]) / np.sum(truth[of] ** 2) if of.any() else 0.0 for of in known]
    below = np.flatnonzero(np.array(shares) < 0.9)
    return float(edges[below[-1] + 1]) if len(below) else float(edges[0])


def checks(star: Star, folder: Path, scratch: Path) -> list[dict[str, Any]]:
    """Name, value and limit of each check, why the limit is what it is, and what pyvale gives where that is known.

    "failed" if a value is above its limit; a result of pyvale that cannot be had is a failed check too.
    """
    centres = star.centres(SUBSET)
    found = star.found(centres, engine.settings())
    v, u = found.y_px - centres[:, 1], found.x_px - centres[:, 0]
    truth = star.v_px(centres, SUBSET)
    smooth = star.period_px(centres) >= SMOOTH * SUBSET
    side_by_side = smooth.sum() * (STEP / SUBSET) ** 2
    expected = 3 * float(np.nanmedian(found.sigma_y_px[smooth]) / np.sqrt(side_by_side))
    errors, ratios = (v - truth)[smooth], ((v - truth) / found.sigma_y_px)[smooth]
    why = "three standard deviations of a mean over the subsets that fit side by side"
    rows = [
        _check("star: share of subsets not found", 1 - found.valid[smooth].mean(), 0.0, "none may fail"),
        _check("star: mean error of v [px]", abs(np.nanmean(errors)), expected, why),
        _check("star: mean of u, which is 0 [px]", abs(np.nanmean(u[smooth])), expected, why),
        _check("star: spread of error over sigma, less 1", abs(np.nanstd(ratios) - 1), 0.1, "sigma is right to 10 %"),
    ]
    with Worker("pyvale", COMMON, scratch) as pyvale:
        try:
            area = {"region": star.region(), "seed": (3500, MIDDLE_PX), "max_displacement_px": 10}
            theirs = _asked(pyvale, (star.reference, star.target), centres, scratch, area)
        except EngineError as error:
            rows.append(_failed("star, beside pyvale", str(error)))
        else:
            rows += _beside(v - truth, theirs[:, 1] - truth, smooth)
        rows += [_rigid(folder, frame, moved, pyvale, scratch) for frame, moved in RIGID_PX.items()]
    return rows


def _beside(ours: NDArray, theirs: NDArray, smooth: NDArray) -> list[dict[str, Any]]:
    """Errors of v (N,) [px], this engine's and pyvale's."""
    both = smooth & np.isfinite(ours) & np.isfinite(theirs)
    if not both.any():
        return [_failed("star, beside pyvale", "it gave no point of the grid")]
    ours, theirs = ours[both], theirs[both]
    return [
        _check(
            "star: mean difference from pyvale [px]",
            abs(np.mean(ours - theirs)),
            1e-3,
            "the precision to which pyvale iterates",
        ),
        _check(
            "star: RMS difference from pyvale over its RMS error",
            _rms(ours - theirs) / _rms(theirs),
            np.sqrt(0.5),
            "at least half of the variance is the images' noise, which both see",
        ),
        _check("star: RMS error of v [px]", _rms(ours), _rms(theirs), "not above that of pyvale", _rms(theirs)),
    ]


def _rigid(folder: Path, frame: int, moved: float, pyvale: Worker, scratch: Path) -> dict[str, Any]:
    pair = [cv2.imread(str(folder / f"plate_rigid/rigid_cam0_frame{i:02d}.tiff"), -1) for i in (0, frame)]
    rows, columns = pair[0].shape
    region = (40, 40, columns - 41, rows - 41)  # pyvale lays its grid from half a subset on, in steps
    half = SUBSET // 2
    grid = [np.arange(low + half, high - half + 1, STEP) for low, high in zip(region[:2], region[2:], strict=True)]
    centres = np.stack(np.meshgrid(*grid), axis=-1).reshape(-1, 2).astype(np.int32)
    centres = centres[(centres[:, 0] + moved + half < columns - 2) & (centres[:, 1] - moved - half > 2)]
    found = _in_place(*pair, centres, engine.settings(), moved + 0.3)
    truth = np.array([moved, -moved])
    away = np.column_stack([found.x_px, found.y_px]) - centres
    try:
        area = {"region": region, "seed": (columns // 2, rows // 2)}
        theirs = _asked(pyvale, pair, centres, scratch, area)
        beside = float(np.abs(np.nanmean(theirs - truth, axis=0)).max())
    except EngineError:
        beside = None
    bias = np.abs(np.mean(away - truth, axis=0)).max() if found.valid.all() else np.inf
    name, why = f"rigid plate, {moved:g} px: mean error [px]", "the rendered pattern is not band-limited"
    return _check(name, bias, 1e-3, why, beside)


def _asked(
    pyvale: Worker, pair: Sequence[NDArray], centres: NDArray, scratch: Path, area: dict[str, Any]
) -> NDArray[np.float64]:
    """u, v (N, 2) [px] that pyvale, without blur, finds at these centres; NaN where it finds none."""
    files = scratch / "their_reference.npy", scratch / "their_target.npy"
    for file, image in zip(files, pair, strict=True):
        np.save(file, image)
    found = pyvale.ask(*files, **area).arrays
    at = {(int(x), int(y)): (u, v) for x, y, u, v in zip(*(found[name] for name in "xyuv"), strict=True)}
    return np.array([at.get((int(x), int(y)), (np.nan, np.nan)) for x, y in centres])


def _failed(name: str, why: str) -> dict[str, Any]:
    return {"name": name, "value": None, "limit": None, "why": why, "pyvale": None, "failed": True}


def _check(name: str, value: float, limit: float, why: str, pyvale: float | None = None) -> dict[str, Any]:
    row = {"name": name, "value": float(value), "limit": float(limit), "why": why, "pyvale": pyvale}
    return {**row, "failed": not value <= limit}


def _rms(values: NDArray) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))
