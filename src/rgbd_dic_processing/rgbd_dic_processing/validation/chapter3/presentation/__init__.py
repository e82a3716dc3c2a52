"""Tables and figures of a run of chapter 3."""

from __future__ import annotations

from pathlib import Path

from ...page import Criterion, write_page
from ..chapter import Chapter3
from . import figures, maps
from .criteria import criteria
from .tables import facts, tables


def write_chapter3(data: Chapter3, folder: Path, run_folder: Path) -> list[Criterion]:
    """Write all tables and figures (`page.write_page`); returns what was reached.

    Args:
        folder: for these files.
        run_folder: that the run used, with its images.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_page(folder, facts(data), tables(data), [*figures.draw(data, folder), *maps.draw(run_folder, folder)])
    return criteria(data)
