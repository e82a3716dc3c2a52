"""The report of a run: its figures as PNG files, and one self-contained page, `report.html`."""

from __future__ import annotations

from pathlib import Path

from rgbd_dic_acquisition.errors import RgbdDicError

from ..core.regions_file import load_regions
from ..history.comparison import compare_run
from ..history.files import COMPARISON_NAME, SENSITIVITY_NAME, write_comparison, write_sensitivity
from ..history.record import read_reference, start_of
from ..history.settings import AlignmentSettings
from ..results import read_truth
from ..runs import TRUTH_NAME, Run

PAGE_NAME, REGIONS_NAME = "report.html", "regions.yaml"


def write_report(
    folder: Path,
    truth: Path | None = None,
    reference: Path | None = None,
    alignment: AlignmentSettings | None = None,
) -> Path:
    """Draw the figures of a run into its folder and write `report.html` beside them.

    Args:
        folder: as `Run.save` wrote it; `regions.yaml` in it, if any, is outlined on the maps.
        truth: the CSV of a known history; None takes `truth.csv` of the folder, if there is one.
        reference: the CSV of a history of another rate and clock, which the run is aligned with (docs/history.md).
        alignment: which delays of it are tried.

    Returns:
        The path of the page, which needs no other file.

    Raises:
        RgbdDicError: if the folder is not that of a run, a file of it cannot be read or written, or no method of the
            run can be aligned with the reference.
    """
    # matplotlib comes with these, and only when a report is asked for
    from . import (
        budget,
        calibration,
        drawing,
        history,
        maps,
        overview,
        page,
        quality,
        series,
        tof_frames,
        validity,
        zones,
    )
    from . import reference as beside

    folder = Path(folder)
    run = Run.load(folder)
    truth = truth or (folder / TRUTH_NAME if (folder / TRUTH_NAME).exists() else None)
    known = read_truth(truth) if truth is not None else None
    regions = load_regions(folder / REGIONS_NAME) if (folder / REGIONS_NAME).exists() else None
    methods = series.of_run(run.openings, known)
    misplaced, unplaced = zones.of_run(run, regions)
    budgets, calibrated = budget.of_run(run), calibration.of_run(folder)
    other, compared = None, []
    if reference is not None:
        start_ns = start_of(run.openings)
        other = read_reference(reference, start_ns)
        compared = compare_run([o for one in methods for o in one.openings], other, start_ns, alignment)
    try:
        if compared:
            write_comparison(compared, folder / COMPARISON_NAME)
        if misplaced:
            write_sensitivity(misplaced, folder / SENSITIVITY_NAME)
        with drawing.appearance():
            pictures = {
                "overview": overview.draw(run, regions, methods, folder),
                "history": history.draw(methods, folder),
                "validity": validity.draw(methods, folder),
                "reference": beside.draw(methods, other, compared, folder) if other is not None else [],
                "maps": maps.draw(run, regions, folder),
                "budget": budget.draw(run, budgets, folder),
                "quality": quality.draw(run, methods, folder),
                "tof": tof_frames.draw(run, folder),
                "zones": zones.draw(run, regions, misplaced, folder),
            }
        return page.write(
            folder / PAGE_NAME,
            run,
            methods,
            pictures,
            has_truth=known is not None,
            beside=compared,
            misplaced=misplaced,
            unplaced=unplaced,
            budgets=budgets,
            calibrated=calibrated,
        )
    except OSError as error:
        raise RgbdDicError(f"cannot write the report to {folder}: {error.strerror}") from error
