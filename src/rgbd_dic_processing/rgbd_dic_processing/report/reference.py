"""alignment.png, correlation.png, spectra.png: a run's histories beside a reference (thesis Figures 4.20 to 4.27)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from ..history.alignment import Alignment
from ..history.comparison import HistoryComparison, MethodComparison
from ..history.record import History
from .drawing import BLACK, TRUTH_LINE, Picture, line_of, new_figure, plot_values, save
from .series import Series

POINTS = {"color": BLACK, "marker": "o", "markersize": 2.5, "linestyle": "none"}
SPECTRUM_END = 8.0  # times the dominating frequency that is drawn
NAMES = {"spline": "smoothing spline", "fourier": "Fourier series"}


def draw(
    series: Sequence[Series], reference: History, compared: Sequence[MethodComparison], folder: Path
) -> list[Picture]:
    """Write the figures of the methods that could be compared."""
    found = {one.method: one.comparison for one in compared if one.comparison is not None}
    shown = [one for one in series if one.method in found]
    return [
        _draw_alignment(shown, reference, found, folder / "alignment.png"),
        _draw_correlation(found, folder / "correlation.png"),
        _draw_spectra(found, folder / "spectra.png"),
    ]


def _draw_alignment(
    series: Sequence[Series], reference: History, found: dict[str, HistoryComparison], path: Path
) -> Picture:
    figure = new_figure(9.0, 7.2)
    before, after, rest = figure.subplots(3, 1, sharex=True, gridspec_kw={"height_ratios": (3, 3, 2)})
    for axes in (before, after):
        axes.plot(reference.time_s, reference.opening_m * 1e3, label="reference", zorder=3, **POINTS)
        axes.plot(reference.time_s, reference.opening_m * 1e3, **{**TRUTH_LINE, "linewidth": 2.5})
    for one in series:
        alignment, line = found[one.method].alignments["spline"], line_of(one.method)
        opening = alignment.opening
        plot_values(before, one.time_s, one.opening_mm, one.method, **line)
        plot_values(
            after,
            one.time_s + alignment.delay_s,
            one.opening_mm - opening.offset_m * 1e3,
            f"{one.method}, {alignment.delay_s:.4f} s",
            **line,
        )
        left = (alignment.ours_m - alignment.reference_m - opening.offset_m) * 1e3
        at = alignment.time_s + alignment.delay_s
        plot_values(rest, at, left, f"{one.method}, RMS {opening.rms_m * 1e3:.4f} mm", marker=".", **line)
    rest.axhline(0.0, color="0.6", linewidth=0.6, zorder=0)
    titles = (
        "as measured",
        "shifted by the delay, without the mean difference",
        "ours less the reference, at its times",
    )
    for axes, title in zip((before, after, rest), titles, strict=True):
        axes.set_title(title, loc="left")
        axes.set_ylabel("opening [mm]" if axes is not rest else "difference [mm]")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    rest.set_xlabel("time of the reference [s]")
    caption = (
        "Opening of the run and of the reference [mm]: before and after our histories are shifted to where the "
        "cross-correlation is highest, and what is left at the reference's times, ours interpolated by the smoothing "
        "spline. The mean difference is taken off, as the two may count from different zeros."
    )
    return save(figure, path, caption, "Histories of the run and of the reference before and after alignment.")


def _draw_correlation(found: dict[str, HistoryComparison], path: Path) -> Picture:
    figure = new_figure(9.0, 5.6)
    panels = figure.subplots(2, 2)
    for (whole, peak), name in zip(panels, NAMES, strict=True):
        for method, comparison in found.items():
            alignment, line = comparison.alignments[name], line_of(method)
            whole.plot(alignment.shift_s, alignment.correlation, label=method, **line)
            _draw_peak(peak, alignment, line)
        whole.set_title(f"{NAMES[name]}: all shifts", loc="left")
        peak.set_title(f"{NAMES[name]}: peak and second-order fit", loc="left")
        for axes in (whole, peak):
            axes.set_ylabel("correlation coefficient")
    for axes in panels[-1]:
        axes.set_xlabel("shift of our history [s]")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=6)
    caption = (
        "Cross-correlation of our history, shifted, with the reference, by both interpolations. Right: the values that "
        "the second-order curve is fitted to (dots), the curve, and its peak, the delay (upright line)."
    )
    return save(figure, path, caption, "Cross-correlation over the shift, and its peak with the second-order fit.")


def _draw_peak(axes: Axes, alignment: Alignment, line: dict) -> None:
    fine = np.linspace(alignment.fit_shift_s[0], alignment.fit_shift_s[-1], 100)
    axes.plot(alignment.fit_shift_s, alignment.fit_correlation, ".", markersize=4, color=line["color"])
    axes.plot(fine, np.polyval(alignment.curve, fine - alignment.delay_s), **line)
    axes.axvline(alignment.delay_s, linewidth=0.8, **{key: line[key] for key in ("color", "linestyle")})


def _draw_spectra(found: dict[str, HistoryComparison], path: Path) -> Picture:
    figure = new_figure(9.0, 3.4)
    axes = figure.subplots()
    highest = 0.0
    first = next(iter(found.values())).reference
    label = f"reference, {first.dominating_hz:.3f} Hz, {first.dominating * 1e3:.4f} mm"
    axes.plot(first.frequency_hz, first.amplitude * 1e3, label=label, **TRUTH_LINE)
    for method, comparison in found.items():
        ours, line = comparison.ours, line_of(method)
        label = f"{method}, {ours.dominating_hz:.3f} Hz, {ours.dominating * 1e3:.4f} mm"
        axes.plot(ours.frequency_hz, ours.amplitude * 1e3, label=label, **line)
        axes.plot(ours.dominating_hz, ours.dominating * 1e3, "o", markersize=4, color=line["color"])
        highest = np.nanmax([highest, ours.dominating_hz, comparison.reference.dominating_hz])
    end = max(spectrum.frequency_hz[-1] for one in found.values() for spectrum in (one.ours, one.reference))
    axes.set_xlim(0, min(SPECTRUM_END * highest, end) if highest > 0 else end)
    axes.set_ylim(bottom=0)
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("amplitude [mm]")
    axes.legend(loc="upper right")
    caption = (
        "Amplitude spectra of the openings over the time that both cover: that of the sine of each frequency that fits "
        "best under a Hann window (half of peak to peak). Dots: dominating frequencies."
    )
    return save(figure, path, caption, "Amplitude spectra of the run and of the reference.")
