"""Histories beside that of the simulated 3D DIC system, aligned by cross-correlation as the thesis did (4.4.2)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rgbd_dic_acquisition.errors import RgbdDicError

from ...history.comparison import compare_histories
from ...history.record import History
from .scenes import Values, open_laboratory

INTERPOLATIONS = ("spline", "fourier")


def stereo_history(laboratory: Values) -> tuple[History, float]:
    """What the 3D DIC system measures, and how late its clock is [s]."""
    stereo = open_laboratory(laboratory).stereo
    opening_m, sliding_m, _ = stereo.measured_m.T
    return History(stereo.time_s, opening_m, sliding_m), stereo.delay_s


def compare(folder: Path, laboratory: Values, measured: dict[str, Any]) -> dict[str, Any]:
    """The delay that is found less the true one, its standard uncertainty [s], and the RMS of what is left between the
    openings and between the slidings [mm], by interpolation; or why they cannot be compared.

    Args:
        measured: a result of `measuring.measure`.
    """
    reference, delay_s = stereo_history(laboratory)
    opening_m, sliding_m = (1e-3 * np.array(measured[name]) for name in ("opening", "sliding"))
    try:
        compared = compare_histories(History(np.array(measured["time_s"]), opening_m, sliding_m), reference)
    except RgbdDicError as error:
        return {"reason": str(error)}
    found = compared.alignments["spline"]
    result = {"delay_error_s": found.delay_s - delay_s, "u_delay_s": found.u_delay_s}
    for name in INTERPOLATIONS:
        result[f"opening, {name}"] = 1e3 * compared.alignments[name].opening.rms_as_is_m
        result[f"sliding, {name}"] = 1e3 * compared.sliding[name].rms_as_is_m
    return result
