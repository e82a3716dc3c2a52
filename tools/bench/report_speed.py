"""The parts of docs/benchmark.md about speed."""

from __future__ import annotations

from typing import Any

from cells import DEGREES, instructions, motion, px, ratio, share, table
from roofline import bytes_per_pixel, fma_per_pixel


def peers(results: dict[str, Any]) -> str:
    """This engine beside the others."""
    known = [row for row in results["comparison"] if "failed" not in row]
    fastest = max((row["points_per_s"] for row in known if row["kind"] == "DIC"), default=None)
    flow = max((row["points_per_s"] for row in known if row["kind"] == "flow"), default=None)
    lines = []
    for row in results["comparison"]:
        if "failed" in row:
            lines.append((row["name"], f"failed: {row['failed']}", *[""] * 9))
            continue
        lost, failures = row["lost"], row["failures"]
        lines.append(
            (
                row["name"] + (f"; failed on {len(failures)} pairs: {failures[0]}" if failures else ""),
                f"{row['points_per_s']:,.0f}",
                ratio(row["points_per_s"], fastest),
                ratio(row["points_per_s"], flow),
                px(row["bias_px"]),
                px(row["std_px"]),
                px(row["noise_bias_px"], 4),
                px(row["noise_std_px"], 4),
                px(row["warp_bias_px"], 4),
                px(row["warp_std_px"]),
                ", ".join(share(lost[kind]) for kind in ("warp", "far", "turn") if kind in lost),
            )
        )
    header = (
        "engine",
        "points/s/thread",
        "to fastest peer",
        "to PyrLK",
        "bias",
        "std",
        "bias, noise 2",
        "std, noise 2",
        "bias, warp",
        "std, warp",
        "lost: warp, 23 px, 6 degrees",
    )
    return f"""## Beside the peers

CPU time of the process around the correlation, without import and reading; median over the shifts. Bias: the largest of
the shifts 0.1 to 0.9 px along both axes; standard deviation: RMS over them; both again with noise of 2 grey levels in
both
images. Warp: rotation by 1 degree, scale 1.01, perspective of 2e-5 /px; a subset whose warp is affine only is biased by
perspective. Lost: not found, or more than 0.5 px off. All in px.

{table(header, lines)}

Tolerance 1e-3 px for the peers, each one's own default for the rest; this engine has its defaults but for the degree.
In
"video" the reference is prepared before and the seed is a homography 0.3 px off; "image pair" starts from the two
images
alone, as the peers do. al-dic takes steps of 8 px only (11,881 points); muDIC solves for the nodes of a mesh of 30 px
(900
nodes); PyrLK solves for a translation. pyvale writes its result to a file within its time, in memory; sun-dic reads its
images."""


def speed(results: dict[str, Any]) -> str:
    """This engine alone."""
    video = [
        (
            motion(row["motion"]),
            DEGREES[row["degree"]],
            instructions(row),
            f"{row['settings'].get('tolerance_px', results['tolerance_px']):g}",
            f"{row['points_per_s']:,.0f}",
            f"{row['points_per_s_range'][0]:,.0f} to {row['points_per_s_range'][1]:,.0f}",
            *(f"{row['parts_ms'][part]:.1f}" for part in ("seeds_s", "filter_s", "icgn_s")),
            f"{row['iterations']:.2f}",
        )
        for row in results["video"]
    ]
    pairs = [
        (
            motion(row["motion"]),
            DEGREES[row["degree"]],
            instructions(row),
            f"{row['points_per_s']:,.0f}",
            f"{row['points_per_s_range'][0]:,.0f} to {row['points_per_s_range'][1]:,.0f}",
            f"{1e3 * row['found'] / row['points_per_s']:.0f}",
            f"{row['points'] - row['found']}",
        )
        for row in results["pairs"]
    ]
    threads = [
        (
            row["name"],
            *(f"{1e3 * wall:.1f}" for wall in row["wall_s"]),
            f"{row['wall_s'][0] / row['wall_s'][1]:.2f}",
            f"{row['parts_s']['icgn_s'][0] / row['parts_s']['icgn_s'][1]:.2f}",
            f"{2 * row['beside_s'][0] / row['beside_s'][1]:.2f}",
        )
        for row in results["threads"]
    ]
    video_header = (
        "motion",
        "spline",
        "instructions",
        "tolerance [px]",
        "points/s/thread",
        "range",
        "seeds [ms]",
        "target() [ms]",
        "correlate() [ms]",
        "iterations",
    )
    pair_header = ("motion", "spline", "instructions", "points/s/thread", "range", "CPU time [ms]", "lost")
    thread_header = (
        "spline",
        "one thread [ms]",
        "two [ms]",
        "gain",
        "gain of correlate() alone",
        "two processes against one",
    )
    return f"""## Speed of this engine

Video: a frame against a fixed reference; all of its work is counted: seed maps from a homography that is 0.3 px off,
target(), correlate(). The pre-filter is part of one of the two.

{table(video_header, video)}

Image pair: reference, its check for texture, features, guess, pre-filter, IC-GN.

{table(pair_header, pairs)}

Threads: wall time of a frame turned by 2 degrees, of a video that goes on: another frame was measured just before, so
the kernel's threads wait, and memory is there. The fastest of the repeats, as other programs only add to it. Two
processes of one thread each, which share nothing but the machine, tell what its second core is worth.

{table(thread_header, threads) if threads else "Not measured: one core only."}"""


def roofline(results: dict[str, Any]) -> str:
    """Beside what the machine can do."""
    found = results["roofline"]
    peak = found["machine"]
    if "failed" in peak:
        return f"## Roofline\n\nNot measured: {peak['failed']}."
    lines = []
    for row in found["rows"]:
        bound = max(row["arithmetic_us"], row["loads_us"])
        lines.append(
            (
                DEGREES[row["degree"]],
                motion(row["motion"]),
                f"{row['iteration_us']:.2f}",
                f"{row['arithmetic_us']:.2f}",
                f"{row['loads_us']:.2f}",
                f"{row['iteration_us'] / bound:.1f}",
            )
        )
    header = ("spline", "motion", "measured [us]", "arithmetic [us]", "L1 loads [us]", "measured / larger bound")
    return f"""## Roofline

One more iteration of one subset of 31 x 31 px (difference of runs that stop after two and after one), beside the
least
that it needs. A core of this machine does {peak["fma_per_s"] / 1e9:.0f} G float32 multiply-adds a second in registers
and
loads {peak["loads_bytes_per_s"] / 1e9:.0f} GB/s from its first-level cache, with vectors of {peak["vector_bytes"]}
bytes
(`tools/bench/roofline.cpp`). A pixel needs {fma_per_pixel(3)} multiply-adds with the cubic and {fma_per_pixel(5)} with
the
quintic spline: position and fraction 8, weights of both axes 20 or 48, taps (p + 1)^2 + (p + 1), sums 7. It loads
{bytes_per_pixel(3)} or {bytes_per_pixel(5)} bytes if each tap is loaded once, with no tap kept for the next pixel.

{table(header, lines)}"""
