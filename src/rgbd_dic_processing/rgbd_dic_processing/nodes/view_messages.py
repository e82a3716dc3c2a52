"""Views -> messages that the field's viewers show: all of visualization_msgs and sensor_msgs, in the camera's frame.

As in `messages`, creating takes the factory `make(typename, **fields)` of the node or of the bag.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.messages import (
    MessageFactory,
    camera_info_message,
    header_message,
    image_message,
    structured_cloud_message,
)
from rgbd_dic_acquisition.settings import Settings, setting

from ..core.crack import CrackOpening
from ..core.geometry import Plane
from ..core.view import ColourScale, View
from .view_markers import displacement_marker, regions_marker, scene_markers

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ViewerSettings(Settings):
    """What viewers are sent of each picture; the pictures are those of `preview`."""

    most_marks: int = setting(
        800, unit="subsets", low=1, high=20000, doc="most that are marked in the picture: every mark costs"
    )
    most_points: int = setting(20000, unit="points", low=1, high=1000000, doc="most that are sent of a ToF cloud")


def view_messages(
    make: MessageFactory,
    stamp_ns: int,
    frame_id: str,
    view: View,
    scale: ColourScale,
    opening: CrackOpening,
    settings: ViewerSettings,
) -> dict[str, Callable[[], Any]]:
    """Topic -> what makes its message: all that shows one picture."""
    about = (make, stamp_ns, frame_id)
    colours = scale.colours(view.displacement_m[:, 0])
    return {
        "view/image_rect": lambda: image_message(*about, view.picture, "mono8"),
        "view/camera_info": lambda: camera_info_message(*about, view.camera),
        "view/regions": lambda: regions_marker(*about, view),
        "view/displacement": lambda: displacement_marker(*about, view, colours, settings.most_marks),
        "view/subsets": lambda: _subsets(*about, view, colours),
        "view/scene": lambda: scene_markers(*about, view, opening),
    }


def band_message(make: MessageFactory, opening: CrackOpening, frame_id: str) -> Any:
    """The opening in millimetres, with its uncertainty as a band."""
    value, u = opening.opening_m * 1e3, opening.u_opening_m * 1e3
    return make(
        "rgbd_dic_msgs/msg/OpeningBand",
        header=header_message(make, opening.stamp_ns, frame_id),
        opening_mm=value,
        lower_mm=value - u,
        upper_mm=value + u,
        u_opening_mm=u,
        sliding_mm=opening.sliding_m * 1e3,
    )


def cloud_message(make: MessageFactory, stamp_ns: int, frame_id: str, points_m: Array, plane: Plane | None) -> Any:
    """Points (N, 3) in the camera's frame [m]; `behind` is how far each lies behind the plane [m], NaN without one."""
    behind = points_m @ plane.normal + plane.d if plane is not None else np.full(len(points_m), np.nan)
    return _cloud(make, stamp_ns, frame_id, _xyz(points_m) | {"behind": behind})


def _subsets(make: MessageFactory, stamp_ns: int, frame_id: str, view: View, colours: Array) -> Any:
    placed = np.isfinite(view.subsets_m).all(axis=1)
    levels = np.round(255 * colours[placed]).astype(np.uint32)
    columns = _xyz(view.subsets_m[placed])
    columns |= dict(zip(("normal", "along", "into_wall"), view.displacement_m[placed].T, strict=True))
    columns |= {"sigma": view.sigma_m[placed], "rgb": levels @ np.array([1 << 16, 1 << 8, 1], np.uint32)}
    return _cloud(make, stamp_ns, frame_id, columns)


def _xyz(points_m: Array) -> dict[str, Array]:
    return dict(zip("xyz", points_m.T, strict=True))


def _cloud(make: MessageFactory, stamp_ns: int, frame_id: str, columns: dict[str, NDArray[Any]]) -> Any:
    """A PointCloud2 of columns (N,): whole numbers as uint32, others as float32."""
    kinds = [(name, "<u4" if values.dtype.kind == "u" else "<f4") for name, values in columns.items()]
    points = np.zeros(len(columns["x"]), kinds)
    for name, values in columns.items():
        points[name] = values
    return structured_cloud_message(make, stamp_ns, frame_id, points)
