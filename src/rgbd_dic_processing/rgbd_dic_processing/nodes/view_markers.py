"""Views -> markers of visualization_msgs: in the picture, and in the camera's frame."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.messages import MessageFactory, header_message

from ..core.crack import CrackOpening
from ..core.view import View

Array = NDArray[np.float64]
IMAGE_MARKER, MARKERS, MARKER = (f"visualization_msgs/msg/{name}" for name in ("ImageMarker", "MarkerArray", "Marker"))
LINE_LIST_2D, POINTS_2D = 2, 4  # visualization_msgs/ImageMarker
LINE_STRIP, TEXT, TRIANGLES, DELETE_ALL = 4, 9, 11, 3  # visualization_msgs/Marker
SHADES = 64
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


def regions_marker(make: MessageFactory, stamp_ns: int, frame_id: str, view: View) -> Any:
    """The outlines in the picture, a colour for each edge."""
    lines, colours = [], []
    for name, polygon in _closed(view.outlines_px):
        lines.append(np.stack([polygon[:-1], polygon[1:]], axis=1).reshape(-1, 2))
        colours += [COLOURS[name]] * (len(polygon) - 1)
    return _image_marker(
        make, stamp_ns, frame_id, LINE_LIST_2D, 2.0, np.concatenate([*lines, np.zeros((0, 2))]), colours
    )


def displacement_marker(
    make: MessageFactory, stamp_ns: int, frame_id: str, view: View, colours: Array, most: int
) -> Any:
    """A dot for each subset, or for every so-manieth, with its colour (N, 3), rounded: a few dozen are made faster than
    hundreds."""
    every = slice(None, None, max(1, -(-len(colours) // most)))
    radius = 0.004 * view.camera.width
    return _image_marker(
        make, stamp_ns, frame_id, POINTS_2D, radius, view.subsets_px[every], np.round(colours[every] * SHADES) / SHADES
    )


def _image_marker(
    make: MessageFactory,
    stamp_ns: int,
    frame_id: str,
    kind: int,
    scale: float,
    points_px: Array,
    colours: Iterable[Any],
) -> Any:
    made = cache(lambda colour: _colour(make, colour))
    return make(
        IMAGE_MARKER,
        header=header_message(make, stamp_ns, frame_id),
        type=kind,
        scale=scale,
        outline_color=_colour(make, (1.0, 1.0, 1.0)),
        points=[_point(make, (x, y, 0.0)) for x, y in (points_px + CORNER_PX).tolist()],
        outline_colors=[made(tuple(colour)) for colour in colours],
    )


def scene_markers(make: MessageFactory, stamp_ns: int, frame_id: str, view: View, opening: CrackOpening) -> Any:
    """Plane, outlines and opening in space; what was there before is deleted first."""
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

    if view.outlines_m.get("panel"):
        panel = view.outlines_m["panel"][0]
        distance = float(panel[:, 2].mean())
        triangles = [_point(make, corner) for corner in _triangles(panel).tolist()]
        add("plane", TRIANGLES, (1.0, 1.0, 1.0), _colour(make, COLOURS["panel"], PLANE_OPACITY), points=triangles)
        for name, polygon in _closed(view.outlines_m):
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


def _point(make: MessageFactory, xyz: Iterable[float]) -> Any:
    x, y, z = xyz
    return make("geometry_msgs/msg/Point", x=x, y=y, z=z)


def _pose(make: MessageFactory, place: Iterable[float]) -> Any:
    turned = make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    return make("geometry_msgs/msg/Pose", position=_point(make, place), orientation=turned)


def _colour(make: MessageFactory, levels: Iterable[float], opacity: float = 1.0) -> Any:
    r, g, b = (float(level) for level in levels)
    return make("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=opacity)
