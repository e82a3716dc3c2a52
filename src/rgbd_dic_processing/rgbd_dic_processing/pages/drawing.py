"""What regions are drawn on: an image, with its camera and the panel's depth where they are known."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.calibration import Calibration, Camera
from rgbd_dic_acquisition.errors import ImageError, MeasurementError, RegionsError, RgbdDicError

from ..core.geometry import Plane
from ..core.panel_ruler import PanelRuler
from ..core.plane import PanelPlane, fit_plane
from ..core.preview import Preview, preview
from ..core.regions import Regions
from ..core.regions_file import regions_of
from ..core.settings import ProcessingSettings
from ..recorded import calibration_of
from ..recorded_frames import first_image, nearest_cloud

Array = NDArray[np.float64]
MOST_POLYGONS, MOST_CORNERS = 40, 200


@dataclass(frozen=True)
class Look:
    """What some regions come to: the preview, the outline of the zones [px], and sizes [m] where they are known.

    sizes_m: empty without a plane, with the reason in `no_sizes`.
    """

    regions: Regions
    preview: Preview
    sizes_m: dict[str, float]
    no_sizes: str


class Drawing:
    """An image to draw on.

    Args:
        image: (rows, cols), mono8, raw.
        camera: None if it is not calibrated; lens distortion is then left out of account.
        calibration, cloud_m: both sensors, and the points (N, 3) [m] of a ToF frame near the image in the ToF frame;
            None if there is none, with the reason in `no_depth`.
        plane: of the panel in the camera frame, where that is known already.
        frame_id: of a live image.
        noise: of a pixel [grey levels].
    """

    def __init__(
        self,
        name: str,
        stamp_ns: int,
        image: NDArray[np.uint8],
        settings: ProcessingSettings,
        noise: float,
        camera: Camera | None = None,
        calibration: Calibration | None = None,
        cloud_m: Array | None = None,
        plane: Plane | None = None,
        no_depth: str = "no depth belongs to the image",
        frame_id: str = "",
    ):
        self.name, self.stamp_ns, self.image, self.noise, self.frame_id = name, stamp_ns, image, noise, frame_id
        self.settings = settings
        rows, cols = image.shape
        if camera is not None and (camera.width, camera.height) != (cols, rows):
            raise ImageError(
                f"{name} is {cols} x {rows} px, the calibrated camera has {camera.width} x {camera.height} px"
            )
        self._camera = camera or Camera(cols, rows, float(cols), float(cols), (cols - 1) / 2, (rows - 1) / 2)
        self._calibration, self._cloud, self._plane, self._no_depth = calibration, cloud_m, plane, no_depth
        self._one_at_a_time = threading.Lock()

    @classmethod
    def of_bag(cls, path: Path, calibration_path: Path | None, settings: ProcessingSettings, noise: float) -> Drawing:
        """The first readable image of a bag, which will be the reference.

        Raises:
            BagError: if the bag or its first image cannot be read.
        """
        with BagReader(path) as bag:
            stamp_ns, image = first_image(bag)
            try:
                calibration = calibration_of(bag, calibration_path)
            except RgbdDicError as error:
                return cls(path.name, stamp_ns, image, settings, noise, no_depth=str(error))
            try:
                _, cloud = nearest_cloud(bag, calibration, stamp_ns)
                known = {"calibration": calibration, "cloud_m": cloud}
            except RgbdDicError as error:
                known = {"no_depth": str(error)}
        return cls(path.name, stamp_ns, image, settings, noise, calibration.camera, **known)

    @classmethod
    def of_file(cls, path: Path, camera: Camera | None, settings: ProcessingSettings, noise: float) -> Drawing:
        """An image file, 8 bits.

        Raises:
            ImageError: if it cannot be read.
        """
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise ImageError(f"cannot read {path} as an image: give a PNG, TIFF or JPEG file, or a bag")
        return cls(path.name, 0, image, settings, noise, camera, no_depth="an image has no depth; draw on a bag for mm")

    def look(self, entries: Mapping[str, Any]) -> Look:
        """What the entries of a regions.yaml come to on this image; for one caller at a time.

        Raises:
            RegionsError: if the entries are malformed.
        """
        _check_amount(entries)
        regions = regions_of(entries)
        with self._one_at_a_time:
            seen = preview(self.image, self._camera, regions, self.settings, self.noise)
            try:
                sizes, no_sizes = self._ruler(regions).sizes_m(regions), ""
            except RgbdDicError as error:
                sizes, no_sizes = {}, str(error)
        return Look(regions, seen, sizes, no_sizes)

    def _ruler(self, regions: Regions) -> PanelRuler:
        if self._plane is not None:
            return PanelRuler(self._camera, self._plane)
        if self._calibration is None or self._cloud is None:
            raise MeasurementError(self._no_depth)
        planes = PanelPlane(self._calibration, regions, self.settings.plane)
        on_panel, _ = planes.select(self._cloud, np.eye(3))
        least = self.settings.plane.min_points
        if len(on_panel) < least:
            raise MeasurementError(f"{len(on_panel)} ToF points on the panel, at least {least} needed")
        plane, _, _ = fit_plane(on_panel, self.settings.plane)
        return PanelRuler(self._camera, plane)


def _check_amount(entries: Mapping[str, Any]) -> None:
    """Refuse more polygons or corners than anybody draws, before they cost time."""
    polygons = [entries.get("panel"), entries.get("x_axis")]
    for name in ("fixed", "fixed_holes"):
        listed = entries.get(name)
        polygons += listed if isinstance(listed, list) else []
    if len(polygons) > MOST_POLYGONS or any(isinstance(p, list) and len(p) > MOST_CORNERS for p in polygons):
        raise RegionsError(
            f"more than {MOST_POLYGONS} polygons, or more than {MOST_CORNERS} corners in one: draw fewer"
        )
