"""Where the time of one frame goes: the steps of the method by themselves, on one thread, without ROS."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from case import Case, settings_of
from flight import EVERY, PHASE, RATE_HZ, Flight, depth_index, image_index
from rgbd_dic_acquisition.calibration import load_calibration
from rgbd_dic_processing.core.pipeline import Pipeline
from rgbd_dic_processing.core.regions_file import load_regions

FRAMES = 60
START_NS = 1_000_000_000
STEPS = ("DIC", "plane", "motion and displacement", "for later frames", "opening")


def stages(played: Flight, subsets: int, settings: str) -> dict[str, float]:
    """Step -> CPU time [ms], mean of its calls: one an image, but one a depth frame for the plane."""
    chosen = settings_of(Case(subsets, False, 0.0, settings=settings, threads=1))
    pipeline = Pipeline(load_calibration(played.calibration), load_regions(played.regions), chosen)
    took: dict[str, list[float]] = {name: [] for name in STEPS}
    displacement = pipeline.displacement["h_pose"]
    for name, owner, method in (
        ("DIC", pipeline.tracking, "track"),
        ("plane", pipeline.planes, "_estimate"),
        ("motion and displacement", displacement, "_measure"),
        ("for later frames", displacement, "_learn_alone"),  # with the default settings a part of the step before
        ("opening", pipeline.crack, "measure_with_parts"),
    ):
        setattr(owner, method, _timed(getattr(owner, method), took[name]))
    for tick in range(FRAMES):
        pipeline.add_image(START_NS + round(tick / RATE_HZ * 1e9), played.images[image_index(tick)])
        if tick % EVERY == 0:
            depth_m = played.depths[depth_index(tick // EVERY)] * np.float32(1e-3)
            depth_m[depth_m == 0] = np.nan
            pipeline.add_depth(START_NS + round((tick + PHASE) / RATE_HZ * 1e9), depth_m)
    return {name: float(np.mean(times[1:]) * 1e3) if times else 0.0 for name, times in took.items()}


def _timed(step: Callable[..., Any], took: list[float]) -> Callable[..., Any]:
    def timed(*arguments: Any) -> Any:
        start_s = time.process_time()
        result = step(*arguments)
        took.append(time.process_time() - start_s)
        return result

    return timed
