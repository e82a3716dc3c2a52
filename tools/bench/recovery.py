"""How the panel is found again, and what that costs: jumps, turns, a hidden half, a hand-held flight with gaps."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from engine import CAMERA, regions, settings
from numpy.typing import NDArray
from rgbd_dic_processing.core.search import SeedSource
from rgbd_dic_processing.core.settings import SearchSettings
from rgbd_dic_processing.core.subset_field import SubsetField
from rgbd_dic_processing.core.tracking import SubsetTracking
from scenes import FAR, PATTERNS, TURNED_6
from speckle import SIZE, Motion, Speckle, about_middle, camera_image, reference_image, shift, target_image

RATE_HZ = 60.0
DROPPED = 0.4  # share of the frames of the hand-held flight
NEAR = shift(2.3, 1.4)
JUMP = shift(300.4, -200.7)
TURNED_30 = about_middle("30 degrees", 30.0, moved_px=(2.3, 3.6))
HIDDEN_PX = SIZE // 2


def recovery(quick: bool) -> dict[str, Any]:
    """The second image of a pair, after a reference that it has nothing to do with in time; then the flight.

    Returns:
        "cases": a row for each motion; "flight": of the frames that are not dropped, how many were found, and how.
    """
    speckle, other = (Speckle(seed) for seed in PATTERNS[:2])
    reference = camera_image(reference_image(speckle))
    cases = [(motion.name, camera_image(target_image(speckle, motion)), motion) for motion in _motions(quick)]
    hidden = cases[0][1].copy()
    hidden[:, :HIDDEN_PX] = camera_image(reference_image(other))[:, :HIDDEN_PX]
    cases.append(("half of it behind another pattern", hidden, cases[0][2]))
    cases.append(("not there: another pattern", camera_image(reference_image(other)), None))
    return {
        "cases": [_case(*case, reference, repeats=2 if quick else 5) for case in cases],
        "flight": _flight(speckle, reference, frames=15 if quick else 90),
    }


def _motions(quick: bool) -> list[Motion]:
    return [NEAR, FAR, TURNED_30] if quick else [NEAR, FAR, JUMP, TURNED_6, TURNED_30]


def _case(name: str, image: NDArray, motion: Motion | None, reference: NDArray, repeats: int) -> dict[str, Any]:
    times = []
    for _ in range(repeats):
        tracking = _tracking(reference)
        started = time.process_time()
        field = tracking.track(2, image)
        times.append(time.process_time() - started)
    row = {"name": name, "source": field.seed_source.name, "cpu_ms": 1e3 * float(np.median(times))}
    return row | (_errors(field, tracking, motion, hidden=name.startswith("half")) if motion else {})


def _errors(field: SubsetField, tracking: SubsetTracking, motion: Motion, hidden: bool = False) -> dict[str, Any]:
    """Of the subsets that are wholly in view: the share that was found, and their RMS error [px]."""
    centres = tracking.reference.centres_px
    truth = motion(centres)
    reach = 16 * np.abs(motion.gradient(centres)).sum(axis=2)
    seen = ((truth - reach >= 0) & (truth + reach <= SIZE - 1)).all(axis=1)
    if hidden:
        seen &= truth[:, 0] - reach[:, 0] > HIDDEN_PX
    error = (field.moved_px - truth)[seen]
    found = np.isfinite(error[:, 0])
    return {
        "in_view": int(seen.sum()),
        "found": float(found.mean()),
        "rms_px": float(np.sqrt(np.mean(error[found] ** 2))) if found.any() else None,
    }


def _flight(speckle: Speckle, reference: NDArray, frames: int) -> dict[str, Any]:
    """Sway of 20 px and 1 degree at 0.3 to 3 Hz, some of its frames dropped at random."""
    random = np.random.default_rng(1)
    kept = np.flatnonzero(random.uniform(size=frames) >= DROPPED)
    rates, phases = random.uniform(0.3, 3, (3, 3)), random.uniform(0, 2 * np.pi, (3, 3))
    tracking = _tracking(reference)
    rows = []
    for k in kept + 1:
        sway = np.sum(np.sin(2 * np.pi * rates * k / RATE_HZ + phases) - np.sin(phases), axis=1) / 3
        motion = about_middle("sway", 1.0 * sway[2], moved_px=(20 * sway[0], 20 * sway[1]))
        field = tracking.track(round(k * 1e9 / RATE_HZ), camera_image(target_image(speckle, motion)))
        rows.append({"source": field.seed_source.name, **_errors(field, tracking, motion)})
    return {
        "frames": frames,
        "kept": len(kept),
        "sources": {s.name: sum(row["source"] == s.name for row in rows) for s in SeedSource},
        "found": min(row["found"] for row in rows),
        "rms_px": float(np.sqrt(np.mean([row["rms_px"] ** 2 for row in rows]))),
    }


def _tracking(reference: NDArray) -> SubsetTracking:
    tracking = SubsetTracking(CAMERA, regions(), settings(), SearchSettings())
    tracking.track(1, reference)
    return tracking
