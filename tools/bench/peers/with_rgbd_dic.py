"""This project's engine, run as its peers are. setup["mode"]:

"video": one frame against a reference that was prepared before: seeds from a homography 0.3 px off, target, IC-GN;
    with setup["goes_on"], the one after another frame, whose threads and memory are still there.
"pair": all of a pair from nothing: reference, texture check, features, initial guess, target, IC-GN.
"""

import sys
import time
from pathlib import Path

import numpy as np
from serve import serve

sys.path.insert(0, str(Path(__file__).parents[1]))

import engine
from rgbd_dic_processing.core.correlation import ReferenceSubsets

PARTS = ("seeds_s", "filter_s", "icgn_s")


def prepare(reference, setup):
    engine.use_instruction_set(setup.get("instruction_set"))
    settings = engine.settings(**setup["settings"])
    if setup["mode"] == "pair":

        def correlate(target):
            field = engine.tracked(reference, target, settings)
            return _displacements(engine.grid(), field.moved_px)

        return correlate
    centres, homography = engine.grid(), np.array(setup["homography"])
    subsets, maps = ReferenceSubsets(reference, centres, settings), engine.seed_maps(centres, settings.threads)

    def correlate(image, homography=homography):
        clock = [_now()]
        seeds = engine.seeds(homography, maps)
        clock.append(_now())
        target = subsets.target(image)
        clock.append(_now())
        found = subsets.correlate(target, seeds)
        clock.append(_now())
        cpu, wall = np.diff(clock, axis=0).T
        parts = dict(zip(PARTS, cpu, strict=True)) | {f"wall_{name}": s for name, s in zip(PARTS, wall, strict=True)}
        moved = _displacements(centres, np.column_stack([found.x_px, found.y_px]))
        return {**moved, **parts, "iterations": found.iterations}

    if setup.get("goes_on"):
        correlate(reference, np.eye(3))
    return correlate


def _now():
    return time.process_time(), time.perf_counter()


def _displacements(centres, moved):
    away = moved - centres
    return {"x": centres[:, 0], "y": centres[:, 1], "u": away[:, 0], "v": away[:, 1]}


serve(prepare)
