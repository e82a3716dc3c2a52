"""Tables and figures of a run of chapter 3."""

from __future__ import annotations

from pathlib import Path

from ..chapter3 import Chapter3
from . import figures, maps
from .criteria import Criterion, criteria
from .tables import facts, tables

TABLES = "tables.md"


def write_chapter3(data: Chapter3, folder: Path, run_folder: Path) -> list[Criterion]:
    """Write `tables.md`, a file for each table, and the figures with their captions; returns what was reached.

    Args:
        folder: for these files.
        run_folder: that the run used, with its images.
    """
    blocks = folder / "tables"
    blocks.mkdir(parents=True, exist_ok=True)
    made = tables(data)
    for name, text in made.items():
        (blocks / f"{name}.md").write_text(text + "\n")
    pictures = [*figures.draw(data, folder), *maps.draw(run_folder, folder)]
    parts = [facts(data), *(f"## {name}\n\n{text}" for name, text in made.items())]
    parts += [f"![{picture.alt}]({picture.path.name})\n\n{picture.caption}" for picture in pictures]
    (folder / TABLES).write_text("\n\n".join(parts) + "\n")
    (blocks / "captions.md").write_text("\n".join(f"{p.path.name}: {p.caption}" for p in pictures) + "\n")
    return criteria(data)
