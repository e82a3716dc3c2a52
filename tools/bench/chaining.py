"""Drift of a long flight against the truth: 1,000 frames from the reference alone, and over a keyframe every 50.

One simulated flight with its camera noise, ToF noise and handheld motion; both measurements see the same frames.
`tools/run python tools/bench/chaining.py` prints the table, with --json the numbers.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rgbd_dic_acquisition.simulator.flight import Flight, FlightSettings
from rgbd_dic_acquisition.simulator.ground_truth import save_regions
from rgbd_dic_processing.core.pipeline import Measurement, Pipeline
from rgbd_dic_processing.core.regions import Regions
from rgbd_dic_processing.core.regions_file import load_regions
from rgbd_dic_processing.core.settings import ProcessingSettings
from rgbd_dic_processing.summary import footprint_m

FRAMES, QUICK_FRAMES = 1000, 120
EVERY = (0, 50)  # frames between two keyframes; 0: the reference alone
PART = 0.1  # of the frames that "first" and "last" mean
FLIGHT = {"camera": {"supersampling": 2}}  # two rays a pixel, in x and in y, for speed
SETTINGS = {"correlation": {"step": 15}, "renewal": {"after_frames": 0}}
NAMES = {
    "keyframes": "keyframes",
    "valid": "valid frames",
    "first_um": "RMS error, first tenth [um]",
    "stated_first_um": "stated [um]",
    "last_um": "RMS error, last tenth [um]",
    "stated_last_um": "stated [um]",
    "last_px": "RMS error, last tenth [px]",
    "ratio": "RMS error / stated, all frames",
}


def measure(quick: bool = False) -> dict[str, Any]:
    """What became of the opening [um] in each of the two measurements, by "0" and "50" frames between keyframes.

    Returns:
        "frames", and for each measurement the numbers that `NAMES` explains.
    """
    frames = QUICK_FRAMES if quick else FRAMES
    rate_hz = FlightSettings().timing.camera_rate_hz
    flight = Flight(FlightSettings.from_mapping({**FLIGHT, "duration_s": frames / rate_hz}))
    exposures = [(ns, "image", k) for k, ns in enumerate(flight.camera_ticks().exposed_ns)]
    exposures += [(ns, "depth", k) for k, ns in enumerate(flight.tof_ticks().exposed_ns)]
    first_s = flight.camera_ticks().exposed_ns[0] * 1e-9
    made = (flight.calibration, _regions(flight, first_s), ProcessingSettings.from_mapping(SETTINGS))
    runs = {every: Pipeline(*made) for every in EVERY}
    measured: dict[int, list[Measurement]] = {every: [] for every in EVERY}
    for ns, kind, k in sorted(exposures):
        seen = flight.image(ns * 1e-9, k) if kind == "image" else flight.depth(ns * 1e-9, k).depth_m
        for every, pipeline in runs.items():
            if kind == "image" and every and k and k % every == 0:
                pipeline.tracking.renew_keyframe()
            add = pipeline.add_image if kind == "image" else pipeline.add_depth
            measured[every] += add(int(ns), seen)
    for every, pipeline in runs.items():
        measured[every] += pipeline.flush()
    return {"frames": frames, **{str(every): _figures(flight, measured[every]) for every in EVERY}}


def _regions(flight: Flight, first_s: float) -> Regions:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "regions.yaml"
        save_regions(flight, first_s, path)
        return load_regions(path)


def _figures(flight: Flight, measured: list[Measurement]) -> dict[str, float]:
    valid = [m for m in measured if m.opening.valid]
    truth = np.array([flight.crack(m.opening.stamp_ns * 1e-9).opening_m for m in valid])
    error = np.array([m.opening.opening_m for m in valid]) - truth + truth[0]
    stated = np.array([m.opening.u_opening_m for m in valid])
    part = max(1, round(PART * len(valid)))

    def rms_um(values: np.ndarray) -> float:
        return 1e6 * float(np.sqrt(np.mean(values**2)))

    return {
        "keyframes": len({m.field.keyframe_stamp_ns for m in valid}),
        "valid": len(valid),
        "first_um": rms_um(error[1 : part + 1]),  # the reference itself has no error
        "stated_first_um": rms_um(stated[1 : part + 1]),
        "last_um": rms_um(error[-part:]),
        "stated_last_um": rms_um(stated[-part:]),
        "last_px": 1e-6 * rms_um(error[-part:]) / footprint_m(valid[-1].field),
        "ratio": rms_um(error) / rms_um(stated),
    }


def table(figures: dict[str, Any]) -> str:
    """The numbers as a Markdown table, one column a measurement."""
    heads = ["from the reference alone" if not every else f"new keyframe every {every} frames" for every in EVERY]
    lines = [f"| {figures['frames']} frames | {' | '.join(heads)} |", "|---" * (1 + len(heads)) + "|"]
    for name, words in NAMES.items():
        cells = [f"{figures[str(every)][name]:.4g}" for every in EVERY]
        lines.append(f"| {words} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_FRAMES} frames in place of {FRAMES}")
    parser.add_argument("--json", action="store_true", help="print the numbers as JSON")
    options = parser.parse_args()
    figures = measure(options.quick)
    print(json.dumps(figures, indent=2) if options.json else table(figures))


if __name__ == "__main__":
    main()
