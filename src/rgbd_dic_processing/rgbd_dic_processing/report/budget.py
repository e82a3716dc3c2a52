"""budget.png: what the stated uncertainty of each method is made of; and the same in numbers for the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from numpy.typing import NDArray

from ..core.error_sources import ErrorSource
from ..core.opening_budget import OpeningBudget, mean_parts, root_of_part
from ..runs import Run
from .drawing import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    TIME_LABEL,
    VERMILION,
    Picture,
    method_order,
    new_figure,
    plot_values,
    save,
    time_range_s,
)
from .frames import Frames
from .panels import stroke_words

Array = NDArray[np.float64]

NAME = "budget.png"
WORDS = {
    ErrorSource.SUBSETS: "noise of the subsets in the zones",
    ErrorSource.MOTION: "noise of the fixed region, by the motion",
    ErrorSource.OVERLAP: "covariance of these two",
    ErrorSource.REFERENCE_PLANE: "plane of the panel in the reference",
    ErrorSource.FRAME_PLANE: "plane of the panel in the image",
    ErrorSource.DEFORMATION: "deformation taken for motion",
    ErrorSource.SHAPE: "curvature of the panel",
    ErrorSource.SCALE: "scale of all lengths",
}
STYLES = {  # colour and hatch of a bar, line style
    ErrorSource.SUBSETS: (BLUE, "", "-"),
    ErrorSource.MOTION: (ORANGE, "///", "--"),
    ErrorSource.OVERLAP: ("white", "....", ":"),
    ErrorSource.REFERENCE_PLANE: (GREEN, "\\\\\\", "-."),
    ErrorSource.FRAME_PLANE: (VERMILION, "xxx", (0, (5, 1))),
    ErrorSource.DEFORMATION: (PURPLE, "ooo", (0, (3, 1, 1, 1))),
    ErrorSource.SHAPE: (SKY, "---", (0, (1, 1))),
    ErrorSource.SCALE: (GREY, "+++", (0, (5, 1, 1, 1, 1, 1))),
}
Budgets = Mapping[str, Sequence[OpeningBudget]]


def of_run(run: Run) -> dict[str, list[OpeningBudget]]:
    """Method -> its budgets in the order of time, without the reference's own, whose opening is zero by definition."""
    references = {opening.reference_stamp_ns for opening in run.openings}
    found = [budget for budget in run.frames.budgets if budget.stamp_ns not in references]
    return {
        method: sorted((b for b in found if b.method == method), key=lambda budget: budget.stamp_ns)
        for method in method_order({budget.method for budget in found})
    }


def rows_mm(budgets: Budgets) -> list[tuple[str, list[float]]]:
    """Words and one number for each method [mm]: the root of the mean of each part that occurs, with its sign, and last
    that of their sum."""
    means = {method: mean_parts(mine) for method, mine in budgets.items()}
    occurring = [source for source in ErrorSource if any(parts[source] for parts in means.values())]
    rows = [(WORDS[source], [root_of_part(parts[source]) * 1e3 for parts in means.values()]) for source in occurring]
    return [*rows, ("stated uncertainty", [float(np.sqrt(parts.sum())) * 1e3 for parts in means.values()])]


def draw(run: Run, budgets: Budgets, folder: Path) -> list[Picture]:
    """Write the figure; nothing if there are no budgets."""
    if not budgets:
        return []
    figure = new_figure(9.0, 4.6 + 0.3 * len(budgets))
    shares, history = figure.subplots(2, 1, gridspec_kw={"height_ratios": (0.5 + 0.3 * len(budgets), 2.6)})
    means = {method: mean_parts(mine) for method, mine in budgets.items()}
    occurring = [source for source in ErrorSource if any(parts[source] for parts in means.values())]
    _draw_shares(shares, means, occurring)
    method = next(iter(budgets))
    _draw_history(history, method, budgets[method], Frames(run))
    handles = [
        Patch(facecolor=STYLES[source][0], hatch=STYLES[source][1], edgecolor=BLACK, linewidth=0.5, label=WORDS[source])
        for source in occurring
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    caption = (
        "What the stated uncertainty is made of. Above, parts of the mean variance of the opening; a negative "
        "covariance stands left of zero, and all parts add up to 100 %. Below, the same over time as standard "
        f"uncertainties of {method}, each the root of its part, the covariance left out; black: all together."
    )
    caption += stroke_words(len(budgets[method]))
    alt = f"Parts of the uncertainty of {', '.join(budgets)}, and those of {method} over time."
    return [save(figure, folder / NAME, caption, alt)]


def _draw_shares(axes: Axes, means: Mapping[str, Array], occurring: Sequence[ErrorSource]) -> None:
    for place, parts in enumerate(means.values()):
        ends = {True: 0.0, False: 0.0}  # of the bars to the left and to the right
        for source in occurring:
            color, hatch, _ = STYLES[source]
            share = 100 * parts[source] / max(parts.sum(), 1e-30)
            axes.barh(place, share, 0.7, ends[share < 0], color=color, hatch=hatch, edgecolor=BLACK, linewidth=0.5)
            ends[share < 0] += share
    axes.axvline(0.0, color=BLACK, linewidth=0.8)
    axes.set_yticks(range(len(means)), list(means))
    axes.set_ylim(len(means) - 0.5, -0.5)
    axes.set_xlabel("part of the variance [%]")


def _draw_history(axes: Axes, method: str, budgets: Sequence[OpeningBudget], frames: Frames) -> None:
    time_s = (np.array([budget.stamp_ns for budget in budgets]) - frames.start_ns) * 1e-9
    parts = np.array([budget.parts_m2 for budget in budgets])
    for source in ErrorSource:
        if parts[:, source].any() and source != ErrorSource.OVERLAP:
            color, _, style = STYLES[source]
            root_mm = np.sqrt(parts[:, source]) * 1e3
            plot_values(axes, time_s, root_mm, WORDS[source], color=color, linestyle=style, linewidth=1.4)
    total_mm = np.array([budget.u_opening_m for budget in budgets]) * 1e3
    plot_values(axes, time_s, total_mm, "stated uncertainty", color=BLACK, linewidth=1.6)
    axes.set_ylim(0, 1.15 * min(total_mm.max(), 1.5 * np.percentile(total_mm, 95)))  # one of them may be huge
    axes.set_xlim(*time_range_s(frames.end_s))
    axes.set_ylabel("uncertainty [mm]")
    axes.set_xlabel(TIME_LABEL)
    axes.set_title(method, loc="left")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
