"""The image pairs of the common test, as files that every engine reads."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from speckle import Motion, Speckle, about_middle, camera_image, reference_image, shift, target_image

PATTERNS = (2, 4, 6)  # seeds of patterns that fit into 8 bits
NOISE = 2.0  # grey levels, where the test has noise
WARP = about_middle("homography", angle_deg=1.0, scale=1.01, perspective=(2e-5, 1e-5), moved_px=(3.4, -2.2))
FAR = about_middle("23 px", moved_px=(23.4, -11.7))
TURNED_2, TURNED_6 = (about_middle(f"{angle} degrees", angle, moved_px=(2.3, 3.6)) for angle in (2, 6))


@dataclass(frozen=True)
class Scene:
    """A pair of files and its truth."""

    reference: Path
    target: Path
    motion: Motion


class Scenes:
    """Makes pairs of the first pattern in a folder when they are asked for; makes each once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._speckle = Speckle(PATTERNS[0])
        self._grey = reference_image(self._speckle)

    def pair(self, motion: Motion, noise: float = 0.0) -> Scene:
        """The pattern and the moved pattern, 8 bit, with independent noise [grey levels] in both."""
        reference = self._folder / f"reference_{noise:g}.npy"
        target = self._folder / f"{motion.name}_{noise:g}.npy"
        if not reference.exists():
            np.save(reference, camera_image(self._grey, noise, seed=1))
        if not target.exists():
            np.save(target, camera_image(target_image(self._speckle, motion), noise, seed=2))
        return Scene(reference, target, motion)


def shifts() -> list[Motion]:
    """Equal shifts along x and y from 0.1 to 0.9 px."""
    return [shift(value / 10, value / 10) for value in range(1, 10)]
