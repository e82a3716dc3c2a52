"""`make bench`: all measurements, their raw results and docs/benchmark.md. `--real`: the real images alone."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import accuracy
import chaining
import challenge
import comparison
import engine
import numpy as np
import recovery
import roofline
import speed
from document import page
from speckle import SIZE
from workers import ROOT

RAW = ROOT / "results/bench"


def main() -> int:
    """0; 1 if a real image is out of its tolerance."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--quick", action="store_true", help="fewer cases and repeats; docs/benchmark.md stays as it is"
    )
    parser.add_argument("--real", action="store_true", help="only the regression on real images")
    options = parser.parse_args()
    RAW.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        if options.real:
            return _real_alone(Path(folder))
        results = _measure(Path(folder), options.quick)
    name = "quick" if options.quick else "full"
    (RAW / f"{name}.json").write_text(json.dumps(results, indent=1, default=_plain))
    document = RAW / "benchmark.md" if options.quick else ROOT / "docs/benchmark.md"
    document.write_text(page(json.loads((RAW / f"{name}.json").read_text())))
    print(f"written: {document.relative_to(ROOT)}, {(RAW / f'{name}.json').relative_to(ROOT)}")
    return _report(results["checks"])


def _measure(folder: Path, quick: bool) -> dict[str, Any]:
    over = accuracy.patterns(quick)
    texture = over[0].texture
    still = accuracy.shift(0.5, 0.5)
    independent = len(engine.grid()) * (engine.STEP / engine.SUBSET) ** 2
    results: dict[str, Any] = {
        "machine": {
            "cpu": _cpu(),
            "cores": len(os.sched_getaffinity(0)),
            "instruction_sets": engine.instruction_sets(),
        },
        "scene": {
            "size_px": SIZE,
            "contrast": texture.contrast,
            "mean_gradient": texture.mean_gradient,
            "floor_px": float(texture.floor_px(still, 0.0).max()),
        },
        "defaults": dataclasses.asdict(engine.settings()),
        "tolerance_px": engine.settings().tolerance_px,
        "patterns": len(over),
        "to_floor_error": float(1 / np.sqrt(2 * len(over) * independent)),
    }
    parts: dict[str, Callable[[], Any]] = {
        "comparison": lambda: comparison.compare(folder, quick),
        "video": lambda: speed.video(folder, quick),
        "pairs": lambda: speed.pairs(folder, quick),
        "threads": lambda: speed.threads(folder, quick),
        "roofline": lambda: roofline.roofline(folder, quick),
        "recovery": lambda: recovery.recovery(quick),
        "chaining": lambda: chaining.measure(quick),
        "translations": lambda: accuracy.translations(over, quick),
        "warps": lambda: accuracy.warps(over, quick),
        "noise_levels": lambda: accuracy.noise_levels(over, quick),
        "choices": lambda: accuracy.choices(over, quick),
    }
    for name, part in parts.items():
        started = time.perf_counter()
        results[name] = part()
        print(f"{name}: {time.perf_counter() - started:.0f} s", flush=True)
    at = challenge.images()
    star = challenge.Star(at) if at else None
    results["star"] = challenge.choices(star, quick) if star else []
    results["checks"] = challenge.checks(star, at, folder) if star else []
    return results


def _real_alone(folder: Path) -> int:
    at = challenge.images()
    if at is None:
        print("pyvale, whose wheel carries the images, is not installed (make bench does it)", file=sys.stderr)
        return 1
    return _report(challenge.checks(challenge.Star(at), at, folder))


def _report(checks: list[dict[str, Any]]) -> int:
    for check in checks:
        if check["value"] is None:
            print(f"FAILED {check['name']}: {check['why']}")
        else:
            mark = "FAILED" if check["failed"] else "ok    "
            print(f"{mark} {check['name']}: {check['value']:.3g}, tolerance {check['limit']:.3g} ({check['why']})")
    return int(any(check["failed"] for check in checks))


def _cpu() -> str:
    """The model of the processor, or its architecture."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def _plain(value: Any) -> Any:
    """NumPy numbers and arrays as JSON has them."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} in the results")


if __name__ == "__main__":
    sys.exit(main())
