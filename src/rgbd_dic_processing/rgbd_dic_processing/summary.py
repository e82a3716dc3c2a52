"""A run in one table, as it is printed, kept in summary.md and shown in the README."""

from __future__ import annotations

import numpy as np

from .core.displacement import SOLVERS
from .core.displacement_field import DisplacementField
from .core.uncertainty import Array
from .results import Truth, compare
from .runs import Run

SUMMARY_NAME = "summary.md"


def summary(run: Run, truth: Truth | None) -> str:
    """Markdown: one row a method, then the facts of the run.

    The error is that of the opening against the truth, RMS over the valid frames [mm], and the same in pixels of the
    reference image; beside it the RMS of the standard uncertainty that was stated.
    """
    columns = ("method", "frames", "valid", "RMS error [mm]", "RMS error [px]", "stated uncertainty, RMS [mm]")
    lines = [f"| {' | '.join(columns)} | widest opening [mm] |", "|---" * (len(columns) + 1) + "|"]
    errors = {c.method: c.rms_m for c in compare(run.openings, truth)} if truth is not None else {}
    for method in SOLVERS:
        mine = [opening for opening in run.openings if opening.method == method]
        if not mine:
            continue
        valid = [opening for opening in mine if opening.valid]
        rms_m = errors.get(method, np.nan)
        stated_m = np.sqrt(np.mean([o.u_opening_m**2 for o in valid])) if valid else np.nan
        widest_m = max((o.opening_m for o in valid), key=abs, default=np.nan)
        field = run.maps.get(method, {}).get("last")
        rms_px = rms_m / footprint_m(field) if field is not None else np.nan
        cells = [method, str(len(mine)), str(len(valid)), _number(rms_m * 1e3), _number(rms_px)]
        lines.append(f"| {' | '.join([*cells, _number(stated_m * 1e3), _number(widest_m * 1e3)])} |")
    facts = [f"{name}: {value}" for name, value in run.facts.items()]
    return "\n".join([*lines, "", *([", ".join(facts) + "."] if facts else [])]) + "\n"


def footprint_m(field: DisplacementField) -> float:
    """Length on the panel that a pixel of the reference image covers, mean over the subsets and directions [m]."""
    known = np.isfinite(field.position_m[:, 0])
    terms = np.column_stack([field.centres_px[known], np.ones(known.sum())])
    affine: Array = np.linalg.lstsq(terms, field.position_m[known], rcond=None)[0][:2]
    return float(np.sqrt(abs(np.linalg.det(affine))))


def _number(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.4f}"
