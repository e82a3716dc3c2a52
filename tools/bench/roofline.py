"""Time of a subset-iteration against what the arithmetic and the loads that it needs would take on this machine."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from comparison import DEGREES
from engine import SUBSET, instruction_sets
from scenes import TURNED_2, TURNED_6, Scenes
from speckle import shift
from workers import HERE, Worker

# Multiply-adds (or as costly) per pixel and iteration. The warp is evaluated along rows; the weights are those of the
# two axes, in the fewest operations known to us; the taps are summed along rows, then across; the sums are mean and
# energy of the target, and the gradient's two components times the residual and times the offset along the row.
POSITION, FRACTION, SUMS = 4, 4, 7
WEIGHTS = {3: 20, 5: 48}
REFERENCE_BYTES = 12  # grey value and two gradients, float32


def fma_per_pixel(degree: int) -> int:
    """Multiply-adds that a pixel needs in an iteration."""
    taps = degree + 1
    return POSITION + FRACTION + WEIGHTS[degree] + taps * taps + taps + SUMS


def bytes_per_pixel(degree: int) -> int:
    """Bytes that a pixel loads in an iteration: each tap once, from the first-level cache, and the reference's part."""
    return 4 * (degree + 1) ** 2 + REFERENCE_BYTES


def machine(folder: Path) -> dict[str, Any]:
    """Peak rates of one core, or {"failed": why}."""
    compiler = os.environ.get("CXX", "c++")
    if shutil.which(compiler) is None:
        return {"failed": f"no C++ compiler ({compiler})"}
    program = folder / "roofline"
    flags = ["-O3", "-march=native"]
    done = subprocess.run([compiler, *flags, HERE / "roofline.cpp", "-o", program], capture_output=True, text=True)
    if done.returncode:
        return {"failed": done.stderr.strip().splitlines()[-1]}
    return json.loads(subprocess.run([program], capture_output=True, text=True, check=True).stdout)


def roofline(folder: Path, quick: bool) -> dict[str, Any]:
    """Peak rates, and for each case the time of one more iteration of one subset beside the two bounds.

    That time is the difference of runs that stop after two and after one iteration, so what a subset costs besides
    its iterations is not in it.
    """
    peak = machine(folder)
    if "failed" in peak:
        return {"machine": peak, "rows": []}
    scenes, pixels = Scenes(folder), SUBSET * SUBSET
    best = instruction_sets()[0]
    rows = []
    for degree in DEGREES:
        settings = {"spline_degree": degree, "tolerance_px": 1e-6}
        setup = {"mode": "video", "instruction_set": best, "settings": settings}
        with Worker("rgbd_dic", setup, folder) as worker:
            for motion in (shift(0.5, 0.5), TURNED_2, TURNED_6):
                scene = scenes.pair(motion)
                spent, done = [], []
                for count in (1, 2):
                    limited = {**settings, "max_iterations": count}
                    runs = [
                        worker.ask(
                            scene.reference, scene.target, homography=motion.homography.tolist(), settings=limited
                        )
                        for _ in range(4 if quick else 10)
                    ]
                    spent.append(min(float(run.arrays["icgn_s"]) for run in runs))
                    done.append(int(np.sum(runs[-1].arrays["iterations"], dtype=int)))
                rows.append(
                    {
                        "degree": degree,
                        "motion": motion.name,
                        "iteration_us": 1e6 * (spent[1] - spent[0]) / (done[1] - done[0]),
                        "arithmetic_us": 1e6 * pixels * fma_per_pixel(degree) / peak["fma_per_s"],
                        "loads_us": 1e6 * pixels * bytes_per_pixel(degree) / peak["loads_bytes_per_s"],
                    }
                )
    return {"machine": peak, "rows": rows}
