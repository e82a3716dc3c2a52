"""The delay of a reference, by cross-correlation, and what is left between the two histories (thesis 4.4.2).

The reference is kept. Our history is shifted, interpolated, and sampled at the reference's times; the correlation
coefficient of the two is taken at each shift. A second-order curve through those around the highest one has its peak
between the steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import RgbdDicError

from .interpolation import INTERPOLATIONS, Interpolant
from .record import History
from .settings import AlignmentSettings

Array = NDArray[np.float64]

MIN_COMMON = 10  # samples of the reference within our history
CONSTANT_M = 2e-9  # a history that varies less, as a standard deviation, is constant to the digits of the CSV
SIGNIFICANT = 4.0  # standard deviations of Fisher's atanh(r), above which two histories are taken as related
SIMILAR = 0.02  # a shift whose correlation is lower by less than this explains the histories nearly as well
REFITS = 5


@dataclass(frozen=True)
class Difference:
    """What is left between our history and the reference over n common samples.

    offset_m: mean of ours less the reference's; the two may count from different zeros. rms_m: by Eq. 3.1 (n - 1),
    after the offset is removed. rms_as_is_m: the same with the offset left in.
    correlation: of the two, between -1 and 1.
    """

    n: int
    offset_m: float
    rms_m: float
    rms_as_is_m: float
    correlation: float


@dataclass(frozen=True)
class Alignment:
    """A reference beside our history.

    interpolation: `spline` or `fourier`. shift_s, correlation: (m,) all shifts tried; NaN where too few samples are
    common. fit_shift_s, fit_correlation: (p,) what the curve was fitted to; curve: (3,) its coefficients, highest
    power first, of shift - delay. delay_s: how late the reference is: its row of t + delay shows what happened
    at our t; u_delay_s: standard uncertainty. similar_s: other shifts that fit nearly as well.
    time_s, ours_m, reference_m: (n,) reference's times on our clock, and both openings there.
    """

    interpolation: str
    shift_s: Array
    correlation: Array
    fit_shift_s: Array
    fit_correlation: Array
    curve: Array
    delay_s: float
    u_delay_s: float
    similar_s: tuple[float, ...]
    time_s: Array
    ours_m: Array
    reference_m: Array
    opening: Difference


def align(
    ours: History, reference: History, interpolation: str = "spline", settings: AlignmentSettings | None = None
) -> Alignment:
    """Find the delay of the reference to below a step.

    The uncertainty is that of the shift in a least-squares fit of a + b ours(t - delay) to the reference: with r the
    peak's correlation and r'' the curve's second derivative, u^2 = (1 - r^2) / ((n - 3) r |r''|) for errors that are
    independent from one sample of the reference to the next. To it comes by how much a third-order curve would peak
    elsewhere. An error that goes along with the loading shifts the peak unseen, and is not part of it.

    Raises:
        RgbdDicError: if there is no overlap, a history is constant, the two are not alike, or the highest correlation
            is at the border of the shifts.
    """
    settings = settings or AlignmentSettings()
    known = np.isfinite(reference.opening_m)
    at, target = reference.time_s[known], reference.opening_m[known]
    curve = INTERPOLATIONS[interpolation](ours.time_s, ours.opening_m)
    if target.std() <= CONSTANT_M or np.nanstd(ours.opening_m) <= CONSTANT_M:
        raise RgbdDicError(
            f"{'the reference' if target.std() <= CONSTANT_M else 'our history'} is constant: no delay can be found"
        )
    count = round((settings.highest_s - settings.lowest_s) / settings.step_s)
    shifts = settings.lowest_s + settings.step_s * np.arange(count + 1)
    sampled = [curve(at - shift) for shift in shifts]
    common = np.array([np.isfinite(values).sum() for values in sampled])
    if common.max() < MIN_COMMON:
        raise RgbdDicError(_no_overlap(ours, at, settings, common.max()))
    enough = common >= max(MIN_COMMON, common.max() / 2)
    r = np.array([correlate(values, target) if e else np.nan for values, e in zip(sampled, enough, strict=True)])
    tried = np.flatnonzero(np.isfinite(r))
    if not len(tried):
        raise RgbdDicError("a history is constant where the two overlap: no delay can be found")
    best = int(np.nanargmax(r))
    _check_peak(r, common, best, shifts)
    if best in (tried[0], tried[-1]):
        raise RgbdDicError(
            f"the correlation is highest at the border of the shifts, {shifts[best]:+.2f} s: "
            "the delay is beyond; try other shifts"
        )
    delay, window, fit_r, polynomial, lopsided = _fit(curve, at, target, float(shifts[best]), settings)
    ours_at = curve(at - delay)
    both = np.isfinite(ours_at)
    left = difference(ours_at[both], target[both])
    r_peak = left.correlation
    noise = math.sqrt((1 - r_peak**2) / ((left.n - 3) * r_peak * -2 * polynomial[0]))
    return Alignment(
        interpolation,
        shifts,
        r,
        window,
        fit_r,
        polynomial,
        delay,
        math.hypot(noise, lopsided),
        _similar(shifts, r, best, settings.fit_s),
        at[both] - delay,
        ours_at[both],
        target[both],
        left,
    )


def correlate(ours: Array, reference: Array) -> float:
    """Correlation coefficient of two series (n,) over what both have; NaN if one is constant there."""
    both = np.isfinite(ours) & np.isfinite(reference)
    a, b = (values[both] - values[both].mean() if both.any() else values[both] for values in (ours, reference))
    norm = math.sqrt(np.sum(a**2) * np.sum(b**2))
    return float(np.clip(np.sum(a * b) / norm, -1.0, 1.0)) if norm > 0 else math.nan


def difference(ours: Array, reference: Array) -> Difference:
    """Ours less the reference (n,), over what both have; NaN if that is less than two samples."""
    error = (ours - reference)[np.isfinite(ours) & np.isfinite(reference)]
    n = len(error)
    if n < 2:
        return Difference(n, math.nan, math.nan, math.nan, math.nan)
    offset = float(error.mean())
    rms, as_is = (math.sqrt(np.sum(values**2) / (n - 1)) for values in (error - offset, error))
    return Difference(n, offset, rms, as_is, correlate(ours, reference))


def _fit(
    curve: Interpolant, at: Array, target: Array, peak_s: float, settings: AlignmentSettings
) -> tuple[float, Array, Array, Array, float]:
    """Delay, shifts and correlations of the fit, its coefficients about the delay, and by how much it may be off.

    The window is put about the peak that was found, and fitted again: its ends then weigh the same on both sides. All
    its shifts take the same samples of the reference, as a sample that comes or goes would bend the curve.
    """
    half = round(settings.fit_s / settings.step_s)
    offsets = settings.step_s * np.arange(-half, half + 1)
    for _ in range(REFITS):
        values = np.array([curve(at - peak_s - offset) for offset in offsets])
        common = np.isfinite(values).all(axis=0)
        r = np.array([correlate(row[common], target[common]) for row in values])
        if common.sum() < MIN_COMMON or not np.isfinite(r).all():
            raise RgbdDicError(f"{common.sum()} samples in common around the peak, at least {MIN_COMMON} are needed")
        a, b, c = np.polyfit(offsets, r, 2)
        away = -b / (2 * a) if a < 0 else math.inf
        if abs(away) > settings.fit_s:
            raise RgbdDicError(
                f"the correlation has no round peak near {peak_s:+.2f} s: the histories are too noisy or too short"
            )
        window = peak_s + offsets
        peak_s += away
    third = np.polyfit(offsets, r, 3)  # tells how lopsided the peak is, which the second order takes for a shift
    lopsided = -third[2] / (2 * third[1]) - away if third[1] < 0 else settings.fit_s
    return peak_s, window, r, np.array([a, 0.0, c - b**2 / (4 * a)]), lopsided


def _check_peak(r: Array, common: Array, best: int, shifts: Array) -> None:
    """Refuse histories whose correlation chance may have made."""
    score = np.arctanh(np.clip(r, -1 + 1e-15, 1 - 1e-15)) * np.sqrt(np.maximum(common - 3, 0))
    if score[best] >= SIGNIFICANT:
        return
    lowest = int(np.nanargmin(r))
    opposite = f"; at {shifts[lowest]:+.2f} s it is {r[lowest]:.2f}: is the sign of one history the other way round?"
    raise RgbdDicError(
        f"the histories are not alike: their correlation is at most {r[best]:.2f} over {common[best]} samples"
        + (opposite if score[lowest] <= -SIGNIFICANT else "")
    )


def _similar(shifts: Array, r: Array, best: int, apart_s: float) -> tuple[float, ...]:
    """Other local maxima that are nearly as high, the highest first; the border counts, as a peak may lie beyond."""
    filled = np.concatenate([[-np.inf], np.where(np.isfinite(r), r, -np.inf), [-np.inf]])
    peaks = np.flatnonzero((filled[1:-1] >= filled[:-2]) & (filled[1:-1] > filled[2:]))
    near = [i for i in peaks if abs(shifts[i] - shifts[best]) > apart_s and r[i] > r[best] - SIMILAR]
    return tuple(float(shifts[i]) for i in sorted(near, key=lambda i: -r[i]))


def _no_overlap(ours: History, at: Array, settings: AlignmentSettings, most: int) -> str:
    valid = ours.time_s[np.isfinite(ours.opening_m)]
    middle = (at[0] + at[-1] - valid[0] - valid[-1]) / 2
    return (
        f"the reference, {at[0]:.2f} to {at[-1]:.2f} s, and our valid frames, {valid[0]:.2f} to {valid[-1]:.2f} s, "
        f"have at most {most} samples in common at shifts of {settings.lowest_s:g} to {settings.highest_s:g} s, "
        f"at least {MIN_COMMON} are needed: choose shifts that bring them together, such as near {middle:.1f} s"
    )
