"""The components of a ToF frame, as a device sends them, as arrays in metres.

A component is found by its type (range, intensity, confidence), never by its place. Pixel formats have the
names and codes of GenICam's PFNC; all are little-endian. A stored coordinate becomes a length by the device's
Scan3dCoordinateScale and Scan3dCoordinateOffset (SFNC, chapter 3D scan control): for Basler's Blaze
`z [mm] = Scan3dCoordinateScale * stored` for Coord3D_C16, and millimetres as they are for Coord3D_ABC32f
(Basler product documentation, "Processing Measurement Results").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import ImageError
from ..sources import DepthFrame

RANGE, INTENSITY, CONFIDENCE = "range", "intensity", "confidence"
# What SFNC calls ComponentIDValue.
COMPONENT_IDS = {1: INTENSITY, 4: RANGE, 6: CONFIDENCE}


@dataclass(frozen=True)
class PixelFormat:
    """How the pixels of a component lie in memory.

    Attributes:
        kind: the component that it can belong to; INTENSITY for all Mono formats.
        dtype: of one value.
        axes: of a range, which coordinates a pixel has: 0, 1, 2 for x, y, z (A, B, C in the names).
        planar: whether all x come first, then all y, then all z.
    """

    name: str
    kind: str
    dtype: str
    axes: tuple[int, ...] = (2,)
    planar: bool = False


PIXEL_FORMATS = {
    0x01080001: PixelFormat("Mono8", INTENSITY, "u1"),
    0x01100003: PixelFormat("Mono10", INTENSITY, "<u2"),
    0x01100005: PixelFormat("Mono12", INTENSITY, "<u2"),
    0x01100025: PixelFormat("Mono14", INTENSITY, "<u2"),
    0x01100007: PixelFormat("Mono16", INTENSITY, "<u2"),
    0x010800C6: PixelFormat("Confidence8", CONFIDENCE, "u1"),
    0x011000C7: PixelFormat("Confidence16", CONFIDENCE, "<u2"),
    0x011000B8: PixelFormat("Coord3D_C16", RANGE, "<u2"),
    0x012000BD: PixelFormat("Coord3D_A32f", RANGE, "<f4", (0,)),
    0x012000BE: PixelFormat("Coord3D_B32f", RANGE, "<f4", (1,)),
    0x012000BF: PixelFormat("Coord3D_C32f", RANGE, "<f4"),
    0x026000C0: PixelFormat("Coord3D_ABC32f", RANGE, "<f4", (0, 1, 2)),
    0x026000C1: PixelFormat("Coord3D_ABC32f_Planar", RANGE, "<f4", (0, 1, 2), planar=True),
}


@dataclass(frozen=True)
class Component:
    """One component of a frame, or one of the planes of a range whose planes come apart (A32f, B32f, C32f).

    Attributes:
        kind: RANGE, INTENSITY or CONFIDENCE; anything else is passed over.
        pixel_format: PFNC code, one of PIXEL_FORMATS.
        width, height: pixels.
        data: the rows one after the other, each followed by `padding` bytes.
    """

    kind: str
    pixel_format: int
    width: int
    height: int
    data: bytes
    padding: int = 0


@dataclass(frozen=True)
class Coordinates:
    """What the stored coordinates of the range mean: (stored * scale + offset) * unit_m, for x, y, z [m].

    Attributes:
        invalid: stored value of a pixel without a measurement; NaN always is one. None: there is no such value.
    """

    unit_m: float = 1e-3
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    invalid: float | None = 0.0


def depth_frame(
    stamp_ns: int,
    components: Sequence[Component],
    coordinates: Coordinates | None,
    limits_m: tuple[float, float] = (0.0, np.inf),
) -> DepthFrame:
    """The frame that these components make.

    Depth outside of `limits_m` (and of 0 or less) is NaN like what the device marks as invalid, and so are the
    points; the confidence is 0 there. Intensity and confidence keep the device's numbers.

    Raises:
        ImageError: no range, a pixel format that is not in PIXEL_FORMATS, sizes that do not fit, or no
            `coordinates`: the device does not tell how its numbers become lengths.
    """
    axes = _range_axes(components)
    if 2 not in axes:
        kinds = ", ".join(component.kind for component in components) or "none"
        raise ImageError(f"the frame has no component 'Range' with depth, only {kinds}: enable it on the device")
    if coordinates is None:
        raise ImageError("the device does not tell the scale of its coordinates, Scan3dCoordinateScale: no depth")
    if any(stored.shape != axes[2].shape for stored in axes.values()):
        raise ImageError(f"the planes of the range differ in size: {[stored.shape for stored in axes.values()]}")
    metres = {axis: _metres(stored, coordinates, axis) for axis, stored in axes.items()}
    depth_m = metres[2]
    nearest_m, farthest_m = limits_m
    with np.errstate(invalid="ignore"):
        valid = (depth_m > 0) & (depth_m >= nearest_m) & (depth_m <= farthest_m)
    if coordinates.invalid is not None:
        valid &= axes[2] != coordinates.invalid
    depth_m[~valid] = np.nan
    points_m = None
    if len(metres) == 3:
        points_m = np.stack([metres[axis] for axis in range(3)], axis=-1)
        points_m[~valid] = np.nan
    by_kind = {component.kind: component for component in components}
    intensity, confidence = (_greys(by_kind.get(kind), depth_m.shape) for kind in (INTENSITY, CONFIDENCE))
    if confidence is not None:
        confidence[~valid] = 0
    return DepthFrame(stamp_ns, depth_m, intensity, confidence, points_m)


def stored_values(component: Component) -> NDArray[np.generic]:
    """The values of a component as they are stored: (rows, cols, values per pixel), a view of its data.

    Raises:
        ImageError: as for `depth_frame`.
    """
    known = PIXEL_FORMATS.get(component.pixel_format)
    if known is None:
        names = ", ".join(each.name for each in PIXEL_FORMATS.values())
        raise ImageError(
            f"component '{component.kind}' has pixel format 0x{component.pixel_format:08x}, which is not read: "
            f"set PixelFormat on the device to one of {names}"
        )
    rows, cols, count = component.height, component.width, len(known.axes)
    planes, per_row = (count, cols) if known.planar else (1, cols * count)
    dtype = np.dtype(known.dtype)
    step = per_row * dtype.itemsize + component.padding
    needed = planes * rows * step - component.padding
    if rows < 1 or cols < 1 or component.padding < 0 or len(component.data) < needed:
        raise ImageError(
            f"component '{component.kind}' of {cols} x {rows} pixels {known.name} with {component.padding} bytes "
            f"after each row must have {needed} bytes; it has {len(component.data)}"
        )
    pixel, value = (dtype.itemsize, rows * step) if known.planar else (count * dtype.itemsize, dtype.itemsize)
    return np.ndarray((rows, cols, count), dtype, component.data, 0, (step, pixel, value))


def _range_axes(components: Sequence[Component]) -> dict[int, NDArray[np.generic]]:
    """Axis (0, 1, 2 for x, y, z) -> its stored values (rows, cols), from whatever parts the range comes in."""
    axes = {}
    for component in components:
        if component.kind == RANGE:
            stored = stored_values(component)
            for index, axis in enumerate(PIXEL_FORMATS[component.pixel_format].axes):
                axes[axis] = stored[..., index]
    return axes


def _metres(stored: NDArray[np.generic], coordinates: Coordinates, axis: int) -> NDArray[np.float32]:
    """In single precision, to a ten-millionth: a fraction of a micrometre where a step of the device is 150."""
    metres = np.multiply(stored, np.float32(coordinates.scale[axis] * coordinates.unit_m), dtype=np.float32)
    metres += np.float32(coordinates.offset[axis] * coordinates.unit_m)
    return metres


def _greys(component: Component | None, shape: tuple[int, ...]) -> NDArray[np.uint16] | None:
    if component is None:
        return None
    stored = stored_values(component)[..., 0]
    if stored.dtype.kind != "u" or stored.shape != shape:
        raise ImageError(
            f"component '{component.kind}' has {stored.shape[1]} x {stored.shape[0]} pixels {stored.dtype}; the "
            f"range has {shape[1]} x {shape[0]}, and it must have an integer for each"
        )
    return stored.astype(np.uint16)
