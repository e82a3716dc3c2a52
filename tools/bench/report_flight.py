"""The parts of docs/benchmark.md about flights: the panel found again, and the drift of long ones."""

from __future__ import annotations

from typing import Any

import chaining
from cells import motion, px, share, table

SOURCES = {
    "REFERENCE": "itself",
    "PREDICTION": "prediction",
    "COARSE": "reduced image",
    "FEATURES": "features",
    "NONE": "lost, as it should be",
}


def search(results: dict[str, Any]) -> str:
    """Images that the one before does not tell of."""
    recovery = results["recovery"]
    lines = [
        (
            motion(row["name"]),
            SOURCES[row["source"]],
            f"{row['cpu_ms']:.0f}",
            f"{row['cpu_ms'] - recovery['cases'][0]['cpu_ms']:.0f}" if row is not recovery["cases"][0] else "",
            share(1 - row["found"]) if "found" in row else "",
            px(row.get("rms_px")),
        )
        for row in recovery["cases"]
    ]
    flight = recovery["flight"]
    how = ", ".join(f"{SOURCES[name]} {count}" for name, count in flight["sources"].items() if count)
    return f"""## Search

The image after the reference, one thread, all work counted; nothing is known of the motion. Lost: of the subsets that
are wholly in view. The last column is the RMS error of those found.

{table(("image", "found by", "CPU time [ms]", "more than the first [ms]", "lost", "RMS error [px]"), lines)}

Hand-held sway of 20 px and 1 degree at 0.3 to 3 Hz, {flight["frames"] - flight["kept"]} of {flight["frames"]} frames at
60 Hz dropped at random: the rest found by {how}; in the worst frame {share(1 - flight["found"])} of the subsets in view
lost; RMS error {flight["rms_px"]:.5f} px."""


def drift(results: dict[str, Any]) -> str:
    """Chaining over keyframes."""
    return f"""## Long flights

The opening in a simulated flight against its exact truth, from the reference alone and over a new keyframe every 50
frames ([what that is](method.md#long-flights)); the same images for both (`tools/bench/chaining.py`).

{chaining.table(results["chaining"])}"""
