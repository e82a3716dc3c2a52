"""Checks of what the two cameras send."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera

from ..core.pairing import FramePairing
from ..core.settings import PairingSettings
from .finding import Finding, Level, graded, not_checked
from .listening import Heard

GOOD_CLOCK_NS, BEARABLE_CLOCK_NS = 2_000_000, 10_000_000  # uncertainty of stamps
SATURATED = 254


def answers(name: str, heard: Heard, settings: str) -> Finding:
    """Whether a camera is there, and took what it was set to; a driver refuses anything else."""
    if heard.problem:
        return Finding(name, Level.FAIL, heard.problem, "docs/payload.md, wiring and drivers")
    who = heard.told.get("camera") or heard.told.get("device") or "it"
    lacking = heard.told.get("not done", "")
    text = f"{who}, {settings}" + (f"; not done: {lacking}" if lacking else "")
    return graded(name, text, "the camera does not do all that it was told to", not lacking, bearable=True)


def frame_rate(name: str, heard: Heard, wanted_hz: float) -> Finding:
    """Whether frames come as often as set; 0 is not set."""
    text = f"{heard.rate_hz:.2f} Hz" + (f", set are {wanted_hz:g} Hz" if wanted_hz else "")
    share = heard.rate_hz / wanted_hz if wanted_hz else 1.0
    remedy = "exposure shorter than a period? Cable, port and packet size for the whole rate? Then lower frame_rate_hz"
    return graded(name, text, remedy, abs(share - 1) <= 0.02, abs(share - 1) <= 0.1)


def lost_frames(name: str, heard: Heard) -> Finding:
    """Whether all frames arrived whole."""
    lost = sum(heard.counts[kind] for kind in ("lost", "incomplete", "failed"))
    sent = lost + len(heard.stamps_ns)
    remedy = "socket buffers or usbfs memory (below), the cable, an interface or port for this camera alone"
    return graded(name, f"{lost} of {sent} frames lost or broken", remedy, lost == 0, lost <= max(1, 0.01 * sent))


def camera_clock(name: str, heard: Heard) -> Finding:
    """Whether the stamps are known well enough to pair by."""
    text = heard.told.get("clock", "no stamp yet")
    latched = text.startswith("by latches")
    if heard.uncertainty_ns == float("inf"):
        return Finding(
            name, Level.WARN, text, "stamps are the arrival, or too new to tell: see docs/payload.md, Stamps"
        )
    remedy = "a busy computer answers late: end other programs"
    if not latched:
        remedy = "the shortest delivery remains in the stamps: aravis.delivery_s, pairing.tof_delay_s"
    good = latched and heard.uncertainty_ns <= GOOD_CLOCK_NS
    return graded(name, text, remedy, good, heard.uncertainty_ns <= BEARABLE_CLOCK_NS)


def brightness(pixels: NDArray[np.uint8]) -> Finding:
    """Whether the pattern is neither dark nor white all over; pixels: those of the panel, in any order."""
    name = "light"
    white, saturated = float(np.percentile(pixels, 95)), float(np.mean(pixels >= SATURATED))
    text = f"white of the panel at {white:.0f} of 255, {saturated:.1%} of it saturated"
    if saturated > 0.01:
        return graded(name, text, "less exposure_s or gain, or lamps farther away", False, saturated <= 0.1)
    remedy = "more light on the panel; then a longer exposure_s (mind the blur), then more gain"
    return graded(name, text, remedy, white >= 120, white >= 60)


def pairing(camera: Heard, tof: Heard, settings: PairingSettings) -> Finding:
    """How far apart in time images and their ToF frames are."""
    name = "pairing"
    if not camera.stamps_ns or not tof.stamps_ns:
        return not_checked(name, "it needs both cameras")
    pairs, made = [], FramePairing(settings)
    first, last = max(camera.stamps_ns[0], tof.stamps_ns[0]), min(camera.stamps_ns[-1], tof.stamps_ns[-1])
    heard = [(stamp, made.add_image) for stamp in camera.stamps_ns if first <= stamp <= last]
    for stamp, add in sorted([*heard, *((stamp, made.add_depth) for stamp in tof.stamps_ns)], key=lambda each: each[0]):
        pairs += add(stamp)
    pairs += made.flush()
    if not pairs:
        return not_checked(name, "the two cameras were not heard at the same time")
    offsets_s = np.array([pair.depth_offset_s for pair in pairs])
    paired = np.isfinite(offsets_s)
    far_ms = 1e3 * float(np.abs(offsets_s[paired]).max(initial=0))
    text = f"{paired.mean():.0%} of {len(pairs)} images have a ToF frame, at most {far_ms:.1f} ms away"
    remedy = "rates, lost frames and clocks of both cameras (above); pairing.max_offset_s"
    return graded(name, text, remedy, paired.mean() >= 0.99, paired.mean() >= 0.9)


def tof_intrinsics(calibrated: Camera, own: Camera | None) -> Finding:
    """Whether the calibration is of this ToF camera."""
    name = "ToF intrinsics"
    if own is None:
        return not_checked(name, "the ToF camera tells none")
    if (own.width, own.height) != (calibrated.width, calibrated.height):
        text = f"{own.width} x {own.height} px, calibrated are {calibrated.width} x {calibrated.height} px"
        return Finding(name, Level.FAIL, text, "give the calibration.yaml of this ToF camera at this size")
    apart = max(abs(own.fx / calibrated.fx - 1), abs(own.fy / calibrated.fy - 1))
    text = f"calibrated focal length {calibrated.fx:.1f} px, the camera's own {own.fx:.1f} px"
    return graded(name, text, "is the calibration of this ToF camera?", apart <= 0.02, bearable=True)
