"""The amplitude spectrum of a history with gaps (thesis 4.4.2, Figures 4.21 and 4.22)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import RgbdDicError
from scipy.fft import next_fast_len, rfft
from scipy.signal import find_peaks

Array = NDArray[np.float64]

MIN_SAMPLES = 10
PADDED = 8  # times the length of the record: so many lines between two frequencies that it tells apart
SIDE_LOBE = 0.1  # of the amplitude at the lowest frequency; a peak below it can be a side lobe of what is slower still
FINER = 8  # parts of the median interval, to which the times are rounded


@dataclass(frozen=True)
class Spectrum:
    """frequency_hz, amplitude: (m,) from 1 over the record's length to as much below half the sampling rate, where a
    sine is no longer told from its mirror image; the amplitude is that of a sine, half its peak to peak, in the unit of
    the values. dominating_hz, dominating: the highest peak, between the lines; NaN if no peak stands out from the
    record's ends."""

    frequency_hz: Array
    amplitude: Array
    dominating_hz: float
    dominating: float


def spectrum(time_s: Array, values: Array) -> Spectrum:
    """Least-squares sines: at each frequency a + b cos + c sin is fitted to the windowed samples (n,) there are.

    The window is Hann's over the record's length. Samples that are missing (NaN) or dropped have no weight, nothing is
    put in their place, so a sine is found with its whole amplitude in spite of them. Without gaps it is the windowed
    Fourier spectrum, zero-padded to PADDED times its length and without the leakage of the mean. It is the generalised
    Lomb-Scargle periodogram of Zechmeister and Kuerster (2009) with sums taken by FFT, the times rounded to a FINER-th
    of the median interval.

    Raises:
        RgbdDicError: if fewer than MIN_SAMPLES values are finite.
    """
    known = np.isfinite(values)
    if known.sum() < MIN_SAMPLES:
        raise RgbdDicError(f"{known.sum()} valid values in the history, at least {MIN_SAMPLES} are needed")
    time_s, values = time_s[known] - time_s[known][0], values[known]
    interval_s = float(np.median(np.diff(time_s)))
    length_s = time_s[-1] + interval_s
    weight = np.sin(np.pi * (time_s + interval_s / 2) / length_s) ** 2
    weight /= weight.sum()
    values = values - weight @ values
    frequency, amplitude = _sines(time_s, weight, values, interval_s / FINER, PADDED * length_s)
    kept = (frequency >= 1 / length_s) & (frequency <= 0.5 / interval_s - 1 / length_s)
    frequency, amplitude = frequency[kept], amplitude[kept]
    peaks, _ = find_peaks(amplitude, height=SIDE_LOBE * amplitude[0])
    if not len(peaks):
        return Spectrum(frequency, amplitude, math.nan, math.nan)
    i = peaks[np.argmax(amplitude[peaks])]
    before, at, after = amplitude[i - 1 : i + 2]
    away = 0.5 * (before - after) / (before - 2 * at + after)
    return Spectrum(
        frequency,
        amplitude,
        float(frequency[i] + away * (frequency[1] - frequency[0])),
        float(at - 0.25 * (before - after) * away),
    )


def _sines(time_s: Array, weight: Array, values: Array, step_s: float, span_s: float) -> tuple[Array, Array]:
    """Frequencies of an FFT over the span, and the amplitude of the sine that fits best at each."""
    size = next_fast_len(math.ceil(span_s / step_s))
    place = np.round(time_s / step_s).astype(int)

    def transform(samples: Array) -> Array:
        return rfft(np.bincount(place, samples, size))

    mean = transform(weight)  # of exp(-iwt), weighted; the second harmonic of it gives cos^2, sin^2 and cos sin
    twice = np.interp(2 * np.arange(len(mean)), np.arange(len(mean)), mean, right=0.0)
    moment = transform(weight * values)
    c, s = mean.real, -mean.imag
    cc, ss, cs = (1 + twice.real) / 2 - c * c, (1 - twice.real) / 2 - s * s, -twice.imag / 2 - c * s
    yc, ys = moment.real, -moment.imag
    determinant = cc * ss - cs * cs
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (yc * ss - ys * cs) / determinant, (ys * cc - yc * cs) / determinant
    return np.arange(len(mean)) / (size * step_s), np.hypot(a, b)
