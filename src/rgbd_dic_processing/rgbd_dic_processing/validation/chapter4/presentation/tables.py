"""The tables, as Markdown: name of the block in docs/validation_chapter4.md -> its text."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...page import NONE, criteria_table, table
from ..chapter import BUDGET_SCALE, EVERY, MAPPED, METHODS, ROLLS, Chapter4
from ..errors import COMPONENTS, CrackHistory
from ..hard_flight import HEADER
from ..regions import REGIONS, usual_region
from .criteria import THESIS_MM, criteria

REGION_WORDS = {"near": "near the crack", "half": "left half", "whole": "whole panel"}


def tables(data: Chapter4) -> dict[str, str]:
    """All that the run can fill."""
    return {
        "facts": facts(data),
        "criteria": criteria_table(criteria(data)),
        "thesis": _as_in_the_thesis(data),
        "openings": _openings(data),
        "aligned": _aligned(data),
        "regions": _regions(data),
        "maps": _maps(data),
        "budget": _budget(data),
        "axes": _axes(data),
    } | ({"hard": table(HEADER, [flight["row"] for flight in data.hard.values()])} if data.hard else {})


def facts(data: Chapter4) -> str:
    """One line on what was run."""
    scope = data.scope
    return (
        f"Fields {', '.join(scope.fields)}; seeds: {', '.join(map(str, scope.seeds))}; {scope.duration_s:g} s at 60 Hz "
        f"({MAPPED[0]}, seed {MAPPED[1]}: {scope.mapped_s:g} s), images of {scope.scale:g} times the full size; error "
        f"budget: {scope.budget_s:g} s at {BUDGET_SCALE:g} times; hard flights: {len(data.hard)} of {scope.hard_s:g} s."
    )


def _as_in_the_thesis(data: Chapter4) -> str:
    """Table 4.6: RMS of the opening, with ours against the exact opening."""
    rows = [("thesis, against 3D DIC", *(f"{THESIS_MM[m]:.3f}" if m in THESIS_MM else NONE for m in EVERY))]
    for field in data.scope.fields:
        name = f"`{field}`, {REGION_WORDS[usual_region(field)]}, against the truth"
        rows.append((name, *(_mean_and_worst(data.of(field, method), "opening") for method in EVERY)))
    field, region = MAPPED[0], REGION_WORDS[usual_region(MAPPED[0])]
    cells = [_beside(data, method, "opening, spline") for method in EVERY]
    rows.append((f"`{field}`, seed {MAPPED[1]}, {region}, against the simulated 3D DIC", *cells))
    return table(("RMS error [mm]", *_names(EVERY)), rows)


def _aligned(data: Chapter4) -> str:
    """Beside the simulated 3D DIC after alignment: both interpolations, both components, and the delay."""
    words = {
        "opening, spline": "opening, smoothing spline [mm]",
        "opening, fourier": "opening, Fourier series [mm]",
        "sliding, spline": "sliding, smoothing spline [mm]",
        "sliding, fourier": "sliding, Fourier series [mm]",
    }
    rows = [(f"RMS, {name}", *(_beside(data, method, key) for method in METHODS)) for key, name in words.items()]
    rows.append(("delay found less the true one [ms]", *(_beside(data, m, "delay_error_s", 1e3, 1) for m in METHODS)))
    return table(("", *_names()), rows)


def _beside(data: Chapter4, method: str, key: str, factor: float = 1.0, digits: int = 4) -> str:
    """A number of the comparison of `MAPPED` with the 3D DIC, if there is one."""
    found = data.aligned.get(method, {"reason": "it is none of METHODS"})
    return NONE if "reason" in found else f"{factor * found[key]:.{digits}f}"


def _openings(data: Chapter4) -> str:
    """Errors of both components beside what was stated."""
    rows = []
    for field in data.scope.fields:
        for method in EVERY:
            histories = data.of(field, method)
            cells = []
            for component in COMPONENTS:
                ratios = [history.ratio(component) for history in histories]
                cells += [
                    _mean_and_worst(histories, component),
                    f"{np.mean([history.stated(component) for history in histories]):.4f}",
                    f"{np.mean(ratios):.2f} ({max(ratios):.2f})",
                ]
            rows.append((f"`{field}`", f"`{method}`", *cells, f"{min(history.valid for history in histories):.1%}"))
    columns = ("RMS error of the {} [mm]", "stated [mm]", "error / stated")
    headers = (column.format(component) for component in COMPONENTS for column in columns)
    return table(("field", "method", *headers, "images measured"), rows)


def _regions(data: Chapter4) -> str:
    """4.3.2."""
    rows = []
    for field in data.scope.without_rigid_part:
        for region in REGIONS:
            chosen = [
                [data.histories[field, seed, method, region] for seed in data.scope.region_seeds] for method in METHODS
            ]
            for component in COMPONENTS:
                cells = [_mean_and_worst(histories, component) for histories in chosen]
                rows.append((f"`{field}`", REGION_WORDS[region], component, *cells))
    return table(("field", "region", "RMS error [mm]", *_names()), rows)


def _maps(data: Chapter4) -> str:
    """RMS of the map's error in px, x and y."""
    rows = []
    for field in data.scope.fields:
        for axis in (0, 1):
            cells = []
            for method in EVERY:
                values = [history.map_rms()[axis] for history in data.of(field, method)]
                cells.append(f"{np.mean(values):.4f} ({max(values):.4f})")
            rows.append((f"`{field}`", "xy"[axis], *cells))
    return table(("field", "RMS error of the map [px]", *_names(EVERY)), rows)


def _budget(data: Chapter4) -> str:
    def cells(source: str, value: Callable[[CrackHistory], float]) -> list[str]:
        of_methods = [[data.budget[source, seed, method] for seed in data.scope.budget_seeds] for method in METHODS]
        return [f"{1e3 * np.sqrt(np.mean([value(h) ** 2 for h in histories])):.2f}" for histories in of_methods]

    rows = [
        (source, component, *cells(source, lambda history, c=component: history.rms(c)))
        for source in data.scope.sources
        for component in COMPONENTS
    ]
    return table(("switched on", "RMS error [1e-3 mm]", *_names()), rows)


def _axes(data: Chapter4) -> str:
    rows = []
    for name in ROLLS:
        for component in COMPONENTS:
            rows.append((name, component, *(f"{data.rolled[name, method].rms(component):.4f}" for method in METHODS)))
    field, seed = data.scope.rolled
    return table((f"`{field}`, seed {seed}", "RMS error [mm]", *_names()), rows)


def _mean_and_worst(histories: Sequence[CrackHistory], component: str) -> str:
    values = [history.rms(component) for history in histories]
    return f"{np.mean(values):.4f} ({max(values):.4f})"


def _names(methods: Sequence[str] = METHODS) -> list[str]:
    return [f"`{method}`" for method in methods]
