"""The parts of docs/benchmark.md about accuracy on exactly known pairs."""

from __future__ import annotations

from typing import Any

import numpy as np
from cells import DEGREES, motion, px, table

RATIOS = ("to_floor", "warp_to_floor")


def accuracy(results: dict[str, Any]) -> str:
    """Errors beside the bound."""
    shifts = sorted({row["shift_px"] for row in results["translations"]})
    by_shift = {(row["shift_px"], row["noise"]): row for row in results["translations"]}
    translations = [(f"{value:g}", *_cells(by_shift[value, 0.0]), *_cells(by_shift[value, 2.0])) for value in shifts]
    by_motion: dict[str, dict[float, dict[str, Any]]] = {}
    for row in results["warps"]:
        by_motion.setdefault(row["motion"], {})[row["noise"]] = row
    warps = [
        (name, row[0.0]["sought"], row[0.0]["failed"], *_cells(row[0.0]), *_cells(row.get(2.0)))
        for name, row in by_motion.items()
    ]
    levels = [
        (f"{row['noise']:g}", motion(row["motion"]), row["failed"], *_cells(row), px(row.get("std_px"), 4))
        for row in results["noise_levels"]
    ]
    columns = ("bias [px]", "std / bound", "error / sigma")
    both = (*columns, *(f"{name}, noise 2" for name in columns))
    known = [
        np.mean(
            [row["bias_error_px"] for row in results["translations"] if row["noise"] == noise and row["shift_px"] % 1]
        )
        for noise in (0.0, 2.0)
    ]
    return f"""## Accuracy of this engine

Default settings. Bias: the larger of the mean errors along x and y, of all subsets of {results["patterns"]} patterns;
it is
known to {known[0]:.5f} px with quantisation only and to {known[1]:.5f} px with noise. Bound: the Cramer-Rao
bound of the pair, from the exact gradients of the pattern, for the six parameters of the affine increment; where the
warp
has the Jacobian A, cov(u, v) = s^2 (1 + 1/det A) A [(sum S^T S)^-1]_uv A^T (`tools/bench/cramer_rao.py` derives it).
s^2 is
1/12 of rounding plus the noise. The ratio to it is known to about {results["to_floor_error"]:.3f}. Error / sigma:
standard
deviation of the error over the subset's own stated uncertainty; 1 is right. All seeds are 0.3 px off.

Shifts along both axes. At whole pixels with quantisation only, both images hold the same numbers and no error is left:

{table(("shift [px]", *both), translations)}

Warps. A subset counts if it can be wholly inside the target:

{table(("motion", "subsets", "lost", *both), warps)}

Noise, up to 4 % of full scale:

{table(("noise [grey levels]", "motion", "lost", *columns, "std [px]"), levels)}"""


def choice(results: dict[str, Any]) -> str:
    """Interpolants and pre-filters."""
    lines = [
        (
            DEGREES[row["degree"]],
            "" if row["gradient_smoothing_px"] is None else f"{row['gradient_smoothing_px']:g}",
            f"{row['blur_px']:g}",
            px(row["quantisation"]["bias_px"]),
            f"{row['quantisation']['to_floor']:.3f}",
            f"{row['quantisation']['warp_to_floor']:.3f}",
            px(row["noise"]["bias_px"]),
            f"{row['noise']['to_floor']:.3f}",
            f"{row['noise']['warp_to_floor']:.3f}",
        )
        for row in results["choices"]
    ]
    header = (
        "spline",
        "gradients smoothed [px]",
        "images blurred [px]",
        "bias [px]",
        "std / bound",
        "std / bound, warp",
        "bias, noise 2 [px]",
        "std / bound, noise 2",
        "std / bound, warp, noise 2",
    )
    smoothing = results["defaults"].get("gradient_smoothing_px")
    least = {
        name: _named(min(results["choices"], key=key))
        for name, key in (
            ("bias", lambda row: row["quantisation"]["bias_px"]),
            ("bias, noise", lambda row: row["noise"]["bias_px"]),
            ("spread", lambda row: max(row[noise][name] for noise in ("quantisation", "noise") for name in RATIOS)),
        )
    }
    return f"""## Interpolant and pre-filter

What the defaults are chosen from. They are the {DEGREES[results["defaults"]["spline_degree"]]} spline
{"" if smoothing is None else f"with the reference's gradients smoothed by {smoothing:g} px"} and no blur. Bias is the
largest, and the ratios are RMS, over the shifts 0.1, 0.2, 0.3, 0.4 and 0.8 px. Least bias with quantisation only:
{least["bias"]}; with noise: {least["bias, noise"]}. Smallest of the largest ratios: {least["spread"]}.

{table(header, lines)}"""


def _named(row: dict[str, Any]) -> str:
    parts = [DEGREES[row["degree"]]]
    if row["gradient_smoothing_px"] is not None:
        parts.append(f"gradients smoothed by {row['gradient_smoothing_px']:g} px")
    return ", ".join([*parts, f"images blurred by {row['blur_px']:g} px" if row["blur_px"] else "no blur"])


def _cells(row: dict[str, Any] | None) -> tuple[str, str, str]:
    if row is None or "bias_px" not in row:
        return "", "", ""
    exact = row["std_px"] < 1e-5
    ratios = ("-", "-") if exact else (f"{row['to_floor']:.3f}", f"{row['sigma_ratio']:.3f}")
    return px(row["bias_px"]), *ratios
