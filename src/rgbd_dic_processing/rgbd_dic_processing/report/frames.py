"""What a run kept of its images and ToF frames, as arrays over the time of the report."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..runs import Run

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Frames:
    """Times [s] count from the first frame of the run; NaN where a frame has no value."""

    run: Run

    @cached_property
    def start_ns(self) -> int:
        stamps = [opening.stamp_ns for opening in self.run.openings]
        return min(stamps or [image.stamp_ns for image in self.run.frames.images], default=0)

    @property
    def end_s(self) -> float:
        """Of the last image."""
        stamps = [opening.stamp_ns for opening in self.run.openings]
        stamps += [image.stamp_ns for image in self.run.frames.images]
        return (max(stamps, default=self.start_ns) - self.start_ns) * 1e-9

    def of_images(self, name: str) -> Array:
        """(n,), an attribute of `ImageQuality`, ordered by time."""
        return np.array([getattr(image, name) for image in self._images], float)

    def of_planes(self, name: str) -> Array:
        """(m,), an attribute of `PlaneQuality`, ordered by time."""
        return np.array([getattr(plane, name) for plane in self._planes], float)

    @cached_property
    def image_s(self) -> Array:
        return np.array([(image.stamp_ns - self.start_ns) * 1e-9 for image in self._images])

    @cached_property
    def plane_s(self) -> Array:
        return np.array([(plane.stamp_ns - self.start_ns) * 1e-9 for plane in self._planes])

    @cached_property
    def _images(self) -> list:
        return sorted(self.run.frames.images, key=lambda image: image.stamp_ns)

    @cached_property
    def _planes(self) -> list:
        return sorted(self.run.frames.planes, key=lambda plane: plane.stamp_ns)
