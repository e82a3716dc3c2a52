"""Chapter 4 of the thesis, from the simulated laboratories to what was measured in them: `run_chapter4`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ...core.displacement import SOLVERS
from ..running import Progress, Task, run_tasks
from . import alignment, example, hard_flight, measuring, planes
from .budget import SOURCES, field_with, laboratory_with
from .errors import CrackHistory
from .recording import recording_task
from .regions import REGIONS, usual_region
from .scenes import Values, laboratory_values

METHODS = tuple(SOLVERS)
EVERY = (*METHODS, *measuring.VARIANTS)
HARD = (("rigid_half", "h_pose"), ("beam", "h_joint"))  # fields of the hard flights, and the method for each
MAPPED = ("beam", 1)  # the laboratory whose maps and histories are drawn, and compared with the 3D DIC
SEEDS, OF_SEEDS = (1, 2, 3, 4, 5), ("seeds", "region_seeds", "budget_seeds", "hard_seeds")
ROLLS: dict[str, dict[str, Any]] = {  # axes drawn wrong: arguments of `measuring.measure`
    "as drawn": {},
    "x axis of the panel rolled by 2.5°": {"roll_deg": {"x_axis": 2.5}},
    "crack's direction rolled by 1°": {"roll_deg": {"crack": 1.0}},
    "crack's direction rolled by 2.5°": {"roll_deg": {"crack": 2.5}},
}


@dataclass(frozen=True)
class Scope:
    """What is run. scale: of the images. mapped_s: length of the laboratory `MAPPED`, others have duration_s.
    region_seeds, budget_seeds, hard_seeds: of the comparison of regions, of the budget, of the hard flights.
    rolled: the laboratory in which axes are drawn wrong."""

    fields: tuple[str, ...]
    seeds: tuple[int, ...]
    duration_s: float
    mapped_s: float
    scale: float
    region_seeds: tuple[int, ...]
    budget_seeds: tuple[int, ...]
    budget_s: float
    sources: tuple[str, ...]
    hard_seeds: tuple[int, ...]
    hard_s: float
    rolled: tuple[str, int]

    def laboratory(self, field: str, seed: int) -> Values:
        """The settings of one."""
        duration_s = self.mapped_s if (field, seed) == MAPPED else self.duration_s
        return laboratory_values(field, seed, duration_s, self.scale)

    def with_seeds(self, count: int) -> Scope:
        """The same with fewer seeds."""
        kept = SEEDS[:count]
        fewer = {name: tuple(seed for seed in getattr(self, name) if seed in kept) for name in OF_SEEDS}
        return replace(self, **fewer)

    @property
    def without_rigid_part(self) -> tuple[str, ...]:
        """The fields in which all of the panel deforms."""
        return tuple(field for field in self.fields if usual_region(field) == "whole")


FULL = Scope(
    fields=("beam", "plate", "rigid_half"),
    seeds=SEEDS,
    duration_s=2.4,
    mapped_s=10.4,
    scale=1.0,
    region_seeds=(1, 2),
    budget_seeds=(1,),
    budget_s=1.2,
    sources=tuple(SOURCES),
    hard_seeds=SEEDS,
    hard_s=6.0,
    rolled=("plate", 1),
)
QUICK = Scope(
    fields=("beam", "rigid_half"),
    seeds=(1,),
    duration_s=2.6,
    mapped_s=2.6,
    scale=0.4,
    region_seeds=(1,),
    budget_seeds=(1,),
    budget_s=0.5,
    sources=("none", "all"),
    hard_seeds=(),
    hard_s=0.0,
    rolled=("beam", 1),
)
BUDGET_SCALE = 0.5


@dataclass(frozen=True)
class Chapter4:
    """All that was measured.

    histories: (field, seed, method, region) -> history; budget: (source, seed, method) -> history; rolled: (axes,
    method) -> history in the laboratory `scope.rolled`; aligned: method -> result of `alignment.compare` in `MAPPED`.
    hard: (field, method, seed) -> result of `hard_flight.hard_flight`.
    example: folder of the run of `MAPPED`, in that of the validation.
    """

    scope: Scope
    histories: dict[tuple[str, int, str, str], CrackHistory]
    budget: dict[tuple[str, int, str], CrackHistory]
    rolled: dict[tuple[str, str], CrackHistory]
    aligned: dict[str, dict[str, Any]]
    hard: dict[tuple[str, str, int], dict[str, Any]]
    example: str

    def of(self, field: str, method: str, region: str | None = None) -> list[CrackHistory]:
        """Of all seeds that were run, with the usual region or another."""
        region = region or usual_region(field)
        return [
            self.histories[field, seed, method, region]
            for seed in self.scope.seeds
            if (field, seed, method, region) in self.histories
        ]


def run_chapter4(folder: Path, scope: Scope, workers: int = 2, progress: Progress | None = None) -> Chapter4:
    """Measure everything, or take it from an earlier run into the same folder.

    Args:
        folder: keeps the subset fields, the planes and the results of all tasks.
        workers: processes.
        progress: called with (tasks done, tasks in all).
    """
    labs = {(field, seed): scope.laboratory(field, seed) for field in scope.fields for seed in scope.seeds}
    alone = {
        (source, seed): laboratory_with(source, seed, scope.budget_s, BUDGET_SCALE)
        for source in scope.sources
        for seed in scope.budget_seeds
    }
    usual = [(field, seed, method, usual_region(field)) for field, seed in labs for method in EVERY]
    others = [
        (field, seed, method, region)
        for field in scope.without_rigid_part
        for seed in scope.region_seeds
        for method in METHODS
        for region in REGIONS
        if region != usual_region(field)
    ]
    parts = len(METHODS) * (len(alone) + len(ROLLS) + 1)
    total = 2 * (len(labs) + len(alone)) + len(usual) + len(others) + parts + 1 + len(HARD) * len(scope.hard_seeds)
    done = 0

    def run(tasks: dict[Any, Task]) -> dict[Any, Any]:
        nonlocal done
        shown: Callable[[int, int], None] | None = None
        if progress is not None:
            before = done

            def shown(count: int, _: int) -> None:
                progress(before + count, total)

        results = run_tasks(list(tasks.values()), folder, workers, shown)
        done += len(tasks)
        return dict(zip(tasks, results, strict=True))

    every = labs | alone
    recorded = run({key: recording_task(values) for key, values in every.items()})
    inputs = {key: {"laboratory": values, "recording": recorded[key]} for key, values in every.items()}
    fitted = run({key: Task(planes.fit_planes, values) for key, values in inputs.items()})
    for key, values in inputs.items():
        values["planes"] = fitted[key]

    def measured(key: tuple[str, int], **chosen: Any) -> Task:
        return Task(measuring.measure, inputs[key] | chosen)

    histories = run(
        {
            (f, s, method, region): measured((f, s), method=method, region=region)
            for f, s, method, region in usual + others
        }
    )
    budget = run(
        {
            (*key, method): measured(key, method=method, region=usual_region(field_with(key[0])))
            for key in alone
            for method in METHODS
        }
    )
    region = usual_region(MAPPED[0])
    rolled = run(
        {
            (name, method): measured(scope.rolled, method=method, region=usual_region(scope.rolled[0]), **wrong)
            for name, wrong in ROLLS.items()
            for method in METHODS
        }
    )
    aligned = run(
        {
            method: Task(
                alignment.compare, {"laboratory": labs[MAPPED], "measured": histories[(*MAPPED, method, region)]}
            )
            for method in METHODS
        }
    )
    flights = [(field, method, seed) for field, method in HARD for seed in scope.hard_seeds]
    hard = run(
        {
            (field, method, seed): Task(
                hard_flight.hard_flight,
                {"field": field, "method": method, "seed": seed, "duration_s": scope.hard_s},
            )
            for field, method, seed in flights
        }
    )
    examples = run({MAPPED: example.process_task(**inputs[MAPPED], methods=list(METHODS), region=region)})
    return Chapter4(
        scope,
        {key: CrackHistory(entry) for key, entry in histories.items()},
        {key: CrackHistory(entry) for key, entry in budget.items()},
        {key: CrackHistory(entry) for key, entry in rolled.items()},
        aligned,
        hard,
        examples[MAPPED],
    )
