"""The part of docs/benchmark.md about real images."""

from __future__ import annotations

from typing import Any

from cells import DEGREES, px, table


def real(results: dict[str, Any]) -> str:
    """Checks on real images, and what settings make of them."""
    if not results["checks"]:
        return "## Real images\n\nNot measured: pyvale, whose wheel carries them, is not installed."
    checks = [
        (
            row["name"],
            px(row["value"]),
            px(row["limit"]),
            "**no**" if row["failed"] else "yes",
            px(row.get("pyvale")),
            row["why"],
        )
        for row in results["checks"]
    ]
    lines = [
        (
            row["subset_size"],
            DEGREES[row["degree"]],
            "" if row["gradient_smoothing_px"] is None else f"{row['gradient_smoothing_px']:g}",
            f"{row['blur_px']:g}",
            f"{row['failed']:.1%}",
            px(row["noise_px"]),
            px(row["sigma_px"]),
            f"{row['noise_px'] / row['sigma_px']:.2f}",
            px(row["rms_px"]),
            f"{row['resolution_px']:.0f}",
        )
        for row in results["star"]
    ]
    header = (
        "subset [px]",
        "spline",
        "gradients smoothed [px]",
        "images blurred [px]",
        "lost",
        "noise [px]",
        "sigma [px]",
        "noise / sigma",
        "RMS error, period from 100 px [px]",
        "10 % lost at a period of [px]",
    )
    return f"""## Real images

`make bench-real` runs this part alone and fails if a value is beyond its tolerance. The images are those that the
pyvale
wheel carries: the star of the DIC Challenge 2.0, which has noise and a known displacement v = 0.5 cos(2 pi (y - 250) /
p),
p from 10 px at the left to 300 px at the right edge, and a rigid plate, rendered, with known shifts. A subset sees the
mean of
the field over itself, so the star's error is against that mean, where a period holds five subsets or more.

{table(("check", "measured", "tolerance", "within", "pyvale", "why this tolerance"), checks)}

Settings, on the star. Noise: RMS error against the field's mean over the subset, where a period holds five subsets:

{table(header, lines)}

{_settings_from(results["star"], results["defaults"])}"""


def _settings_from(star: list[dict[str, Any]], defaults: dict[str, Any]) -> str:
    usual = [
        row
        for row in star
        if row["degree"] == defaults["spline_degree"]
        and row["gradient_smoothing_px"] == defaults.get("gradient_smoothing_px")
    ]
    plain = {row["subset_size"]: row for row in usual if not row["blur_px"]}
    blurred = {row["subset_size"]: row for row in usual if row["blur_px"]}
    sizes = sorted(plain.keys() & blurred.keys())
    if not sizes:
        return ""
    size = 31 if 31 in sizes else sizes[0]
    one, other = plain[size], blurred[size]
    text = (
        f"Blurring both images changes the noise of a {size} px subset from {one['noise_px']:.4f} to "
        f"{other['noise_px']:.4f} px, loses {other['failed']:.1%} of the subsets instead of {one['failed']:.1%}, and "
        f"takes noise / sigma from {one['noise_px'] / one['sigma_px']:.2f} to "
        f"{other['noise_px'] / other['sigma_px']:.2f}, as neighbouring pixels no longer err independently. "
    )
    if other["noise_px"] > one["noise_px"]:
        text += "So noisy images are not blurred here: the subset is the filter. "
    if len(sizes) == 1:
        return text
    small, large = plain[sizes[0]], plain[sizes[-1]]
    return text + (
        f"From {sizes[0]} to {sizes[-1]} px of subset the noise falls from {small['noise_px']:.4f} to "
        f"{large['noise_px']:.4f} px, and a tenth of the amplitude is lost below a period of "
        f"{small['resolution_px']:.0f} and {large['resolution_px']:.0f} px. Where the surface hardly "
        "strains, as beside a crack, choose the larger subset; where strain changes over a hundred pixels, the smaller."
    )
