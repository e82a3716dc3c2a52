"""The report of a run: its figures as PNG files, and one self-contained page, `report.html`."""

from __future__ import annotations

from pathlib import Path

from rgbd_dic_acquisition.errors import RgbdDicError

from ..core.regions import load_regions
from ..results import read_truth
from ..runs import TRUTH_NAME, Run

PAGE_NAME, REGIONS_NAME = "report.html", "regions.yaml"


def write_report(folder: Path, truth: Path | None = None) -> Path:
    """Draw the figures of a run into its folder and write `report.html` beside them.

    Args:
        folder: as `Run.save` wrote it; `regions.yaml` in it, if any, is outlined on the maps.
        truth: the CSV of a known history; None takes `truth.csv` of the folder, if there is one.

    Returns:
        The path of the page, which needs no other file.

    Raises:
        RgbdDicError: if the folder is not that of a run, or a file of it cannot be read or written.
    """
    # matplotlib comes with these, and only when a report is asked for
    from . import drawing, history, maps, page, quality, series

    folder = Path(folder)
    run = Run.load(folder)
    truth = truth or (folder / TRUTH_NAME if (folder / TRUTH_NAME).exists() else None)
    known = read_truth(truth) if truth is not None else None
    regions = load_regions(folder / REGIONS_NAME) if (folder / REGIONS_NAME).exists() else None
    methods = series.of_run(run.openings, known)
    try:
        with drawing.appearance():
            pictures = [
                *history.draw(methods, folder),
                *quality.draw(methods, folder),
                *maps.draw(run, regions, folder),
            ]
        return page.write(folder / PAGE_NAME, run, methods, pictures, has_truth=known is not None)
    except OSError as error:
        raise RgbdDicError(f"cannot write the report to {folder}: {error.strerror}") from error
