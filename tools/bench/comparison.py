"""This engine beside its peers: the same images, one core, asked in turn; CPU time and error against the truth."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
from engine import REGION, STEP, SUBSET
from scenes import FAR, NOISE, TURNED_6, WARP, Scene, Scenes, shifts
from workers import EngineError, Worker, errors, version

COMMON = {"region": REGION, "subset_size": SUBSET, "step": STEP, "tolerance_px": 1e-3}
OURS = {"video": "video against a fixed reference", "pair": "image pair, guess included"}
DEGREES = {3: "cubic", 5: "quintic"}
PEERS = [  # name, kind, adapter, package, setup
    ("pyvale, default blur", "DIC", "pyvale", "pyvale", {"blur_px": 1.0}),
    ("pyvale, no blur", "DIC", "pyvale", "pyvale", {}),
    ("al-dic, local", "DIC", "al_dic", "al-dic", {}),
    ("sun-dic", "DIC", "sun_dic", "sun-dic", {}),
    ("muDIC, global Q4", "DIC", "mudic", "muDIC", {}),
    ("OpenCV PyrLK, 31 x 31", "flow", "opencv", "opencv-contrib-python-headless", {}),
]


def engines() -> list[dict[str, Any]]:
    """All that are compared: name, kind ("pair", "video", "DIC" or "flow"), adapter, setup."""
    ours = [
        {
            "name": f"this engine, {name}, {OURS[mode]}",
            "kind": mode,
            "degree": degree,
            "adapter": "rgbd_dic",
            "setup": {"mode": mode, "settings": {"spline_degree": degree}},
        }
        for mode in OURS
        for degree, name in DEGREES.items()
    ]
    peers = [
        {"name": f"{name} ({version(package)})", "kind": kind, "adapter": adapter, "setup": {**COMMON, **setup}}
        for name, kind, adapter, package, setup in PEERS
    ]
    return ours + peers


def compare(folder: Path, quick: bool) -> list[dict[str, Any]]:
    """One row an engine: speed from the shifts with quantisation only, errors of all pairs.

    A row whose engine failed on every pair has the reason under "failed"; one that failed on some, under "failures".
    """
    scenes = Scenes(folder)
    motions = shifts()[2:3] if quick else shifts()
    rounds = [("shift", scenes.pair(motion)) for motion in motions]
    rounds += [("noise", scenes.pair(motion, NOISE)) for motion in motions]
    rounds += [("warp", scenes.pair(WARP))]
    if not quick:
        rounds += [("far", scenes.pair(FAR)), ("turn", scenes.pair(TURNED_6))]
    chosen = engines()
    with contextlib.ExitStack() as stack:
        workers = [_started(engine, folder, stack) for engine in chosen]
        for worker in workers:
            _ask(worker, rounds[0][1])  # compiles and warms up
        answers = [[] for _ in chosen]
        for kind, scene in rounds:
            for worker, given in zip(workers, answers, strict=True):
                given.append((kind, scene, _ask(worker, scene)))
    return [_row(engine, given) for engine, given in zip(chosen, answers, strict=True)]


def _started(engine: dict[str, Any], folder: Path, stack: contextlib.ExitStack) -> Worker | str:
    try:
        return stack.enter_context(Worker(engine["adapter"], engine["setup"], folder))
    except (EngineError, OSError) as error:
        return str(error)


def _ask(worker: Worker | str, scene: Scene) -> dict[str, Any]:
    if isinstance(worker, str):
        return {"failed": worker}
    try:
        run = worker.ask(scene.reference, scene.target, homography=scene.motion.homography.tolist())
    except EngineError as error:
        return {"failed": str(error)}
    found = errors(run, scene.motion)
    return {
        "cpu_s": run.cpu_s,
        "points": found.points,
        "lost": found.lost,
        "bias_px": found.bias_px.tolist(),
        "std_px": found.std_px.tolist(),
    }


def _row(engine: dict[str, Any], given: list[tuple[str, Scene, dict[str, Any]]]) -> dict[str, Any]:
    row = {name: engine.get(name) for name in ("name", "kind", "degree")}
    failures = [answer["failed"] for _, _, answer in given if "failed" in answer]
    of = {kind: [a for k, _, a in given if k == kind and "failed" not in a] for kind, _, _ in given}
    if not of["shift"]:
        return {**row, "failed": failures[0]}
    row["failures"] = failures
    speeds = [answer["points"] * (1 - answer["lost"]) / answer["cpu_s"] for answer in of["shift"]]
    row |= {
        "points": of["shift"][0]["points"],
        "points_per_s": float(np.median(speeds)),
        "points_per_s_range": [min(speeds), max(speeds)],
        "bias_px": _largest(of["shift"], "bias_px"),
        "std_px": _rms(of["shift"], "std_px"),
        "warp_bias_px": _largest(of["warp"], "bias_px"),
        "warp_std_px": _rms(of["warp"], "std_px"),
        "noise_bias_px": _largest(of["noise"], "bias_px"),
        "noise_std_px": _rms(of["noise"], "std_px"),
        "pairs": [{"kind": kind, "motion": scene.motion.name, **answer} for kind, scene, answer in given],
        "lost": {kind: max(answer.get("lost", 1.0) for k, _, answer in given if k == kind) for kind in of},
    }
    return row


def _largest(answers: list[dict[str, Any]], name: str) -> float | None:
    values = [abs(value) for answer in answers for value in answer[name] if np.isfinite(value)]
    return max(values, default=None)


def _rms(answers: list[dict[str, Any]], name: str) -> float | None:
    values = [value for answer in answers for value in answer[name] if np.isfinite(value)]
    return float(np.sqrt(np.mean(np.square(values)))) if values else None
