"""Errors of this engine against exact truth, beside the Cramer-Rao bound of each pair."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import engine
import numpy as np
from comparison import DEGREES
from cramer_rao import Texture
from numpy.typing import NDArray
from rgbd_dic_processing.core.correlation import CorrelationSettings
from scenes import FAR, NOISE, PATTERNS, TURNED_2, TURNED_6, WARP
from speckle import SIZE, Motion, Speckle, about_middle, camera_image, reference_image, shift, target_image

LEVELS = (0.0, 1.0, 2.0, 5.0, 10.0)  # grey levels of added noise: 0 to 4 % of full scale
GAIN, OFFSET = 0.6, 40.0  # of a target under another light
SMOOTHING_PX = (0.0, 0.5, 1.0, 1.5)  # of the reference's gradients, where the engine offers it
BLURS_PX = (0.7, 1.0)  # of both images before the engine sees them
CHOICE_SHIFTS = (0.1, 0.2, 0.3, 0.4, 0.8)  # px
SHIFTS = np.round(np.arange(0, 1.05, 0.1), 1).tolist()
MOTIONS = [
    FAR,
    about_middle("1 % stretch, 0.5 % shear", scale=1.01, shear=0.005, moved_px=(0.3, 0.7)),
    WARP,
    about_middle("strong perspective", angle_deg=3.0, perspective=(1e-4, -5e-5), moved_px=(5.3, 2.1)),
    TURNED_2,
    TURNED_6,
    *(about_middle(f"{angle} degrees", angle, moved_px=(0.3, 0.6)) for angle in (15, 30, 45)),
    *(about_middle(f"scale {scale:g}", scale=scale, moved_px=(0.3, 0.6)) for scale in (0.8, 0.9, 1.1, 1.25)),
]


@dataclass(frozen=True)
class Outcome:
    """Errors (N, 2) [px] of the subsets that were found, their sigmas (N, 2) [px], how many were sought, and the
    bound (2,) [px]."""

    errors_px: NDArray
    sigmas_px: NDArray
    sought: int
    floor_px: NDArray


class Pattern:
    """A pattern with what is needed again and again: its reference image and its texture."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._speckle = Speckle(seed)
        self._grey = reference_image(self._speckle)
        self.texture = Texture(self._speckle, SIZE, engine.grid(), engine.SUBSET)
        self._targets: dict[str, NDArray] = {}

    def find(
        self,
        motion: Motion,
        settings: CorrelationSettings,
        noise: float = 0.0,
        draw: int = 0,
        gain: float = 1.0,
        offset: float = 0.0,
        blur_px: float = 0.0,
    ) -> Outcome:
        """Correlate the pattern with the moved one, from seeds 0.3 px off; `draw` numbers the draws of the noise.

        A subset is sought if it can be wholly inside the target, with two pixels to spare.
        """
        if motion.name not in self._targets:
            self._targets[motion.name] = target_image(self._speckle, motion).astype(np.float32)  # to 1e-5 grey levels
        target = gain * self._targets[motion.name].astype(float) + offset
        seeds = 1000 * self._seed + 2 * draw
        images = [camera_image(self._grey, noise, seeds), camera_image(target, noise, seeds + 1)]
        if blur_px:
            images = [cv2.GaussianBlur(image.astype(np.float32), (0, 0), blur_px) for image in images]
        centres = engine.grid()
        half = engine.SUBSET // 2
        corners = [motion(centres + half * np.array(corner)) for corner in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        kept = np.all([(corner > 2) & (corner < SIZE - 3) for corner in corners], axis=(0, 2))
        found = engine.found(*images, motion.homography, centres[kept], settings)
        errors = np.column_stack([found.x_px, found.y_px]) - motion(centres[kept].astype(float))
        sigmas = np.column_stack([found.sigma_x_px, found.sigma_y_px])
        floor = self.texture.floor_px(motion, noise, kept)
        return Outcome(errors[found.valid], sigmas[found.valid], int(kept.sum()), floor)


def row(outcomes: list[Outcome]) -> dict[str, Any]:
    """What the outcomes of one case say together.

    bias_px: the largest of the mean errors along x and y; bias_error_px: its standard error, with as many independent
    subsets as fit side by side. to_floor: RMS of the errors about their mean over the bound. sigma_ratio: standard
    deviation of error over stated sigma. failed: subsets not found, of those sought.
    """
    errors = np.concatenate([outcome.errors_px for outcome in outcomes])
    sought = sum(outcome.sought for outcome in outcomes)
    if not len(errors):
        return {"sought": sought, "failed": sought}
    bias = errors.mean(axis=0)
    floor = np.sqrt(np.mean([outcome.floor_px**2 for outcome in outcomes], axis=0))
    independent = sought * (engine.STEP / engine.SUBSET) ** 2
    ratios = np.concatenate([outcome.errors_px / outcome.sigmas_px for outcome in outcomes])
    return {
        "sought": sought,
        "failed": sought - len(errors),
        "bias_px": float(np.abs(bias).max()),
        "bias_error_px": float(errors.std() / np.sqrt(independent)),
        "std_px": float(errors.std(axis=0).max()),
        "floor_px": float(floor.max()),
        "to_floor": float((errors.std(axis=0) / floor).max()),
        "sigma_ratio": float(ratios.std()) if np.isfinite(ratios).all() else None,
    }


def patterns(quick: bool) -> list[Pattern]:
    """The patterns that results are taken over."""
    return [Pattern(seed) for seed in PATTERNS[: 1 if quick else None]]


def translations(over: list[Pattern], quick: bool) -> list[dict[str, Any]]:
    """Each shift along both axes: quantisation only, and with noise; default settings."""
    rows = []
    for value in SHIFTS[:: 3 if quick else 1]:
        for noise in (0.0, NOISE):
            outcomes = [p.find(shift(value, value), engine.settings(), noise, draw) for p, draw in _draws(over, noise)]
            rows.append({"shift_px": value, "noise": noise, **row(outcomes)})
    return rows


def warps(over: list[Pattern], quick: bool) -> list[dict[str, Any]]:
    """Translation by 23 px, affine and perspective warps, rotations, scales, another light; default settings."""
    rows = []
    for motion in MOTIONS[:: 3 if quick else 1]:
        for noise in (0.0, NOISE):
            outcomes = [p.find(motion, engine.settings(), noise) for p in over]
            rows.append({"motion": motion.name, "noise": noise, **row(outcomes)})
    # The darker target has 1 / gain of the noise when it is brought to the reference's contrast.
    outcomes = [p.find(shift(0.3, 0.6), engine.settings(), gain=GAIN, offset=OFFSET) for p in over]
    dimmed = np.sqrt((1 + GAIN**-2) / 2)
    outcomes = [Outcome(o.errors_px, o.sigmas_px, o.sought, o.floor_px * dimmed) for o in outcomes]
    rows.append({"motion": f"shift, light times {GAIN:g} plus {OFFSET:g}", "noise": 0.0, **row(outcomes)})
    return rows


def noise_levels(over: list[Pattern], quick: bool) -> list[dict[str, Any]]:
    """A translation and a warp under growing noise; several draws: bias, floor, and whether sigma is right."""
    rows = []
    for noise in LEVELS[:: 2 if quick else 1]:
        for motion in (shift(0.3, 0.6), WARP):
            outcomes = [p.find(motion, engine.settings(), noise, draw) for p, draw in _draws(over, noise)]
            rows.append({"motion": motion.name, "noise": noise, **row(outcomes)})
    return rows


def choices(over: list[Pattern], quick: bool) -> list[dict[str, Any]]:
    """Interpolants and pre-filters: which the defaults are chosen from."""
    smoothing = sorted({*SMOOTHING_PX, engine.settings().gradient_smoothing_px})
    cases = [(degree, pixels, 0.0) for degree in DEGREES for pixels in smoothing]
    cases += [(degree, smoothing[0], blur) for degree in DEGREES for blur in BLURS_PX]
    rows = []
    for degree, pixels, blur in cases[:: 2 if quick else 1]:
        wanted = {"spline_degree": degree, "gradient_smoothing_px": pixels}
        settings = engine.settings(**wanted)
        part: dict[str, Any] = {"degree": degree, "gradient_smoothing_px": pixels, "blur_px": blur}
        for name, noise in (("quantisation", 0.0), ("noise", NOISE)):
            draws = list(_draws(over, noise))
            shifted = [
                row([p.find(shift(value, value), settings, noise, draw, blur_px=blur) for p, draw in draws])
                for value in CHOICE_SHIFTS[:: 4 if quick else 1]
            ]
            warped = row([p.find(WARP, settings, noise, blur_px=blur) for p in over])
            part[name] = {
                "bias_px": max(case["bias_px"] for case in shifted),
                "to_floor": float(np.sqrt(np.mean([case["to_floor"] ** 2 for case in shifted]))),
                "warp_to_floor": warped["to_floor"],
            }
        rows.append(part)
    return rows


def _draws(over: list[Pattern], noise: float) -> Iterator[tuple[Pattern, int]]:
    """Every pattern, with noise drawn twice for each where there are several."""
    for pattern in over:
        for draw in range(2 if noise and len(over) > 1 else 1):
            yield pattern, draw
