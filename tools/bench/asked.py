"""What the engine is asked to reach, beside what was measured, and the reason where it is not met."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from cells import motion

VIDEO = {3: 200e3, 5: 130e3}  # points/s/thread on AVX-512
PAIR = 100e3
LESS = 2 / 3  # of that on AVX2
WIDE = ("avx512",)


@dataclass(frozen=True)
class Row:
    """One thing asked: a bound, what was measured, whether it is met (None: not measured), and why not."""

    what: str
    asked: str
    measured: str
    met: bool | None
    why: str = ""


def rows(results: dict[str, Any]) -> list[Row]:
    """All that the results can answer."""
    return [*_accuracy(results), *_speed(results), *_flight(results), *_real(results)]


def _accuracy(results: dict[str, Any]) -> Iterator[Row]:
    for noise, limit in ((0.0, 1e-4), (2.0, 6e-4)):
        cases = [case for case in results["translations"] if case["noise"] == noise]
        worst = max(cases, key=lambda case: case["bias_px"])
        name = f"noise of {noise:g} grey levels" if noise else "quantisation only"
        yield Row(
            f"bias at every shift, {name} [px]",
            f"at most {limit:.4f}",
            f"{worst['bias_px']:.5f} at {worst['shift_px']:g} px",
            worst["bias_px"] <= limit,
            f"it is known to {worst['bias_error_px']:.5f} px, the standard error of the mean",
        )
    groups = {"shifts": "translations", "warps": "warps", "noise of 0 to 4 % of full scale": "noise_levels"}
    for name, cases in ((name, results[group]) for name, group in groups.items()):
        cases = [case for case in cases if "to_floor" in case]
        worst = max(cases, key=lambda case: case["to_floor"])
        where = motion(worst["motion"]) if "motion" in worst else f"shift {worst['shift_px']:g} px"
        over = sum(case["to_floor"] > 1.05 for case in cases)
        yield Row(
            f"standard deviation over the Cramer-Rao bound, {name}",
            "at most 1.05",
            f"{worst['to_floor']:.3f} ({where}, noise {worst['noise']:g})",
            worst["to_floor"] <= 1.05,
            f"{over} of {len(cases)} cases are above; each is known to about {results['to_floor_error']:.3f}",
        )
    for case in results["warps"]:
        if case["motion"] in ("23 px", "6 degrees") and case["noise"] == 0:
            yield Row(f"subsets lost at {case['motion']}", "0", str(case["failed"]), case["failed"] == 0)
    for name in ("noise_levels", "warps"):
        cases = [case for case in results[name] if case.get("sigma_ratio")]
        worst = max(cases, key=lambda case: abs(case["sigma_ratio"] - 1))
        over = [case for case in cases if abs(case["sigma_ratio"] - 1) > 0.1]
        where = ", ".join(sorted({motion(case["motion"]) for case in over}))
        yield Row(
            "error over sigma, " + ("noise of 0 to 4 % of full scale" if name == "noise_levels" else "warps"),
            "standard deviation 0.9 to 1.1",
            f"{worst['sigma_ratio']:.3f} ({motion(worst['motion'])}, noise {worst['noise']:g})",
            not over,
            f"outside for: {where}",
        )


def _speed(results: dict[str, Any]) -> Iterator[Row]:
    for case in results["video"]:
        if not case["motion"].startswith("shift") or "tolerance_px" in case["settings"]:
            continue
        asked = _asked(VIDEO[case["degree"]], case["instruction_set"])
        if asked:
            parts = case["parts_ms"]
            yield Row(
                f"video, {_degree(case)}, {case['instruction_set']} [points/s/thread]",
                f"at least {asked:,.0f}",
                f"{case['points_per_s']:,.0f}",
                case["points_per_s"] >= asked,
                f"of {sum(parts.values()):.1f} ms, correlate() takes {parts['icgn_s']:.1f}, "
                f"target() {parts['filter_s']:.1f} and the seeds {parts['seeds_s']:.1f}",
            )
    for case in results["pairs"]:
        asked = _asked(PAIR, case["instruction_set"])
        if asked and case["motion"].startswith("shift"):
            video = next(
                v
                for v in results["video"]
                if (v["motion"], v["degree"], v["instruction_set"])
                == (case["motion"], case["degree"], case["instruction_set"])
            )
            whole, frame = (1e3 * c["points"] / c["points_per_s"] for c in (case, video))
            yield Row(
                f"image pair, guess included, {_degree(case)}, {case['instruction_set']} [points/s/thread]",
                f"at least {asked:,.0f}",
                f"{case['points_per_s']:,.0f}",
                case["points_per_s"] >= asked,
                f"of {whole:.0f} ms, the frame itself takes {frame:.0f}; the rest is the reference, its check for "
                "texture, and the guess",
            )
    yield from _ratios(results)
    for case in results["threads"]:
        gain, ceiling = case["wall_s"][0] / case["wall_s"][1], 2 * case["beside_s"][0] / case["beside_s"][1]
        yield Row(
            f"two threads against one, {case['name']}",
            "at least 1.85 times",
            f"{gain:.2f} times",
            gain >= 1.85,
            f"two processes of one thread each do {ceiling:.2f} times the work of one here",
        )


def _ratios(results: dict[str, Any]) -> Iterator[Row]:
    known = [row for row in results["comparison"] if "failed" not in row]
    for kind, name, factor in (("DIC", "the fastest DIC engine from PyPI", 15.0), ("flow", "OpenCV PyrLK", 1.5)):
        others = [row for row in known if row["kind"] == kind]
        ours = [row for row in known if row["kind"] == "pair" and row["degree"] == results["defaults"]["spline_degree"]]
        if not others or not ours:
            yield Row(f"image pair beside {name}", f"at least {factor:g} times", "not measured", None, "it did not run")
            continue
        fastest = max(others, key=lambda row: row["points_per_s"])
        for row in ours:
            ratio = row["points_per_s"] / fastest["points_per_s"]
            yield Row(
                f"image pair, {_degree(row)}, beside {name}",
                f"at least {factor:g} times",
                f"{ratio:.2f} times {fastest['name']}",
                ratio >= factor,
                f"{row['points_per_s']:,.0f} against {fastest['points_per_s']:,.0f} points/s/thread",
            )


def _flight(results: dict[str, Any]) -> Iterator[Row]:
    cases = [case for case in results["recovery"]["cases"] if "found" in case]
    least = min(cases, key=lambda case: case["found"])
    yield Row(
        "found in the first image: a jump, a turn, half of it hidden",
        f"all {len(cases)}, 99 % of the subsets in view",
        f"{sum(case['found'] > 0 for case in cases)}, at least {least['found']:.1%}",
        least["found"] >= 0.99,
        f"fewest for: {motion(least['name'])}",
    )
    flight = results["recovery"]["flight"]
    yield Row(
        "found with 40 % of the frames dropped",
        "all frames, 99 % of the subsets in view",
        f"{flight['kept'] - flight['sources']['NONE']} of {flight['kept']}, at least {flight['found']:.1%}",
        flight["sources"]["NONE"] == 0 and flight["found"] >= 0.99,
    )
    for name, words in (("0", "from the reference alone"), ("50", "over keyframes")):
        ratio = results["chaining"][name]["ratio"]
        yield Row(
            f"error over stated uncertainty, {results['chaining']['frames']:,} frames {words}",
            "at most 1.1",
            f"{ratio:.2f}",
            ratio <= 1.1,
            "the opening's uncertainty is too small",
        )


def _real(results: dict[str, Any]) -> Iterator[Row]:
    checks = results["checks"]
    failed = [check["name"] for check in checks if check["failed"]]
    yield Row(
        "real images within their tolerances",
        f"all {len(checks)}" if checks else "all",
        f"{len(checks) - len(failed)}" if checks else "not measured",
        not failed if checks else None,
        "; ".join(failed) if checks else "pyvale is not installed",
    )


def _asked(wide: float, instruction_set: str | None) -> float | None:
    if instruction_set is None or instruction_set.startswith(WIDE):
        return wide
    return LESS * wide if instruction_set.startswith("avx2") else None


def _degree(case: dict[str, Any]) -> str:
    return {3: "cubic", 5: "quintic"}[case["degree"]]
