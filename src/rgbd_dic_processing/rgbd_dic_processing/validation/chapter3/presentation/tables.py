"""The tables, as Markdown: name of the block in docs/validation_chapter3.md -> its text."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np

from ...page import NONE, criteria_table, table
from ..chapter import NOISE, Chapter3
from ..oblique import CRACK_MM
from ..shots import CAMERA, Shot, all_shots
from ..tasks import PREFILTER_PX, STEP, SUBSET
from ..thesis import QUANTITIES, printed_camera, printed_references
from .criteria import criteria
from .statistics import (
    ORDER,
    THESIS_METHODS,
    Slope,
    coverage,
    crack_slopes,
    opening_ratios,
    trend,
    trends_of_references,
)

NAMES = {"h_3d": "H 3D", "h_2d": "H 2D", "pc_3d": "PC 3D", "h_pose": "h_pose"}
OURS = {  # row of a table -> where its numbers are
    "disks": ("disks", "8 bit"),
    "disks, pre-filter": ("disks", "pre-filtered"),
    "band-limited": ("blobs", "8 bit"),
}
MODERATE = {"yaw": 30, "pitch": 30}  # degrees: beyond, the pattern aliases on the far side of the panel


def tables(data: Chapter3) -> dict[str, str]:
    """All that the run can fill."""
    made = {
        "criteria": criteria_table(criteria(data)),
        "calibration": _calibration(data),
        "patterns": _patterns(data),
        "poses": _poses(data),
        "thesis": _as_in_the_thesis(data),
        "calibrations": _with_calibrations(data),
        "maps": _maps(data),
        "minimal": _minimal(data),
        "budget": _budget(data),
        "coverage": _coverage(data),
        "oblique": _oblique(data),
    }
    if len(data.series("yaw")) > 2:
        made["trends"] = _trends(data)
    if len(data.scope.growing) > 1:
        made["cracks"] = _cracks(data)
    return made


def _calibration(data: Chapter3) -> str:
    values, sigma = data.calibration["values"], data.calibration["sigma"]
    printed = astuple(printed_camera())[2:6]
    rows = [("true", *(f"{value:.2f}" for value in astuple(CAMERA)[2:6]), "0", "0", NONE)]
    rows.append(("Eq. 3.1", *(f"{value:.2f}" for value in printed), NONE, NONE, "not given"))
    ours = [f"{value:.2f} ± {u:.2f}" for value, u in zip(values[:4], sigma[:4], strict=True)]
    lens = [f"{1e4 * value:.1f}e-4 ± {1e4 * u:.1f}e-4" for value, u in zip(values[4:], sigma[4:], strict=True)]
    rows.append((f"{data.scope.views} views", *ours, *lens, f"{data.calibration['rms_px']:.3f}"))
    header = ("", "f_x [px]", "f_y [px]", "c_x [px]", "c_y [px]", "k1", "k2", "reprojection error RMS [px]")
    return table(header, rows)


def _patterns(data: Chapter3) -> str:
    rows = [
        (
            {"disks": "disks", "blobs": "band-limited"}[pattern],
            f"{quality['contrast']:.1f}",
            f"{quality['mean_gradient']:.1f}",
            f"{quality['radius_px']:.2f}",
            f"{quality['floor_px']:.5f}",
        )
        for pattern, quality in data.patterns.items()
    ]
    header = (
        "pattern",
        "standard deviation [grey levels]",
        "mean intensity gradient [grey levels/px]",
        "autocorrelation radius [px]",
        "quantisation floor [px]",
    )
    return table(header, rows)


def _poses(data: Chapter3) -> str:
    def row(shot: Shot) -> tuple[str, ...]:
        angles = "[" + " ".join(f"{value:g}" for value in shot.orientation_deg) + "]"
        position = "[" + " ".join(f"{value:g}" for value in shot.position_mm) + "]"
        return f"{shot.number:04d}", shot.series, angles, position, f"{shot.crack_mm:g}"

    own = [shot for shot in all_shots().values() if shot.series != "yaw" and shot.number in data.scope.shots]
    header = ("Image number", "series", "Rotation angles (degrees)", "Vector of position (mm)", "crack [mm]")
    return table(header, map(row, own))


def _as_in_the_thesis(data: Chapter3) -> str:
    """Tables 3.3 to 3.16."""
    parts = []
    for reference in data.scope.references:
        printed = printed_references()[reference]
        rows = [("thesis", *(f"{m:.4f} ± {s:.4f}" for m, s in (printed.final[x] for x in THESIS_METHODS)), NONE)]
        for name, (pattern, variant) in OURS.items():
            cells = []
            for method in ORDER:
                averages = data.values(pattern, variant, method, references=(reference,))[0]
                cells.append(f"{averages.mean():.4f} ± {averages.std(ddof=1):.4f}")
            rows.append((name, *cells))
        parts.append(f"**Table {printed.tables[0]}**, reference {reference}: final results [mm]")
        parts.append(table(("", *(NAMES[method] for method in ORDER)), rows))
        rows = []
        for quantity, words in QUANTITIES.items():
            limits = [printed.extremes[quantity][method] for method in THESIS_METHODS]
            rows.append((f"{words}, thesis", *(f"{value:.4f}" for pair in limits for value in pair), NONE, NONE))
            for name, (pattern, variant) in OURS.items():
                values = [data.values(pattern, variant, m, quantity, references=(reference,)) for m in ORDER]
                cells = (f"{value:.4f}" for one in values for value in (one.min(), one.max()))
                rows.append((f"{words.split(' [')[0]}, {name}", *cells))
        header = ("", *(f"{NAMES[method]} {limit}" for method in ORDER for limit in ("min", "max")))
        parts.append(
            f"**Table {printed.tables[1]}**, reference {reference}: smallest and largest of the "
            f"{len(data.scope.moving)} images"
        )
        parts.append(table(header, rows))
    return "\n\n".join(parts)


def _with_calibrations(data: Chapter3) -> str:
    """The band-limited pattern with the true K, the calibrated one and the printed one."""
    rows = []
    for variant, name in (("8 bit", "true"), ("calibrated", "calibrated"), ("printed", "Eq. 3.1")):
        for method in ORDER:
            errors = data.errors("blobs", variant, method)
            inside = data.values("blobs", variant, method, "std_dev")
            cells = [f"{errors.mean():+.4f}", f"{errors.std(axis=1, ddof=1).mean():.4f}", f"{np.abs(errors).max():.4f}"]
            cells.append(f"{inside.max():.4f}")
            for crack in (10.0, 50.0):
                shots = tuple(n for n in data.scope.growing if all_shots()[n].crack_mm == crack)
                growing = data.errors("blobs", variant, method, shots=shots).mean() if shots else np.nan
                cells.append(f"{growing:+.4f}" if shots else NONE)
            rows.append((name, f"`{method}`", *cells))
    header = (
        "K",
        "method",
        "mean error [mm]",
        "spread of the averages [mm]",
        "farthest average [mm]",
        "largest std dev [mm]",
        "mean error at 10 mm, sets A and B [mm]",
        "at 50 mm [mm]",
    )
    return table(header, rows)


def _maps(data: Chapter3) -> str:
    """What the maps that predict the subsets' shapes do."""
    names = {
        ("blobs", "unrounded"): "second order, a homography for each plate; not rounded",
        ("blobs", "unrounded, one map"): "second order, one homography (what the product does); not rounded",
        ("blobs", "8 bit"): "the same, 8 bit",
        ("blobs", "affine"): "affine subsets, 8 bit",
        ("disks", "8 bit"): "disks: second order, one homography",
        ("disks", "affine"): "disks: affine subsets",
    }
    rows = []
    for (pattern, variant), words in names.items():
        cells = []
        for method in ORDER:
            errors = data.errors(pattern, variant, method)
            cells.append(f"{np.abs(errors).max():.5f} ({errors.std(axis=1, ddof=1).mean():.5f})")
        rows.append((words, *cells, f"{data.values(pattern, variant, 'h_3d', 'std_dev').max():.5f}"))
    header = ("maps of the subsets", *(f"`{method}`" for method in ORDER), "largest std dev, `h_3d`")
    return table(header, rows)


def _trends(data: Chapter3) -> str:
    def cell(slope: Slope) -> str:
        text = f"{1e6 * slope.value:+.0f} ± {1e6 * slope.half_width:.0f}"
        return text if slope.is_zero else f"**{text}**"

    rows = []
    for pattern, variant, name in (
        ("disks", "affine", "disks, affine subsets"),
        ("disks", "8 bit", "disks"),
        ("blobs", "affine", "band-limited, affine subsets"),
        ("blobs", "8 bit", "band-limited"),
    ):
        for method in ORDER:
            signed = [cell(trend(data, pattern, variant, method, series)) for series in ("yaw", "pitch", "roll")]
            sizes = [cell(trend(data, pattern, variant, method, series, True)) for series in ("yaw", "pitch")]
            each = [s for x in ("yaw", "pitch") for s in trends_of_references(data, pattern, variant, method, x)]
            rows.append((name, f"`{method}`", *signed, *sizes, f"{sum(not s.is_zero for s in each)} of {len(each)}"))
    header = (
        "images",
        "method",
        "yaw [1e-6 mm/degree]",
        "pitch",
        "roll",
        "size of yaw",
        "size of pitch",
        "references with a slope against yaw or pitch",
    )
    return table(header, rows)


def _cracks(data: Chapter3) -> str:
    rows = []
    for pattern, variant, name in (
        ("blobs", "8 bit", "band-limited"),
        ("disks", "8 bit", "disks"),
        ("blobs", "calibrated", "band-limited, calibrated K"),
        ("blobs", "printed", "band-limited, K of Eq. 3.1"),
    ):
        for method in ORDER:
            cells = []
            for crack in sorted({all_shots()[n].crack_mm for n in data.scope.growing}):
                shots = tuple(n for n in data.scope.growing if all_shots()[n].crack_mm == crack)
                errors = data.errors(pattern, variant, method, shots=shots)
                cells.append(f"{errors.mean():+.4f} ({np.abs(errors).max():.4f})")
            slopes = crack_slopes(data, pattern, variant, method)
            slope = f"{1e5 * slopes.mean():+.1f}e-5 ({1e5 * np.abs(slopes).max():.1f}e-5)" if len(slopes) else NONE
            rows.append((name, f"`{method}`", *cells, slope))
    cracks = sorted({all_shots()[n].crack_mm for n in data.scope.growing})
    return table(("images", "method", *(f"{crack:g} mm" for crack in cracks), "slope"), rows)


def _minimal(data: Chapter3) -> str:
    """h_2d from four subsets, not refined, against the estimator in use."""
    rows = []
    for reference in data.scope.references:
        samples = np.array([data.blobs[reference, shot]["minimal"] for shot in data.scope.moving])
        used = data.errors("blobs", "8 bit", "h_2d", references=(reference,))
        printed = printed_references()[reference]
        low, high = printed.extremes["average"]["h_2d"]
        rows.append(
            (
                str(reference),
                f"{np.nanmedian(np.abs(samples)):.4f}",
                f"{np.nanpercentile(np.abs(samples), 95):.4f}",
                f"{np.nanmean(np.abs(samples) > 0.08):.0%}",
                f"{np.abs(used).max():.4f}",
                f"{max(abs(low - 10), abs(high - 10)):.4f}",
            )
        )
    header = (
        "reference",
        "four subsets: median error [mm]",
        "95th percentile [mm]",
        "beyond 0.08 mm",
        "`h_2d`: farthest average [mm]",
        "thesis: farthest average [mm]",
    )
    return table(header, rows)


def _budget(data: Chapter3) -> str:
    rows = []
    for (pattern, number), parts in data.budget.items():
        shot = all_shots()[number]
        causes = [parts["rounding"], parts["aliasing"], parts["interpolation"]]
        view = f"{shot.series} {shot.angle_deg:g}°"
        cells = [f"{1e3 * value:.2f}" for value in (*causes, float(np.sqrt(np.sum(np.square(causes)))), parts["total"])]
        name = {"disks": "disks", "blobs": "band-limited"}[pattern]
        rows.append((name, view, *cells, f"{1e3 * parts['pre-filtered']:.2f}" if pattern == "disks" else NONE))
    header = (
        "pattern",
        "image",
        "rounding [1e-3 mm]",
        "aliasing",
        "interpolation and the pixels' area",
        "together",
        "measured",
        f"measured with a pre-filter of {PREFILTER_PX:g} px",
    )
    return table(header, rows)


def _coverage(data: Chapter3) -> str:
    rows = []
    for noise in NOISE:
        cells = [f"{coverage(data, noise):.1%}"]
        for method in ORDER:
            ratios = opening_ratios(data, noise, method)
            cells.append(f"{np.mean(np.abs(ratios) <= 2):.1%} ({np.sqrt(np.mean(ratios**2)):.2f})")
        rows.append((f"{noise:g}", *cells, str(len(ratios))))
    header = ("noise [grey levels]", "subsets", *(f"openings, `{method}`" for method in ORDER), "openings each")
    return table(header, rows)


def _oblique(data: Chapter3) -> str:
    """Far beyond the thesis: the farthest openings, with maps of one homography and with those of each plate."""
    rows = []
    for (series, lens), steps in data.oblique.items():
        limit = MODERATE.get(series, np.inf)
        for words, chosen in ((f"to {limit:g}", [s for s in steps if s["value"] <= limit]), ("all", steps)):
            if words == "all" and not np.isfinite(limit):
                continue
            cells = []
            for maps in ("methods", "each plate"):
                for method in ("h_3d", "h_pose"):
                    errors = [abs(s[maps][method]["opening"] - CRACK_MM) for s in chosen if maps in s]
                    cells.append(f"{max(errors):.4f}" if errors else NONE)
            lost = sum("methods" not in s for s in chosen)
            rows.append((lens, series, "all" if not np.isfinite(limit) else words, *cells, str(lost)))
    header = (
        "lens",
        "series",
        "values",
        "`h_3d` [mm]",
        "`h_pose` [mm]",
        "`h_3d`, maps of each plate [mm]",
        "`h_pose`, maps of each plate [mm]",
        "images not found",
    )
    return table(header, rows)


def facts(data: Chapter3) -> str:
    """One line on what was run."""
    return (
        f"{len(data.scope.references)} references, {len(data.scope.shots)} images, two patterns; subsets of "
        f"{SUBSET} x {SUBSET} px every {STEP} px; ideal depth."
    )
