"""Step 1 of the method: where each subset of the reference image is in every image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import MeasurementError, RegionsError

from .correlation import CorrelationSettings, SubsetStatus
from .keyframe import Chain, Found, Keyframe
from .layout import SubsetLayout
from .regions import Regions
from .renewal import RenewalNeed
from .search import LEAST_AGREEING
from .settings import RenewalSettings, SearchSettings
from .stamps import Stretches
from .status import FrameStatus
from .subset_field import Reference, SubsetField

Array = NDArray[np.float64]
LEAST_TEXTURED = 0.25  # share of each region's subsets that must have texture in a reference


class SubsetTracking:
    """Takes the first good image as the reference and follows its subsets, from one keyframe after another.

    Attributes:
        reference: what the fields count from; None before the first.
        refusal: why the last image did not become the reference or the keyframe though it was wanted; else empty.
    """

    def __init__(
        self,
        camera: Camera,
        regions: Regions,
        correlation: CorrelationSettings,
        search: SearchSettings,
        renewal: RenewalSettings | None = None,
    ):
        self._camera, self._regions = camera, regions
        self._correlation, self._renewal = correlation, renewal or RenewalSettings()
        self._for_keyframes = (camera, correlation, search)
        self._stretches = Stretches()
        self._layout: SubsetLayout | None = None
        self._keyframe: Keyframe | None = None
        self._last: SubsetField | None = None
        self._wants_reference = self._wants_keyframe = False
        self.reference: Reference | None = None
        self.refusal = ""

    def set_reference(self) -> None:
        """The next image in which all regions are seen becomes the reference: displacements count from it anew.

        Raises:
            MeasurementError: if a region is out of view, or the panel is not found at present.
        """
        if self.reference is not None:
            present = self._present()
            self._refuse(self._out_of_view(self._layout.places(present.homography, present.moved_px)))
            self._wants_reference = True

    def renew_keyframe(self) -> None:
        """The next image in which enough subsets are found becomes the keyframe; the reference stays.

        Raises:
            MeasurementError: if too few subsets are found at present.
        """
        if self.reference is not None:
            self._refuse(self._too_few(self._present().moved_px))
            self._wants_keyframe = True

    def replaced_by(self, other: SubsetTracking, stamp_ns: int, image: NDArray[np.uint8]) -> SubsetTracking:
        """The other tracking, by regions that were drawn on this image, which becomes its reference.

        Raises:
            RgbdDicError: if the image is not later than the present reference, or cannot be one; this one then goes on.
        """
        if other._regions.crack is None:
            raise RegionsError("the regions have no entry 'crack': draw the measuring zones")
        if self.reference is not None and stamp_ns <= self.reference.stamp_ns:
            raise MeasurementError(
                f"the image of the regions ({stamp_ns} ns) is not later than the reference "
                f"({self.reference.stamp_ns} ns): draw them on a newer image"
            )
        field = other.track(stamp_ns, image)
        if other.reference is None:
            raise MeasurementError(field.reason)
        return other

    def track(self, stamp_ns: int, image: NDArray[np.uint8] | None, reason: str = "") -> SubsetField:
        """The subset field of an image (rows, cols); without subsets if there is no reference yet.

        Args:
            image: mono8, or None if it could not be read, with the reason.

        Raises:
            RegionsError: if the regions do not fit the first image; nothing can be measured then.
        """
        self.refusal = ""
        size = (self._camera.height, self._camera.width)
        if image is not None and image.dtype != np.uint8:
            reason = f"image has {8 * image.dtype.itemsize} bits a pixel; convert it to mono8"
        elif image is not None and image.shape != size:
            reason = (
                f"image is {image.shape[1]} x {image.shape[0]} px, the calibrated camera has {size[1]} x {size[0]} px"
            )
        newest = self._stretches.newest
        place = self._stretches.place(stamp_ns)
        if place <= newest or place[0] > newest[0]:  # after a jump of the clock, this one alone is refused
            reason = f"its stamp is not later than that of the image before it ({newest[1]} ns)"
        first = self.reference is None
        if first and image is not None and not reason:
            self._layout = self._layout or SubsetLayout(self._camera, self._regions, self._correlation)
            reason = self._take_reference(stamp_ns, image, np.eye(3), self._layout.drawn_px)
        if image is None or reason:
            return self._nothing(stamp_ns, FrameStatus.BAD_IMAGE, reason)
        self._last = self._field(stamp_ns, self._keyframe.itself()) if first else self._follow(stamp_ns, image)
        return self._last

    def _follow(self, stamp_ns: int, image: NDArray[np.uint8]) -> SubsetField:
        found = self._keyframe.find(stamp_ns, image)
        if found is None:
            return self._nothing(stamp_ns, FrameStatus.LOST, "the reference pattern was not found in the image")
        tracked = self._field(stamp_ns, found)
        needed = self._need.judge(found)
        if self._wants_reference:
            places = self._layout.places(tracked.homography, tracked.moved_px)
            self.refusal = self._take_reference(stamp_ns, image, tracked.homography, places)
            if not self.refusal:
                return self._field(stamp_ns, self._keyframe.itself())
        elif needed or self._wants_keyframe:
            self.refusal = self._take_keyframe(stamp_ns, image, found, tracked)
        return tracked

    def _take_reference(self, stamp_ns: int, image: NDArray[np.uint8], homography: Array, places_px: Array) -> str:
        """Make an image, where the subsets lie at these places (N, 2), the reference; or say why it cannot be one."""
        if refusal := self._out_of_view(places_px):
            return refusal
        members = np.flatnonzero(self._layout.whole(places_px))
        start, settings = Chain.start(len(members)), self._for_keyframes
        keyframe = Keyframe(stamp_ns, image, members, places_px[members], homography, start, *settings)
        textured = self._layout.mask(members[keyframe.textured])
        if short := self._layout.shortage(textured, LEAST_TEXTURED):
            return f"no reference: only {short} have texture (light? focus?)"
        if textured.sum() < LEAST_AGREEING:
            return f"no reference: only {textured.sum()} subsets have texture, at least {LEAST_AGREEING} are needed"
        centres = np.where(self._layout.mask(members)[:, None], places_px, np.nan)
        self.reference = Reference(
            stamp_ns,
            image,
            centres,
            self._correlation.subset_size,
            self._correlation.step,
            self._layout.drawn_px,
            homography,
            self._regions,
        )
        self._textured, self._wants_reference = textured, False
        self._follow_from(keyframe)
        return ""

    def _take_keyframe(self, stamp_ns: int, image: NDArray[np.uint8], found: Found, tracked: SubsetField) -> str:
        """Carry the subsets that were found to an image, the new keyframe; or say why it cannot be one."""
        if refusal := self._too_few(tracked.moved_px):
            return refusal
        kept = self._layout.whole(tracked.moved_px)
        chain = self._keyframe.chain_from(found, kept[self._keyframe.members])
        centres, settings = tracked.moved_px[kept], self._for_keyframes
        keyframe = Keyframe(stamp_ns, image, np.flatnonzero(kept), centres, tracked.homography, chain, *settings)
        textured = self._layout.mask(keyframe.members[keyframe.textured])
        if short := self._layout.shortage(textured, self._renewal.min_found, self._textured):
            self._need.postpone()
            return f"the keyframe stays: only {short} have texture in this image (light? focus?)"
        self._follow_from(keyframe)
        return ""

    def _follow_from(self, keyframe: Keyframe) -> None:
        self._keyframe, self._wants_keyframe = keyframe, False
        self._need = RenewalNeed(self._renewal)

    def _present(self) -> SubsetField:
        if self._last is None or self._last.status != FrameStatus.OK:
            raise MeasurementError("the panel is not found in the image at present: wait until it is")
        return self._last

    def _out_of_view(self, places_px: Array) -> str:
        short = self._layout.shortage(self._layout.whole(places_px), LEAST_TEXTURED)
        return f"no reference: only {short} lie in the image: move back" if short else ""

    def _too_few(self, moved_px: Array) -> str:
        short = self._layout.shortage(self._layout.whole(moved_px), self._renewal.min_found, self._textured)
        least = f"at least {self._renewal.min_found:.0%} needed, because the others would be lost for good"
        return f"the keyframe stays: only {short} are found ({least})" if short else ""

    @staticmethod
    def _refuse(reason: str) -> None:
        if reason:
            raise MeasurementError(reason)

    def _field(self, stamp_ns: int, found: Found) -> SubsetField:
        keyframe, correlation = self._keyframe, found.correlation

        def of_all(values: NDArray, missing: float) -> NDArray:
            every = np.full((len(self._layout), *values.shape[1:]), missing, values.dtype)
            every[keyframe.members] = values
            return every

        homography = found.guess.homography @ keyframe.homography
        return SubsetField(
            stamp_ns,
            self.reference.stamp_ns,
            keyframe.stamp_ns,
            FrameStatus.OK,
            "",
            found.source,
            keyframe.subset_px,
            homography / homography[2, 2],
            of_all(found.moved_px, np.nan),
            of_all(found.sigma_px.astype(np.float32), np.nan),
            of_all(correlation.zncc, np.nan),
            of_all(correlation.iterations, 0),
            of_all(correlation.status, SubsetStatus.SKIPPED),
        )

    def _nothing(self, stamp_ns: int, status: FrameStatus, reason: str) -> SubsetField:
        if self.reference is None:
            return SubsetField.without_subsets(stamp_ns, 0, 0, status, reason, 0, np.nan)
        known = self.reference.stamp_ns, self._keyframe.stamp_ns
        return SubsetField.without_subsets(
            stamp_ns, *known, status, reason, len(self._layout), self._keyframe.subset_px
        )
