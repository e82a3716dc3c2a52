"""Chapter 3 of the thesis, from the images to what was measured in them: `run_chapter3`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..running import Progress, Task, run_tasks
from . import budget, calibrating, oblique, quality, tasks
from .shots import PATTERNS, REFERENCES, Shot, all_shots

Array = NDArray[np.float64]
Pair = tuple[int, int]

NOISE = (0.0, 1.0, 3.0)  # grey levels
BUDGET_SHOTS = (7, 11, 21, 31)  # yaw 3 and 15, pitch 15, roll 15 degrees


@dataclass(frozen=True)
class Scope:
    """What is run. shots: numbers of the images with a crack. realisations: of the noise, for each pair."""

    references: tuple[int, ...]
    shots: tuple[int, ...]
    views: int
    noisy_shots: tuple[int, ...]
    realisations: int
    budget_shots: tuple[int, ...]
    series: dict[str, list[float] | None]
    lenses: tuple[str, ...]

    @property
    def moving(self) -> tuple[int, ...]:
        """The images with a crack of 10 mm and a moving camera."""
        return tuple(number for number in self.shots if number < 37)

    @property
    def growing(self) -> tuple[int, ...]:
        """The images of the growing crack."""
        return tuple(number for number in self.shots if number >= 37)


FULL = Scope(
    tuple(range(len(REFERENCES))),
    tuple(all_shots()),
    calibrating.VIEWS,
    tuple(number for number in all_shots() if number < 37),
    2,
    BUDGET_SHOTS,
    {series.name: None for series in oblique.SERIES},
    tuple(oblique.LENSES),
)
QUICK = Scope((0, 2), (11, 21, 31, 41), 8, (11, 21, 31), 1, (11,), {"yaw": [0, 15, 30]}, ("k1 = -0.2",))


@dataclass(frozen=True)
class Chapter3:
    """All that was measured. blobs, disks: (reference, image) -> result of the task; noisy: by noise, then likewise.

    budget: (pattern, image) -> parts; oblique: (series, lens) -> steps; patterns: pattern -> quality.
    """

    scope: Scope
    calibration: dict[str, Any]
    patterns: dict[str, dict[str, float]]
    blobs: dict[Pair, dict[str, Any]]
    disks: dict[Pair, dict[str, Any]]
    noisy: dict[float, dict[Pair, dict[str, Any]]]
    budget: dict[tuple[str, int], dict[str, float]]
    oblique: dict[tuple[str, str], list[dict[str, Any]]]

    def values(
        self,
        pattern: str,
        variant: str,
        method: str,
        quantity: str = "average",
        references: tuple[int, ...] | None = None,
        shots: tuple[int, ...] | None = None,
    ) -> Array:
        """One quantity [mm] (references, images); the images with a moving camera unless others are named."""
        pairs = self.blobs if pattern == "blobs" else self.disks
        references = references or self.scope.references
        shots = shots or self.scope.moving
        return np.array(
            [[pairs[r, s]["summaries"][variant][method][quantity] for s in shots] for r in references]
        ).reshape(len(references), len(shots))

    def errors(self, pattern: str, variant: str, method: str, **chosen: Any) -> Array:
        """Average minus the true crack [mm] (references, images)."""
        truth = [all_shots()[number].crack_mm for number in chosen.get("shots") or self.scope.moving]
        return self.values(pattern, variant, method, **chosen) - np.array(truth)

    def series(self, name: str) -> tuple[Shot, ...]:
        """The images of a series that were run, in the order of their angle or crack."""
        chosen = [all_shots()[number] for number in self.scope.shots if all_shots()[number].series == name]
        by_angle = name in ("yaw", "pitch", "roll")
        return tuple(sorted(chosen, key=lambda shot: shot.angle_deg if by_angle else shot.crack_mm))


def run_chapter3(folder: Path, scope: Scope, workers: int = 2, progress: Progress | None = None) -> Chapter3:
    """Measure everything, or take it from an earlier run into the same folder.

    Args:
        folder: keeps the images and the results of all tasks.
        workers: processes.
        progress: called with (tasks done, tasks in all).
    """
    views = [Task(tasks.board, {"view": view}) for view in range(scope.views)]
    pairs = [(r, s) for r in scope.references for s in scope.shots]
    noisy = [(n, r, s) for n in NOISE for r in scope.references for s in scope.noisy_shots]
    spread = [(pattern, shot) for pattern in PATTERNS for shot in scope.budget_shots]
    views_far = [(series, lens) for lens in scope.lenses for series in scope.series]
    independent = [
        *(Task(quality.pattern_quality, {"pattern": pattern}) for pattern in PATTERNS),
        *(Task(tasks.disks, {"reference": r, "shot": s}) for r, s in pairs),
        *(
            Task(tasks.noisy, {"reference": r, "shot": s, "noise": n, "realisations": scope.realisations})
            for n, r, s in noisy
        ),
        *(Task(budget.spread, {"pattern": p, "reference": 0, "shot": s}) for p, s in spread),
        *(Task(oblique.follow, {"series": s, "lens": lens, "only": scope.series[s]}) for s, lens in views_far),
    ]
    total = len(views) + 1 + len(independent) + len(pairs)

    def part(before: int) -> Progress | None:
        return None if progress is None else lambda done, _: progress(before + done, total)

    corners = run_tasks(views, folder, workers, part(0))
    # a task of its own: OpenCV's last digits differ from run to run, and later tasks are kept by these values
    [calibration] = run_tasks([Task(tasks.calibration, {"corners": corners})], folder, workers, part(len(views)))
    results = iter(run_tasks(independent, folder, workers, part(len(views) + 1)))
    patterns = {pattern: next(results) for pattern in PATTERNS}
    disks = {pair: next(results) for pair in pairs}
    with_noise: dict[float, dict[Pair, dict[str, Any]]] = {n: {} for n in NOISE}
    for n, r, s in noisy:
        with_noise[n][r, s] = next(results)
    parts = {key: next(results) for key in spread}
    far = {key: next(results) for key in views_far}
    values = calibration["values"]
    measured = run_tasks(
        [Task(tasks.blobs, {"reference": r, "shot": s, "calibrated": values}) for r, s in pairs],
        folder,
        workers,
        part(len(views) + 1 + len(independent)),
    )
    blobs = dict(zip(pairs, measured, strict=True))
    return Chapter3(scope, calibration, patterns, blobs, disks, with_noise, parts, far)
