"""Single frames of a bag: an image, and the ToF cloud that is nearest to it in time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.calibration import Calibration
from rgbd_dic_acquisition.errors import BagError, CalibrationError, ImageError
from rgbd_dic_acquisition.in_flight import header_stamp_ns
from rgbd_dic_acquisition.messages import (
    IMAGE,
    POINT_CLOUD,
    depth_from_message,
    image_from_message,
    points_from_message,
)

from .core.plane import VIEW_LIMIT_S, cloud_of_depth
from .recorded import CAMERA_TOPIC, DEPTH_TOPIC, POINTS_TOPIC, has_clouds

Array = NDArray[np.float64]


def first_image(bag: BagReader, from_ns: int = 0) -> tuple[int, NDArray[np.uint8]]:
    """Stamp [ns] and image (rows, cols) of the first one at or after a stamp that can be read.

    Raises:
        BagError: if there is none.
    """
    name = bag.require(CAMERA_TOPIC, IMAGE)
    found = next(_readable(bag, name, IMAGE, image_from_message, from_ns), None)
    if found is None:
        raise BagError(
            f"{bag.path}: topic {name} has no readable image" + (" at or after that time" if from_ns else "")
        )
    return found


def nearest_cloud(bag: BagReader, calibration: Calibration, stamp_ns: int) -> tuple[int, Array]:
    """Stamp [ns] and points (N, 3) [m] in the ToF frame of the frame nearest to a stamp.

    Raises:
        BagError: if no readable one is within a quarter of a second.
        CalibrationError: if there are depth images, and the calibration has no ToF sensor.
    """
    if has_clouds(bag):
        name, kind, convert = bag.require(POINTS_TOPIC, POINT_CLOUD), POINT_CLOUD, points_from_message
    else:
        name, kind = bag.require(DEPTH_TOPIC, IMAGE), IMAGE
        if calibration.tof is None:
            raise CalibrationError("the calibration has no 'tof': depth images need its intrinsics and T_camera_tof")

        def convert(message: Any) -> Array:
            return cloud_of_depth(depth_from_message(message), calibration.tof)

    limit_ns = round(VIEW_LIMIT_S * 1e9)
    best = None
    for stamp, points in _readable(bag, name, kind, convert, stamp_ns - limit_ns, stamp_ns + limit_ns):
        if best is not None and abs(stamp - stamp_ns) > abs(best[0] - stamp_ns):
            break
        best = stamp, points[np.isfinite(points).all(axis=1)]
    if best is None or not len(best[1]):
        raise BagError(
            f"{bag.path}: topic {name} has no readable frame with points within {VIEW_LIMIT_S:g} s of the image at "
            f"{stamp_ns * 1e-9:.3f} s; choose another time"
        )
    return best


def _readable(
    bag: BagReader, topic: str, kind: str, convert: Callable[[Any], Array], from_ns: int, to_ns: float = np.inf
) -> Iterator[tuple[int, Array]]:
    """Stamp and content of the frames of a topic between two stamps, without those that cannot be read."""
    for _, _, _, data in bag.raw_messages([topic]):
        stamp_ns = header_stamp_ns(data)
        if stamp_ns > to_ns:
            return
        if stamp_ns < from_ns:
            continue
        try:
            yield stamp_ns, convert(bag.deserialise(kind, data))
        except (BagError, ImageError):
            continue
