"""Views -> messages that the field's viewers show: all of visualization_msgs and sensor_msgs, in the camera's frame.

As in `messages`, creating takes the factory `make(typename, **fields)` of the node or of the bag.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.messages import (
    POINT_CLOUD,
    MessageFactory,
    camera_info_message,
    header_message,
    image_message,
)
from rgbd_dic_acquisition.settings import Settings, setting

from ..core.crack import CrackOpening
from ..core.geometry import Plane
from ..core.view import ColourScale, View

Array = NDArray[np.float64]
IMAGE_MARKER, MARKERS, MARKER = (f"visualization_msgs/msg/{name}" for name in ("ImageMarker", "MarkerArray", "Marker"))
LINE_LIST_2D, POINTS_2D = 2, 4  # visualization_msgs/ImageMarker
LINE_STRIP, TEXT, TRIANGLES, DELETE_ALL = 4, 9, 11, 3  # visualization_msgs/Marker
CORNER_PX = 0.5  # viewers count from the corner of the first pixel, we from its centre
COLOURS = {  # those of the operator's pages
    "panel": (0.94, 0.89, 0.26),
    "fixed": (0.34, 0.71, 0.91),
    "fixed_holes": (0.34, 0.71, 0.91),
    "left": (0.90, 0.62, 0.00),
    "right": (0.90, 0.62, 0.00),
    "crack": (1.00, 0.48, 0.27),
}
LINE_WIDTH, TEXT_HEIGHT = 0.0025, 0.03  # of the distance of the panel
PLANE_OPACITY = 0.25
_POINT_FIELDS = {"f4": 7, "u4": 6}  # sensor_msgs/PointField


@dataclass(frozen=True)
class ViewerSettings(Settings):
    """What viewers are sent of each picture; the pictures are those of `preview`."""

    most_marks: int = setting(
        1500, unit="subsets", low=1, high=20000, doc="most that are marked in the picture: every mark costs"
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
        "view/regions": lambda: _regions(*about, view),
        "view/displacement": lambda: _marks(*about, view, colours, settings.most_marks),
        "view/subsets": lambda: _subsets(*about, view, colours),
        "view/scene": lambda: _scene(*about, view, opening),
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


def cloud_message(
    make: MessageFactory, stamp_ns: int, frame_id: str, points_m: Array, plane: Plane | None, most: int
) -> Any:
    """Points (N, 3) in the camera's frame [m], every so-manieth if there are more than `most`.

    Its field `behind` is how far a point lies behind the plane [m]; NaN without one.
    """
    points = points_m[:: max(1, -(-len(points_m) // most))]
    behind = points @ plane.normal + plane.d if plane is not None else np.full(len(points), np.nan)
    return _cloud(make, stamp_ns, frame_id, _xyz(points) | {"behind": behind})


def _regions(make: MessageFactory, stamp_ns: int, frame_id: str, view: View) -> Any:
    lines, colours = [], []
    for name, polygon in _closed(view.outlines_px):
        lines.append(np.stack([polygon[:-1], polygon[1:]], axis=1).reshape(-1, 2))
        colours += [COLOURS[name]] * (len(polygon) - 1)
    return _image_marker(
        make, stamp_ns, frame_id, LINE_LIST_2D, 2.0, np.concatenate([*lines, np.zeros((0, 2))]), colours
    )


def _marks(make: MessageFactory, stamp_ns: int, frame_id: str, view: View, colours: Array, most: int) -> Any:
    every = slice(None, None, max(1, -(-len(colours) // most)))
    radius = 0.004 * view.camera.width
    return _image_marker(make, stamp_ns, frame_id, POINTS_2D, radius, view.subsets_px[every], colours[every])


def _image_marker(
    make: MessageFactory,
    stamp_ns: int,
    frame_id: str,
    kind: int,
    scale: float,
    points_px: Array,
    colours: Iterable[Any],
) -> Any:
    return make(
        IMAGE_MARKER,
        header=header_message(make, stamp_ns, frame_id),
        type=kind,
        scale=scale,
        outline_color=_colour(make, (1.0, 1.0, 1.0)),
        points=[_point(make, (x, y, 0.0)) for x, y in (points_px + CORNER_PX).tolist()],
        outline_colors=[_colour(make, colour) for colour in colours],
    )


def _subsets(make: MessageFactory, stamp_ns: int, frame_id: str, view: View, colours: Array) -> Any:
    placed = np.isfinite(view.subsets_m).all(axis=1)
    levels = np.round(255 * colours[placed]).astype(np.uint32)
    columns = _xyz(view.subsets_m[placed])
    columns |= dict(zip(("normal", "along", "into_wall"), view.displacement_m[placed].T, strict=True))
    columns |= {"sigma": view.sigma_m[placed], "rgb": levels @ np.array([1 << 16, 1 << 8, 1], np.uint32)}
    return _cloud(make, stamp_ns, frame_id, columns)


def _scene(make: MessageFactory, stamp_ns: int, frame_id: str, view: View, opening: CrackOpening) -> Any:
    markers = [make(MARKER, header=header_message(make, stamp_ns, frame_id), action=DELETE_ALL)]

    def add(name: str, kind: int, scale: tuple[float, float, float], colour: Any, **fields: Any) -> None:
        x, y, z = scale
        markers.append(
            make(
                MARKER,
                header=header_message(make, stamp_ns, frame_id),
                ns=name,
                id=len(markers),
                type=kind,
                scale=make("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
                color=colour,
                **{"pose": _pose(make, (0.0, 0.0, 0.0)), **fields},
            )
        )

    outlines = list(_closed(view.outlines_m))
    if outlines:
        panel = outlines[0][1]
        distance = float(panel[:, 2].mean())
        triangles = [_point(make, corner) for corner in _triangles(panel).tolist()]
        add("plane", TRIANGLES, (1.0, 1.0, 1.0), _colour(make, COLOURS["panel"], PLANE_OPACITY), points=triangles)
        for name, polygon in outlines:
            points = [_point(make, corner) for corner in polygon.tolist()]
            add(name, LINE_STRIP, (LINE_WIDTH * distance, 0.0, 0.0), _colour(make, COLOURS[name]), points=points)
        place = (float(panel[:, 0].mean()), float(panel[:, 1].min()) - TEXT_HEIGHT * distance, distance)
        size, white = (0.0, 0.0, TEXT_HEIGHT * distance), _colour(make, (1.0, 1.0, 1.0))
        add("opening", TEXT, size, white, pose=_pose(make, place), text=_words(opening))
    return make(MARKERS, markers=markers)


def _words(opening: CrackOpening) -> str:
    if not opening.valid:
        return f"invalid: {opening.reason}"
    return f"opening {opening.opening_m * 1e3:+.3f} mm, u {opening.u_opening_m * 1e3:.3f} mm"


def _closed(outlines: dict[str, list[Array]]) -> Iterable[tuple[str, Array]]:
    """Name and corners of each outline, the first corner again at the end; the crack is a line and stays one."""
    for name, polygons in outlines.items():
        for polygon in polygons:
            yield name, polygon if name == "crack" else np.concatenate([polygon, polygon[:1]])


def _triangles(polygon_m: Array) -> Array:
    """(3 k, 3), corners of triangles that cover the convex hull of a polygon (M, 3) on a plane before the camera."""
    hull = cv2.convexHull((polygon_m[:, :2] / polygon_m[:, 2:]).astype(np.float32), returnPoints=False).ravel()
    fan = [(hull[0], hull[i], hull[i + 1]) for i in range(1, len(hull) - 1)]
    return polygon_m[np.array(fan, int).ravel()]


def _xyz(points_m: Array) -> dict[str, Array]:
    return dict(zip("xyz", points_m.T, strict=True))


def _cloud(make: MessageFactory, stamp_ns: int, frame_id: str, columns: dict[str, NDArray[Any]]) -> Any:
    """A PointCloud2 of columns (N,): whole numbers as uint32, others as float32."""
    kinds = [(name, "<u4" if values.dtype.kind == "u" else "<f4") for name, values in columns.items()]
    points = np.zeros(len(columns["x"]), kinds)
    for name, values in columns.items():
        points[name] = values
    fields = [
        make("sensor_msgs/msg/PointField", name=name, offset=4 * i, datatype=_POINT_FIELDS[kind[1:]], count=1)
        for i, (name, kind) in enumerate(kinds)
    ]
    return make(
        POINT_CLOUD,
        header=header_message(make, stamp_ns, frame_id),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=points.itemsize,
        row_step=points.nbytes,
        data=points.tobytes(),
        is_dense=True,
    )


def _point(make: MessageFactory, xyz: Iterable[float]) -> Any:
    x, y, z = xyz
    return make("geometry_msgs/msg/Point", x=x, y=y, z=z)


def _pose(make: MessageFactory, place: Iterable[float]) -> Any:
    turned = make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    return make("geometry_msgs/msg/Pose", position=_point(make, place), orientation=turned)


def _colour(make: MessageFactory, levels: Iterable[float], opacity: float = 1.0) -> Any:
    r, g, b = (float(level) for level in levels)
    return make("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=opacity)
