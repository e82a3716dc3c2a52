"""The method, top to bottom: images and ToF frames in, crack openings out. The nodes string the same steps together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Calibration

from .crack import CrackMeasurement, CrackOpening
from .displacement import DisplacementMeasurement
from .displacement_field import DisplacementField
from .frame_quality import QualityRecord
from .opening_budget import OpeningBudget
from .pairing import FramePair, FramePairing
from .plane import PanelPlane, PlaneEstimate
from .regions import Regions
from .sensor_delay import SensorDelay
from .settings import ProcessingSettings
from .subset_field import Reference, SubsetField
from .tracking import SubsetTracking


@dataclass(frozen=True)
class Measurement:
    """One image measured: the displacement field, and, if the regions have a crack, the opening with, if it is valid,
    what its uncertainty is made of."""

    field: DisplacementField
    opening: CrackOpening | None
    budget: OpeningBudget | None


class Pipeline:
    """All steps for one method or several, which share the DIC, the pairing and the planes.

    Frames may be given in any order that keeps each sensor's own; results come in the order of the images.

    Args:
        methods: names of the compensation methods; None takes the one of the settings.

    Attributes:
        quality: what the frames so far are like.
    """

    def __init__(
        self,
        calibration: Calibration,
        regions: Regions,
        settings: ProcessingSettings,
        methods: tuple[str, ...] | None = None,
    ):
        methods = methods or (settings.compensation.method,)
        camera = calibration.camera
        self.tracking = SubsetTracking(camera, regions, settings.correlation, settings.search, settings.renewal)
        self.pairing = FramePairing(settings.pairing)
        self.planes = PanelPlane(calibration, regions, settings.plane, settings.pairing.tof_delay_ns)
        self.displacement = {
            method: DisplacementMeasurement(camera, regions, replace(settings.compensation, method=method))
            for method in methods
        }
        self.crack = CrackMeasurement(camera, regions.crack, settings.crack) if regions.crack is not None else None
        self.quality = QualityRecord()
        self._reference: Reference | None = None

    def add_image(self, stamp_ns: int, image: NDArray[np.uint8] | None, reason: str = "") -> list[Measurement]:
        """An image (rows, cols), mono8; None with a reason if it could not be read."""
        pairs = self.pairing.add_image(stamp_ns)
        field = self.tracking.track(stamp_ns, image, reason)
        planes = self.planes.add_view(stamp_ns, field.view)
        renewed = self.tracking.reference is not self._reference
        self._reference = self.tracking.reference
        return self._measure(self._reference if renewed else None, field, pairs, planes)

    def add_depth(self, stamp_ns: int, depth_m: NDArray[np.float32] | None, reason: str = "") -> list[Measurement]:
        """A ToF depth image (rows, cols) [m], NaN invalid; None with a reason if it could not be read."""
        pairs = self.pairing.add_depth(stamp_ns)
        return self._measure(None, None, pairs, self.planes.add_depth(stamp_ns, depth_m, reason))

    def add_points(self, stamp_ns: int, points_m: NDArray[np.float64] | None, reason: str = "") -> list[Measurement]:
        """A ToF point cloud (N, 3) in the ToF frame [m]; None with a reason if it could not be read."""
        pairs = self.pairing.add_depth(stamp_ns)
        return self._measure(None, None, pairs, self.planes.add_points(stamp_ns, points_m, reason))

    def flush(self) -> list[Measurement]:
        """No more is coming: measure the frames that still wait."""
        done = self._measure(None, None, self.pairing.flush(), self.planes.flush())
        rest = [field for step in self.displacement.values() for field in step.flush()]
        return done + [self._opening(field) for field in rest]

    def sensor_delay(self) -> SensorDelay:
        """What the frames so far tell of a delay of the ToF stamps; it is the same for all methods."""
        return next(iter(self.displacement.values())).sensor_delay()

    def _measure(
        self,
        reference: Reference | None,
        field: SubsetField | None,
        pairs: list[FramePair],
        planes: list[PlaneEstimate],
    ) -> list[Measurement]:
        self.quality.add(field, pairs, planes)
        fields: list[DisplacementField] = []
        for step in self.displacement.values():
            if reference is not None:
                fields += step.set_reference(reference)
            if field is not None:
                fields += step.add_field(field)
            for plane in planes:
                fields += step.add_plane(plane)
            for pair in pairs:
                fields += step.add_pair(pair)
        return [self._opening(field) for field in fields]

    def _opening(self, field: DisplacementField) -> Measurement:
        if self.crack is None:
            return Measurement(field, None, None)
        opening, parts = self.crack.measure_with_parts(field)
        return Measurement(field, opening, OpeningBudget.of(field, opening, parts) if opening.valid else None)
