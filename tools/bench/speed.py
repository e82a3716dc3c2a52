"""How fast this engine is: warps, instruction sets, tolerance, threads; what a frame and a pair spend their time on."""

from __future__ import annotations

import contextlib
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from comparison import DEGREES
from engine import instruction_sets
from scenes import FAR, TURNED_2, TURNED_6, Scenes
from speckle import Motion, shift
from workers import Worker

SHIFT = shift(0.5, 0.5)
PARTS = ("seeds_s", "filter_s", "icgn_s")


def video(folder: Path, quick: bool) -> list[dict[str, Any]]:
    """Frames against a fixed reference, from seeds 0.3 px off, one thread."""
    sets = instruction_sets()
    cases = [(motion, sets[0], {}) for motion in (SHIFT, TURNED_2, TURNED_6)]
    cases += [
        (motion, other, {}) for other in sets[1:] for motion in (SHIFT, TURNED_2, TURNED_6)[: 1 if quick else None]
    ]
    cases += [(SHIFT, sets[0], {"tolerance_px": 1e-3})]
    wanted = [
        (motion, {"mode": "video", "instruction_set": name, "settings": {"spline_degree": degree, **settings}})
        for motion, name, settings in cases
        for degree in DEGREES
    ]
    rows = _measured(folder, wanted, repeats=3 if quick else 9)
    for row in rows:
        row["parts_ms"] = {part: 1e3 * float(np.median(row["arrays"][part])) for part in PARTS}
        row["iterations"] = float(np.mean(row.pop("arrays")["iterations"]))
    return rows


def pairs(folder: Path, quick: bool) -> list[dict[str, Any]]:
    """Image pairs from nothing, with no guess from outside, one thread."""
    sets = instruction_sets()
    cases = [(motion, sets[0]) for motion in (SHIFT, FAR, TURNED_6)] + [(SHIFT, other) for other in sets[1:]]
    wanted = [
        (motion, {"mode": "pair", "instruction_set": name, "settings": {"spline_degree": degree}})
        for motion, name in cases
        for degree in DEGREES
    ]
    rows = _measured(folder, wanted, repeats=2 if quick else 5)
    for row in rows:
        del row["arrays"]
    return rows


def threads(folder: Path, quick: bool) -> list[dict[str, Any]]:
    """Wall time of a video's frame with one thread and with two, the fastest of the repeats; empty on a single core."""
    if len(os.sched_getaffinity(0)) < 2:
        return []
    rows = []
    for degree, name in DEGREES.items():
        wanted = [
            (TURNED_2, {"mode": "video", "goes_on": True, "settings": {"spline_degree": degree, "threads": count}})
            for count in (1, 2)
        ]
        one, two = _measured(folder, wanted, repeats=5 if quick else 15)
        parts = {part: [float(row["arrays"][f"wall_{part}"].min()) for row in (one, two)] for part in PARTS}
        wall = [float(sum(row["arrays"][f"wall_{part}"] for part in PARTS).min()) for row in (one, two)]
        beside = _beside_each_other(folder, wanted[0], repeats=5 if quick else 15)
        rows.append({"degree": degree, "name": name, "wall_s": wall, "parts_s": parts, "beside_s": beside})
    return rows


def _beside_each_other(folder: Path, wanted: tuple[Motion, dict[str, Any]], repeats: int) -> list[float]:
    """Median wall time of a process while the second core is free, and while another one does the same there."""
    motion, setup = wanted
    scene = Scenes(folder).pair(motion)
    with contextlib.ExitStack() as stack:
        workers = [stack.enter_context(Worker("rgbd_dic", setup, folder, core=core)) for core in (0, 1)]

        def ask(worker: Worker) -> float:
            run = worker.ask(scene.reference, scene.target, homography=motion.homography.tolist())
            return float(sum(run.arrays[f"wall_{part}"] for part in PARTS))

        alone = np.median([ask(workers[0]) for _ in range(repeats + 1)][1:])
        with ThreadPoolExecutor(2) as pool:
            both = np.median([list(pool.map(ask, workers)) for _ in range(repeats + 1)][1:])
    return [float(alone), float(both)]


def _measured(folder: Path, wanted: list[tuple[Motion, dict[str, Any]]], repeats: int) -> list[dict[str, Any]]:
    """Each case asked in turn, `repeats` times after one that warms it up."""
    scenes = Scenes(folder)
    with contextlib.ExitStack() as stack:
        workers = [
            stack.enter_context(Worker("rgbd_dic", setup, folder, setup["settings"].get("threads", 1)))
            for _, setup in wanted
        ]
        runs = [[] for _ in wanted]
        for _ in range(repeats + 1):
            for worker, (motion, _), done in zip(workers, wanted, runs, strict=True):
                scene = scenes.pair(motion)
                done.append(worker.ask(scene.reference, scene.target, homography=motion.homography.tolist()))
    rows = []
    for (motion, setup), done in zip(wanted, runs, strict=True):
        kept = done[1:]
        found = int(np.isfinite(kept[-1].arrays["u"]).sum())
        speeds = [found / run.cpu_s for run in kept]
        rows.append(
            {
                "motion": motion.name,
                "instruction_set": setup.get("instruction_set"),
                "degree": setup["settings"]["spline_degree"],
                "settings": setup["settings"],
                "points": len(kept[-1].arrays["u"]),
                "found": found,
                "points_per_s": float(np.median(speeds)),
                "points_per_s_range": [min(speeds), max(speeds)],
                "wall_s": float(np.median([run.wall_s for run in kept])),
                "arrays": {
                    name: np.array([run.arrays[name] for run in kept])
                    for name in kept[-1].arrays
                    if name.endswith("_s") or name == "iterations"
                },
            }
        )
    return rows
