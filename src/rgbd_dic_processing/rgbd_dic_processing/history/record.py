"""A history of an opening: of a run, or from the CSV of a reference."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import RgbdDicError

from ..core.crack import CrackOpening

Array = NDArray[np.float64]
MIN_ROWS = 10  # with an opening, in a reference


@dataclass(frozen=True)
class History:
    """time_s: (n,) increasing [s]. opening_m, sliding_m: (n,) [m], NaN where there is no valid value."""

    time_s: Array
    opening_m: Array
    sliding_m: Array

    def between(self, first_s: float, last_s: float) -> History:
        """The part from one time to another, both included."""
        kept = (self.time_s >= first_s) & (self.time_s <= last_s)
        return History(self.time_s[kept], self.opening_m[kept], self.sliding_m[kept])


def start_of(openings: Sequence[CrackOpening]) -> int:
    """Stamp of the first image of a run, at which its time is 0 [ns].

    Raises:
        RgbdDicError: if there is none.
    """
    if not openings:
        raise RgbdDicError("this run has no crack opening to compare: its regions need the entry crack")
    return min(opening.stamp_ns for opening in openings)


def history_of(openings: Sequence[CrackOpening], method: str, start_ns: int) -> History:
    """One method's history, by time since `start_ns`.

    Raises:
        RgbdDicError: if its valid rows count from more than one reference, each a zero of its own.
    """
    mine = sorted((o for o in openings if o.method == method), key=lambda opening: opening.stamp_ns)
    zeros = {opening.reference_stamp_ns for opening in mine if opening.valid}
    if len(zeros) > 1:
        raise RgbdDicError(
            f"{method} counts from {len(zeros)} references, each a zero of its own: "
            "compare runs in which ~/set_reference was not called"
        )
    values = np.array([(o.opening_m, o.sliding_m) if o.valid else (np.nan, np.nan) for o in mine]).reshape(-1, 2)
    return History(np.array([(o.stamp_ns - start_ns) * 1e-9 for o in mine]), values[:, 0], values[:, 1])


def read_reference(path: Path, start_ns: int = 0) -> History:
    """Read the CSV of a reference: `stamp_ns` [ns] or `time_s` [s], `opening_mm`, and `sliding_mm` if there is one.

    Args:
        start_ns: stamp at which the run's time is 0. Where the file has stamps its time is counted from there, and
            the delay that is found is that between the clocks; `time_s` stays as it is.

    Returns:
        Its rows; NaN where a length is empty or not a number.

    Raises:
        RgbdDicError: naming the file and the row or column that is wrong.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = list(csv.DictReader(file))
    except OSError as error:
        raise RgbdDicError(f"cannot read {path}: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise RgbdDicError(f"{path} is not a CSV file: {error}") from error
    found = [name for name in (lines[0] if lines else {}) if name is not None]
    clock = next((name for name in ("stamp_ns", "time_s") if name in found), None)
    missing = ["time_s or stamp_ns"] * (clock is None) + ["opening_mm"] * ("opening_mm" not in found)
    if lines and missing:
        raise RgbdDicError(f"{path} lacks the column {' and '.join(missing)}; it has {', '.join(found)}")
    history = History(
        np.array([_time(path, i, line[clock], clock, start_ns) for i, line in enumerate(lines)]),
        np.array([_length(path, i, line, "opening_mm") for i, line in enumerate(lines)]),
        np.array([_length(path, i, line, "sliding_mm") for i, line in enumerate(lines)]),
    )
    back = np.flatnonzero(np.diff(history.time_s) <= 0)
    if len(back):
        before, after = (lines[back[0] + i][clock] for i in (0, 1))
        raise RgbdDicError(
            f"{path}, row {back[0] + 2}: {clock} {after} is not after {before} of the row before; "
            "sort the rows by time, and give one history a file"
        )
    count = np.isfinite(history.opening_m).sum()
    if count < MIN_ROWS:
        raise RgbdDicError(f"{path} has {count} rows with an opening, at least {MIN_ROWS} are needed")
    return history


def _time(path: Path, index: int, text: str | None, clock: str, start_ns: int) -> float:
    try:
        value = (int(text) - start_ns) * 1e-9 if clock == "stamp_ns" else float(text)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        value = np.nan
    if not np.isfinite(value):
        raise RgbdDicError(f"{path}, row {index + 1}: {clock} is {text!r}, expected a number")
    return value


def _length(path: Path, index: int, line: dict[str, str | None], name: str) -> float:
    text = (line.get(name) or "").strip()
    try:
        value = float(text or "nan") * 1e-3
    except ValueError:
        raise RgbdDicError(f"{path}, row {index + 1}: {name} is {text!r}, expected a number") from None
    return value if np.isfinite(value) else np.nan
