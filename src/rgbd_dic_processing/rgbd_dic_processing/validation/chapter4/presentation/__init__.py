"""Tables and figures of a run of chapter 4."""

from __future__ import annotations

from pathlib import Path

from ...page import Criterion, write_page
from ..chapter import Chapter4
from . import figures, scene
from .criteria import criteria
from .tables import facts, tables


def write_chapter4(data: Chapter4, folder: Path, run_folder: Path) -> list[Criterion]:
    """Write all tables and figures (`page.write_page`); returns what was reached.

    Args:
        folder: for these files.
        run_folder: that the run used, with its recordings.
    """
    folder.mkdir(parents=True, exist_ok=True)
    pictures = [*scene.draw(data, run_folder, folder), *figures.draw(data, run_folder, folder)]
    write_page(folder, facts(data), tables(data), pictures)
    return criteria(data)
