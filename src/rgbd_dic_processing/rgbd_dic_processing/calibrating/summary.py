"""What was estimated, as people read it and as estimates.yaml keeps it."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from .calibrate import Calibrated

MEANINGS = {  # parameter -> unit for people, factor to it, meaning
    "fx": ("px", 1.0, "focal length, horizontal"),
    "fy": ("px", 1.0, "focal length, vertical"),
    "cx": ("px", 1.0, "principal point, column"),
    "cy": ("px", 1.0, "principal point, row"),
    "k1": ("", 1.0, "radial distortion, 2nd order"),
    "k2": ("", 1.0, "radial distortion, 4th order"),
    "about_x": ("deg", 180 / math.pi, "rotation vector, x; its uncertainty is a turn about the camera's x axis"),
    "about_y": ("deg", 180 / math.pi, "rotation vector, y"),
    "about_z": ("deg", 180 / math.pi, "rotation vector, z"),
    "x": ("mm", 1e3, "ToF sensor's origin in the camera's frame, x"),
    "y": ("mm", 1e3, "ToF sensor's origin in the camera's frame, y"),
    "z": ("mm", 1e3, "ToF sensor's origin in the camera's frame, z"),
    "bias": ("mm", 1e3, "measured less true range, mean over the boards"),
    "slope": ("mm/m", 1e3, "change of the bias with range"),
    "dark": ("mm", 1e3, "how much farther dark parts seem than light ones"),
}


class Row(NamedTuple):
    """One estimate for people: numbers with as many digits as their uncertainty is worth."""

    name: str
    value: str
    sigma: str
    unit: str
    meaning: str


def rows(result: Calibrated) -> list[Row]:
    """All estimates with their standard uncertainties."""
    estimate = result.estimate
    known = list(zip(estimate.names, estimate.values, estimate.sigmas, strict=True))
    if (b := result.bias) is not None:
        known += [
            ("range.bias", b.bias_m, b.u_bias_m),
            ("range.slope", b.slope, b.u_slope),
            ("range.dark", b.dark_m, b.u_dark_m),
        ]
    return [row(name, value, sigma) for name, value, sigma in known if math.isfinite(value)]


def save_estimates(result: Calibrated, path: Path, inputs: dict[str, Any], versions: dict[str, str]) -> None:
    """estimates.yaml: every number in SI units and pixels, with what it rests on."""
    estimate, bias = result.estimate, result.bias
    content: dict[str, Any] = {
        "estimates": {
            name: {"value": float(value), "u": _short(sigma)}
            for name, value, sigma in zip(estimate.names, estimate.values, estimate.sigmas, strict=True)
        }
    }
    if bias is not None:
        content["range"] = {
            "bias_m": {"value": _short(bias.bias_m), "u": _short(bias.u_bias_m)},
            "slope": {"value": _short(bias.slope), "u": _short(bias.u_slope)},
            "dark_m": {"value": _short(bias.dark_m), "u": _short(bias.u_dark_m)},
            "noise_m": _short(bias.noise_m),
        }
    content["views"] = [
        {
            "name": view.name,
            **{
                f"{sensor}_{what}_px": round(float(getattr(estimate.fits[index, sensor], f"{what}_px")), 5)
                for sensor in ("camera", "tof")
                if view.of(sensor)
                for what in ("rms", "noise")
            },
        }
        for index, view in enumerate(result.views)
    ]
    content["skipped"] = [dataclasses.asdict(skipped) for skipped in result.skipped]
    content |= {"inputs": inputs, "board": result.board.settings.as_dict(), "settings": result.settings.as_dict()}
    content["versions"] = versions
    head = (
        "# Estimates with standard uncertainties u (docs/calibration.md): pixels, metres, radians.\n"
        "# What the measurement reads is calibration.yaml.\n"
    )
    path.write_text(head + yaml.safe_dump(content, sort_keys=False))


def _short(value: float) -> float:
    """Five digits: those beyond depend on the number of threads."""
    return float(f"{value:.5g}")


def row(name: str, value: float, sigma: float) -> Row:
    """An estimate `camera.fx` [px], `T_camera_tof.x` [m], ... of which the uncertainty may be unknown: NaN."""
    unit, factor, meaning = MEANINGS[name.split(".")[1]]
    if not (np.isfinite(sigma) and sigma > 0):
        return Row(name, f"{factor * value:.6g}", "–", unit, meaning)
    digits = max(0, 1 - math.floor(math.log10(factor * sigma)))
    return Row(name, f"{factor * value:.{digits}f}", f"{factor * sigma:.{digits}f}", unit, meaning)
