"""The errors of a history: what one method measured, beside the truth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

COMPONENTS = ("opening", "sliding")


class CrackHistory:
    """Columns of a result of `measuring.measure` as arrays (N,), one value an image; mm, but maps in px.

    The reference itself, where all is zero by definition, counts for nothing.
    """

    def __init__(self, result: dict[str, Any]) -> None:
        columns = {name: np.array(values) for name, values in result.items() if name != "reasons"}
        self.time_s: Array = columns.pop("time_s")
        self.columns: dict[str, Array] = columns
        self.reasons: list[str] = result["reasons"]

    def error(self, component: str) -> Array:
        """Measured minus true."""
        return self.columns[component] - self.columns[f"true_{component}"]

    def rms(self, component: str) -> float:
        """Of the error."""
        return rms(self.error(component)[1:])

    def stated(self, component: str) -> float:
        """RMS of the standard uncertainty."""
        return rms(self.columns[f"u_{component}"][1:])

    def ratio(self, component: str) -> float:
        """RMS error over what was stated."""
        return self.rms(component) / self.stated(component)

    def map_rms(self) -> tuple[float, float]:
        """Of the map's error in x and in y [px]."""
        return rms(self.columns["map_x"][1:]), rms(self.columns["map_y"][1:])

    @property
    def valid(self) -> float:
        """Share of the images that were measured."""
        return float(np.mean(np.isfinite(self.columns["opening"])))

    @property
    def widest_s(self) -> float:
        """When the crack was widest."""
        return float(self.time_s[np.argmax(self.columns["true_opening"])])


def rms(values: Array) -> float:
    """Root of the mean square of what is known."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else np.nan
