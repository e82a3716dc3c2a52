"""The numbers to reach, and what was reached."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...page import Criterion
from ..chapter import EVERY, HARD, METHODS, Chapter4
from ..errors import COMPONENTS, CrackHistory, rms

THESIS_MM = {"h_3d": 0.038, "h_2d": 0.032}  # Table 4.6
RIGID = ("h_pose", "h_joint")
WHOLE_MM = {"opening": 0.012, "sliding": 0.005}
MAP_LIMIT_PX = 0.02


def criteria(data: Chapter4) -> list[Criterion]:
    """All that the run can tell."""
    return [
        *(_rigid_half(data) if "rigid_half" in data.scope.fields else ()),
        *_whole_panel(data),
        *_uncertainty(data),
        *_maps(data),
        *(_hard(data) if data.hard else ()),
    ]


def worst(histories: list[CrackHistory], component: str) -> float:
    """Largest RMS error of the seeds [mm]."""
    return max(history.rms(component) for history in histories)


def best_method(data: Chapter4) -> str:
    """The one that is farthest below the limits, in the worst seed of all fields without a rigid part."""

    def part(method: str) -> float:
        return max(worst(_of_all(data, method), component) / limit for component, limit in WHOLE_MM.items())

    return min(METHODS, key=part)


def _of_all(data: Chapter4, method: str) -> list[CrackHistory]:
    return [history for field in data.scope.without_rigid_part for history in data.of(field, method)]


def _rigid_half(data: Chapter4) -> Iterator[Criterion]:
    for method in (one for one in RIGID if one in METHODS):
        for component in COMPONENTS:
            measured = worst(data.of("rigid_half", method), component)
            yield Criterion(f"left half rigid and the fixed region, `{method}`: {component}", measured, 0.003)


def _whole_panel(data: Chapter4) -> Iterator[Criterion]:
    method = best_method(data)
    histories = _of_all(data, method)
    words = f"no rigid part, whole panel, best method (`{method}`)"
    for component, limit in WHOLE_MM.items():
        yield Criterion(f"{words}: {component}", worst(histories, component), limit)
    yield Criterion(f"{words}: opening, stretch goal", worst(histories, "opening"), 0.005)
    for method, printed in THESIS_MM.items():
        measured = worst(_of_all(data, method), "opening")
        yield Criterion(f"no rigid part, whole panel, `{method}`: opening, no worse than Table 4.6", measured, printed)


def _uncertainty(data: Chapter4) -> Iterator[Criterion]:
    for method in EVERY:
        for component in COMPONENTS:
            ratio = max(pooled_ratio(data.of(field, method), component) for field in data.scope.fields)
            yield Criterion(f"`{method}`: RMS error of the {component} over what it states", ratio, 1.1, unit="")


def pooled_ratio(histories: list[CrackHistory], component: str) -> float:
    """RMS error over the RMS of what was stated, both over all seeds of a field.

    Much of the error of a record is one draw, such as that of the reference's plane: a single seed does not tell.
    """
    error = np.concatenate([history.error(component)[1:] for history in histories])
    stated = np.concatenate([history.columns[f"u_{component}"][1:] for history in histories])
    return rms(error) / rms(stated)


def _maps(data: Chapter4) -> Iterator[Criterion]:
    if "h_joint" in METHODS:
        largest = max(max(history.map_rms()) for history in _of_all(data, "h_joint"))
        yield Criterion("no rigid part, whole panel, `h_joint`: RMS error of the map", largest, MAP_LIMIT_PX, "px")


def _hard(data: Chapter4) -> Iterator[Criterion]:
    flights = data.hard.values()
    largest = max(flight["largest_mm"] for flight in flights)
    yield Criterion("hard flights: largest error of a frame whose zones are visible", largest, 0.02)
    missed = sum(not flight["flagged"] for flight in flights)
    yield Criterion("hard flights in which a hidden zone is not flagged", missed, 0, unit="")
    for field, method in HARD:
        flown = [flight for key, flight in data.hard.items() if key[:2] == (field, method)]
        ratio = rms(np.array([one["rms_mm"] for one in flown])) / rms(np.array([one["stated_mm"] for one in flown]))
        yield Criterion(f"hard flights, `{field}`, `{method}`: RMS error over what it states", ratio, 1.1, unit="")
    later = max(flight["frames_to_valid"] for flight in flights)
    yield Criterion("hard flights: frames from the end of the gap to the first valid one", later, 1, unit="")
