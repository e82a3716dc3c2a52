"""The regions of a bag, with the panel found in its first ToF frame where nobody drew it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.calibration import Calibration

from .core.panel_finding import FoundPanel, find_panel
from .core.regions_file import read_entries, write_entries
from .core.settings import ProcessingSettings
from .recorded_frames import first_image, nearest_cloud

HEADING = "The panel was found in the ToF frame of the first image; in pixels of that image (docs/files.md)."


@dataclass(frozen=True)
class FoundRegions:
    """What regions.yaml is to hold, the panel in it, and the image (rows, cols) on which it was found."""

    content: dict[str, Any]
    panel: FoundPanel
    image: NDArray[np.uint8]

    def save(self, path: Path) -> None:
        """Raises: RegionsError: if it cannot be written."""
        write_entries(self.content, path, HEADING)

    def __str__(self) -> str:
        return (
            f"panel found: {self.panel.share:.0%} of the image at {self.panel.distance_m:.3f} m, an outline of "
            f"{len(self.panel.outline_px)} corners"
        )


def find_regions(
    bag: BagReader, calibration: Calibration, given: Path | None, settings: ProcessingSettings
) -> FoundRegions:
    """The regions of a bag, with the panel found in the ToF frame nearest to its first image.

    Args:
        given: regions.yaml without `panel`, whose other entries are kept; or None.

    Raises:
        MeasurementError: if there is no panel to be found, or no Open3D to find it with.
    """
    entries = {} if given is None else read_entries(given)
    stamp_ns, image = first_image(bag)
    _, points = nearest_cloud(bag, calibration, stamp_ns)
    points = points @ calibration.R_camera_tof.T + calibration.t_camera_tof
    panel = find_panel(points, calibration, settings.correlation.subset_size, settings.panel_finding)
    return FoundRegions({"panel": panel.outline_px.tolist(), **entries}, panel, image)
