"""The error sources of a laboratory, all switched off but one."""

from __future__ import annotations

from typing import Any

from .scenes import Values

# What is as it is in no real laboratory.
OFF: dict[str, dict[str, Any]] = {
    "camera": {"noise": False, "exposure_s": 0.0, "flicker": 0.0, "vignetting": 0.0, "lamp_gradient": 0.0},
    "tof": {"residual_rms_m": 0.0, "dropouts": 0.0, "wiggle_m": 0.0, "dark_offset_m": 0.0, "fixed_pattern_m": 0.0},
    "timing": {"tof_rate_hz": 60.0, "tof_phase_s": 0.0, "camera_skew_ppm": 0.0, "tof_skew_ppm": 0.0, "jitter_s": 0.0},
    "deformation": {"field": "rigid_half", "bow_m": 0.0, "bulge": 0.0, "step": 0.0},
}
# Error source -> the settings that are as usual again.
SOURCES: dict[str, tuple[str, ...]] = {
    "none": (),
    "image noise": ("camera.noise",),
    "motion blur": ("camera.exposure_s",),
    "light: flicker, vignetting, gradient": ("camera.flicker", "camera.vignetting", "camera.lamp_gradient"),
    "ToF noise": ("tof.residual_rms_m", "tof.dropouts", "tof.fixed_pattern_m"),
    "ToF wiggle": ("tof.wiggle_m",),
    "black reads farther": ("tof.dark_offset_m",),
    "ToF at 20 Hz, clocks that run free": tuple(f"timing.{name}" for name in OFF["timing"]),
    "bow": ("deformation.bow_m",),
    "bulge and step out of the plane": ("deformation.bulge", "deformation.step"),
    "no rigid part": ("deformation.field",),
}
EVERY = tuple(name for names in SOURCES.values() for name in names)
SOURCES |= {
    "all, left half rigid": tuple(name for name in EVERY if name != "deformation.field"),
    "all": EVERY,
}


def laboratory_with(source: str, seed: int, duration_s: float, scale: float) -> Values:
    """The laboratory in which only this error source is as usual."""
    on = SOURCES[source]
    values: Values = {
        group: {name: value for name, value in entries.items() if f"{group}.{name}" not in on}
        for group, entries in OFF.items()
    }
    values["camera"]["scale"] = scale
    return values | {"seed": seed, "duration_s": duration_s}


def field_with(source: str) -> str:
    """The deformation field of that laboratory."""
    return "beam" if "deformation.field" in SOURCES[source] else OFF["deformation"]["field"]
