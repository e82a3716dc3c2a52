"""What the simulated 3D DIC system measures in a laboratory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .scenes import Values, open_laboratory


def history(folder: Path, laboratory: Values) -> dict[str, Any]:
    """Its times [s], openings and slidings [mm], and the delay of its clock [s]."""
    stereo = open_laboratory(laboratory).stereo
    opening, sliding, _ = (1e3 * stereo.measured_m).T.tolist()
    return {"time_s": stereo.time_s.tolist(), "opening": opening, "sliding": sliding, "delay_s": stereo.delay_s}
