"""The plane of one ToF frame of a bag with all that it rests on, and its export as .ply (Figures 4.9 to 4.11)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.calibration import Calibration
from rgbd_dic_acquisition.errors import MeasurementError, RgbdDicError

from .core.geometry import Plane
from .core.plane import PanelPlane, fit_plane
from .core.plane_uncertainty import systematic_covariance
from .core.regions import Regions
from .core.settings import ProcessingSettings
from .core.status import FrameStatus
from .core.tracking import SubsetTracking
from .recorded_frames import first_image, nearest_cloud

Array = NDArray[np.float64]

GREY, RED, GREEN = (150, 150, 150), (213, 60, 40), (0, 158, 90)


@dataclass(frozen=True)
class PlaneView:
    """One ToF frame, in the camera frame [m], and the image nearest to it.

    stamp_ns: of the ToF frame. cloud_m: (N, 3), all its points. selection_m: (M, 3), those in the panel region;
    inliers: (M,), those of them that the plane rests on. systematic: (4, 4), as in `PlaneEstimate`.
    """

    calibration: Calibration
    stamp_ns: int
    image: NDArray[np.uint8]
    cloud_m: Array
    selection_m: Array
    inliers: NDArray[np.bool_]
    plane: Plane
    systematic: Array
    rms_m: float

    @cached_property
    def pixels(self) -> Array:
        """(M, 2), where the selection is in the raw image."""
        camera = self.calibration.camera
        return camera.distort(camera.project(self.selection_m))

    @cached_property
    def residuals_m(self) -> Array:
        """(M,), how much farther along z each point of the selection is than the plane."""
        z = self.selection_m[:, 2]
        return z - self.plane.depths(self.selection_m / z[:, None])

    @property
    def tilts_rad(self) -> Array:
        """(2,), how the plane is turned from facing the camera: yaw from n_x, pitch from n_y."""
        return np.arctan2(self.plane.normal[:2], self.plane.normal[2])

    def uncertainty(self, covariance: Array) -> Array:
        """(3,), standard uncertainty of the distance [m] and of the two tilts [rad], from a covariance of (n, d)."""
        n = self.plane.normal
        turned = np.zeros((2, 4))
        for i in (0, 1):
            turned[i, [i, 2]] = np.array([n[2], -n[i]]) / (n[i] ** 2 + n[2] ** 2)
        jacobian = np.vstack([[0, 0, 0, -1], turned])
        return np.sqrt(np.diag(jacobian @ covariance @ jacobian.T))

    @cached_property
    def corners_m(self) -> Array:
        """(4, 3), the rectangle on the plane that holds the selection."""
        n = self.plane.normal
        x = np.cross([0, 1, 0], n) / np.linalg.norm(np.cross([0, 1, 0], n))
        axes = np.stack([x, np.cross(n, x)])
        u, v = axes @ self.selection_m[self.inliers].T
        foot = -self.plane.d * n
        return np.array(
            [
                foot + a * axes[0] + b * axes[1]
                for a, b in ((u.min(), v.min()), (u.max(), v.min()), (u.max(), v.max()), (u.min(), v.max()))
            ]
        )

    def save_ply(self, folder: Path) -> None:
        """cloud.ply, selection.ply and plane.ply: metres in the camera frame.

        Raises:
            RgbdDicError: if they cannot be written.
        """
        from plyfile import PlyData, PlyElement  # only here: nothing else needs the library

        face = np.array([([0, 1, 2, 3],)], dtype=[("vertex_indices", "i4", (4,))])
        files = {
            "cloud": [PlyElement.describe(_vertices(self.cloud_m, GREY), "vertex")],
            "selection": [PlyElement.describe(_vertices(self.selection_m, RED), "vertex")],
            "plane": [
                PlyElement.describe(_vertices(self.corners_m, GREEN), "vertex"),
                PlyElement.describe(face, "face"),
            ],
        }
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name, elements in files.items():
                PlyData(elements, byte_order="<").write(str(folder / f"{name}.ply"))
        except OSError as error:
            raise RgbdDicError(f"cannot write to {folder}: {error.strerror}") from error


def _vertices(points_m: Array, colour: tuple[int, int, int]) -> NDArray[np.void]:
    kinds = [(name, "f4") for name in "xyz"] + [(name, "u1") for name in ("red", "green", "blue")]
    rows = np.empty(len(points_m), kinds)
    rows["x"], rows["y"], rows["z"] = points_m.T
    rows["red"], rows["green"], rows["blue"] = colour
    return rows


def view_plane(
    bag: BagReader, calibration: Calibration, regions: Regions, settings: ProcessingSettings, at_s: float
) -> PlaneView:
    """The plane of the ToF frame nearest to a time since the first image, as the measurement fits it.

    The panel region is carried from the first image to the image at that time by the DIC.

    Raises:
        BagError: if there is no image or no ToF frame at that time.
        MeasurementError: if the panel is not found in that image, or has no plane.
    """
    reference_ns, reference = first_image(bag)
    stamp_ns, image = first_image(bag, reference_ns + round(at_s * 1e9))
    homography = np.eye(3)
    if stamp_ns != reference_ns:
        camera = calibration.camera
        tracking = SubsetTracking(camera, regions, settings.correlation, settings.search, settings.renewal)
        fields = [tracking.track(reference_ns, reference), tracking.track(stamp_ns, image)]
        for field in fields:
            if field.status != FrameStatus.OK:
                raise MeasurementError(
                    f"the panel was not found in the image {at_s:g} s after the first: {field.reason}"
                )
        homography = fields[1].view
    depth_ns, points = nearest_cloud(bag, calibration, stamp_ns)
    selection, _ = PanelPlane(calibration, regions, settings.plane).select(points, homography)
    if len(selection) < settings.plane.min_points:
        raise MeasurementError(
            f"{len(selection)} ToF points on the panel, at least {settings.plane.min_points} needed: is the panel "
            "drawn on this camera's first image?"
        )
    plane, inliers, rms = fit_plane(selection, settings.plane)
    systematic = systematic_covariance(selection[inliers], plane, calibration.t_camera_tof, settings.plane)
    cloud = points @ calibration.R_camera_tof.T + calibration.t_camera_tof
    return PlaneView(calibration, depth_ns, image, cloud, selection, inliers, plane, systematic, rms)
