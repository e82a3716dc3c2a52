"""A history between its samples, by the two functions that the thesis tries (4.4.2): `csaps` and `interpft`.

Neither invents anything where there are no samples: beyond the ends, and between samples that are farther apart than
GAP median intervals, the value is NaN.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import RgbdDicError
from scipy.interpolate import Akima1DInterpolator, CubicSpline, make_smoothing_spline
from scipy.signal import resample

Array = NDArray[np.float64]
Interpolant = Callable[[Array], Array]

GAP = 5.0
MIN_SAMPLES = 10
FINER = 8  # times as many points as samples, between which the Fourier series is followed by cubics


def spline(time_s: Array, values: Array) -> Interpolant:
    """Cubic smoothing spline with the smoothing that csaps chooses by itself.

    It minimises sum (y - f)^2 + h^3/6 * integral f''^2 over samples (n,) with the median interval h. In evenly sampled
    data it halves what is at half the Nyquist frequency, 15 Hz of 60 Hz, and leaves what is slower.

    Raises:
        RgbdDicError: if there are fewer than MIN_SAMPLES finite samples.
    """
    time_s, values = _finite(time_s, values)
    start_s, interval_s = time_s[0], float(np.median(np.diff(time_s)))
    unit_s = (time_s - start_s) / interval_s
    curve = make_smoothing_spline(unit_s, values, lam=1 / 6)
    return _within(time_s, interval_s, lambda at: curve((at - start_s) / interval_s))


def fourier(time_s: Array, values: Array) -> Interpolant:
    """Trigonometric interpolation of samples (n,), as interpft does it for even samples of a periodic history.

    The samples are neither: they are brought to even times by Akima's cubics, which also bridge gaps, and the line
    from the first to the last is taken off before and put back after, so that the period closes.

    Raises:
        RgbdDicError: if there are fewer than MIN_SAMPLES finite samples.
    """
    time_s, values = _finite(time_s, values)
    interval_s = float(np.median(np.diff(time_s)))
    count = round((time_s[-1] - time_s[0]) / interval_s) + 1
    even_s, step_s = np.linspace(time_s[0], time_s[-1], count, retstep=True)
    even = Akima1DInterpolator(time_s, values, method="makima")(even_s)
    slope = (even[-1] - even[0]) / (even_s[-1] - even_s[0])
    fine = resample((even - slope * (even_s - even_s[0]))[:-1], FINER * (count - 1))
    fine_s = even_s[0] + step_s / FINER * np.arange(len(fine) + 1)
    curve = CubicSpline(fine_s, np.append(fine, fine[0]), bc_type="periodic")
    return _within(time_s, interval_s, lambda at: curve(at) + slope * (at - even_s[0]))


INTERPOLATIONS: dict[str, Callable[[Array, Array], Interpolant]] = {"spline": spline, "fourier": fourier}


def _finite(time_s: Array, values: Array) -> tuple[Array, Array]:
    known = np.isfinite(values)
    if known.sum() < MIN_SAMPLES:
        raise RgbdDicError(f"{known.sum()} valid values in the history, at least {MIN_SAMPLES} are needed")
    return time_s[known], values[known]


def _within(time_s: Array, interval_s: float, curve: Interpolant) -> Interpolant:
    def evaluate(at: Array) -> Array:
        after = np.searchsorted(time_s, at, side="left").clip(1, len(time_s) - 1)
        near = (time_s[after] - time_s[after - 1] <= GAP * interval_s) | (at == time_s[after])
        inside = (at >= time_s[0]) & (at <= time_s[-1]) & near
        return np.where(inside, curve(np.where(inside, at, time_s[0])), np.nan)

    return evaluate
