"""Sensor messages <-> arrays: the one place that knows encodings, byte order, padding and units of depth.

Nothing here needs ROS. Reading works on any object with the fields of the message; creating takes a factory
`make(typename, **fields)`, which a node builds on rclpy and `bag.make_message` on the bag library. What the
creators hand to the factory are other messages, numbers, strings, `bytes` for pixel data and lists of floats.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .calibration import Calibration, Camera
from .errors import ImageError

MessageFactory = Callable[..., Any]
Array = NDArray[np.float64]

IMAGE = "sensor_msgs/msg/Image"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
IMU = "sensor_msgs/msg/Imu"
TF = "tf2_msgs/msg/TFMessage"
_POINT_FIELDS = {"<f4": 7, "<u4": 6}  # sensor_msgs/PointField: FLOAT32, UINT32

_PIXEL_TYPES = {"mono8": "u1", "8UC1": "u1", "mono16": "u2", "16UC1": "u2", "32FC1": "f4"}
_POINT_TYPES = {7: "f4", 8: "f8"}  # PointField.FLOAT32, FLOAT64


def stamp_to_ns(stamp: Any) -> int:
    """builtin_interfaces/Time -> nanoseconds since the epoch."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def stamp_message(make: MessageFactory, stamp_ns: int) -> Any:
    sec, nanosec = divmod(int(stamp_ns), 1_000_000_000)
    return make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)


def header_message(make: MessageFactory, stamp_ns: int, frame_id: str) -> Any:
    return make("std_msgs/msg/Header", stamp=stamp_message(make, stamp_ns), frame_id=frame_id)


def image_from_message(msg: Any) -> NDArray[Any]:
    """Pixels (rows, cols) of an Image: uint8 (mono8, 8UC1), uint16 (mono16, 16UC1) or float32 (32FC1).

    Without padding and in the machine's byte order; a view of the message's data where that is possible.

    Raises:
        ImageError: another encoding, no pixels, or less data than rows and step promise.
    """
    if msg.encoding not in _PIXEL_TYPES:
        raise ImageError(
            f"image encoding '{msg.encoding}' is not supported; use one of {', '.join(_PIXEL_TYPES)} "
            "(greyscale, one channel)"
        )
    rows, cols, step = int(msg.height), int(msg.width), int(msg.step)
    dtype = np.dtype(_PIXEL_TYPES[msg.encoding]).newbyteorder(">" if msg.is_bigendian else "<")
    if rows == 0 or cols == 0:
        raise ImageError(f"image is empty: {cols} x {rows} pixels")
    if step < cols * dtype.itemsize:
        raise ImageError(
            f"image row of {step} bytes (step) is too short for {cols} pixels of {msg.encoding}, "
            f"{cols * dtype.itemsize} bytes"
        )
    data = _byte_array(msg.data)
    needed = step * (rows - 1) + cols * dtype.itemsize
    if data.size < needed or data.size > step * rows:
        raise ImageError(
            f"image of {cols} x {rows} pixels, {msg.encoding}, step {step}, must have {step * rows} bytes; "
            f"it has {data.size}"
        )
    pixels = np.ndarray((rows, cols), dtype, data, strides=(step, dtype.itemsize))
    return pixels.astype(dtype.newbyteorder("="), copy=False)


def depth_from_message(msg: Any) -> NDArray[np.float32]:
    """Depth along z (rows, cols) float32 in metres, NaN where there is none (REP-117, REP-118).

    16UC1 is millimetres with 0 for no return; 32FC1 is metres, where NaN, infinite and <= 0 are no return.

    Raises:
        ImageError: another encoding, or as for `image_from_message`.
    """
    if msg.encoding not in ("16UC1", "mono16", "32FC1"):
        raise ImageError(f"depth encoding '{msg.encoding}' is not supported; use 16UC1 (millimetres) or 32FC1 (metres)")
    depth = image_from_message(msg)
    if depth.dtype == np.uint16:
        metres = depth * np.float32(1e-3)
        metres[depth == 0] = np.nan
        return metres
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(np.nan)).astype(np.float32)


def points_from_message(msg: Any) -> Array:
    """Points (N, 3) float64 in metres of a PointCloud2, without those of no return (not finite, z <= 0).

    Raises:
        ImageError: no float fields x, y, z, or wrong amount of data.
    """
    byte_order = ">" if msg.is_bigendian else "<"
    fields = {field.name: field for field in msg.fields}
    missing = [axis for axis in "xyz" if axis not in fields or fields[axis].datatype not in _POINT_TYPES]
    if missing:
        raise ImageError(
            f"point cloud needs float fields x, y, z; missing or of another type: {', '.join(missing)}; "
            f"it has {', '.join(fields) or 'none'}"
        )
    rows, cols = int(msg.height), int(msg.width)
    point_step, row_step = int(msg.point_step), int(msg.row_step)
    data = _byte_array(msg.data)
    if row_step < point_step * cols or data.size < row_step * rows:
        raise ImageError(
            f"point cloud of {cols} x {rows} points, {point_step} bytes each, rows of {row_step} bytes, "
            f"must have {max(row_step, point_step * cols) * rows} bytes; it has {data.size}"
        )
    axes = []
    for axis in "xyz":
        dtype = np.dtype(byte_order + _POINT_TYPES[fields[axis].datatype])
        offset = int(fields[axis].offset)
        if offset + dtype.itemsize > point_step:
            raise ImageError(f"point cloud field {axis} ends beyond the point of {point_step} bytes")
        if rows * cols == 0:
            axes.append(np.empty(0))
            continue
        axes.append(np.ndarray((rows, cols), dtype, data, offset, (row_step, point_step)).ravel())
    points = np.stack([axis.astype(float) for axis in axes], axis=-1)
    return points[np.all(np.isfinite(points), axis=1) & (points[:, 2] > 0)]


def image_message(make: MessageFactory, stamp_ns: int, frame_id: str, array: NDArray[Any], encoding: str) -> Any:
    """An Image of an array (rows, cols) whose type fits the encoding (mono8, mono16, 8UC1, 16UC1 or 32FC1).

    Raises:
        ImageError: encoding or array do not fit.
    """
    pixels = np.ascontiguousarray(array)
    kind = np.dtype(_PIXEL_TYPES.get(encoding, "V1"))
    if pixels.ndim != 2 or pixels.dtype != kind:
        raise ImageError(
            f"array of shape {pixels.shape}, {pixels.dtype}, cannot be sent as '{encoding}'; it must be "
            f"(rows, cols) and the encoding one of {', '.join(_PIXEL_TYPES)} with the type to it"
        )
    return make(
        IMAGE,
        header=header_message(make, stamp_ns, frame_id),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=int(sys.byteorder == "big"),
        step=pixels.shape[1] * pixels.itemsize,
        data=pixels.tobytes(),
    )


def depth_message(make: MessageFactory, stamp_ns: int, frame_id: str, depth_m: NDArray[Any]) -> Any:
    """A 16UC1 image in millimetres from depth (rows, cols) in metres; NaN and what cannot fit is 0."""
    depth_mm = np.rint(np.asarray(depth_m, float) * 1e3)
    valid = np.isfinite(depth_mm) & (depth_mm >= 1) & (depth_mm <= 65535)
    return image_message(make, stamp_ns, frame_id, np.where(valid, depth_mm, 0).astype(np.uint16), "16UC1")


def points_message(make: MessageFactory, stamp_ns: int, frame_id: str, points_m: NDArray[Any]) -> Any:
    """A PointCloud2 (x, y, z as float32) of points (N, 3) [m]; NaN stays NaN."""
    points = np.ascontiguousarray(points_m, "<f4")
    if points.ndim != 2 or points.shape[1] != 3:
        raise ImageError(f"array of shape {points.shape} cannot be sent as points; it must be (N, 3)")
    columns = points.view([(name, "<f4") for name in "xyz"])[:, 0]
    return structured_cloud_message(make, stamp_ns, frame_id, columns, bool(np.isfinite(points).all()))


def structured_cloud_message(
    make: MessageFactory, stamp_ns: int, frame_id: str, points: NDArray[Any], is_dense: bool = True
) -> Any:
    """A PointCloud2 of a structured array (N,) of float32 and uint32; is_dense: nothing in it is NaN."""
    fields = [
        make("sensor_msgs/msg/PointField", name=name, offset=offset, datatype=_POINT_FIELDS[kind.str], count=1)
        for name, (kind, offset) in points.dtype.fields.items()
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
        is_dense=is_dense,
    )


def camera_info_message(make: MessageFactory, stamp_ns: int, frame_id: str, camera: Camera) -> Any:
    """The CameraInfo of a camera: plumb_bob with k1 and k2, the other terms 0."""
    K = camera.matrix
    return make(
        CAMERA_INFO,
        header=header_message(make, stamp_ns, frame_id),
        height=camera.height,
        width=camera.width,
        distortion_model="plumb_bob",
        d=[float(camera.k1), float(camera.k2), 0.0, 0.0, 0.0],
        k=K.ravel().tolist(),
        r=np.eye(3).ravel().tolist(),
        p=np.hstack([K, np.zeros((3, 1))]).ravel().tolist(),
    )


def imu_message(
    make: MessageFactory,
    stamp_ns: int,
    frame_id: str,
    orientation_xyzw: Sequence[float] | Array,
    orientation_covariance: Array,
    angular_velocity: Sequence[float] | Array | None = None,
) -> Any:
    """An Imu with attitude only, as an autopilot gives it.

    Args:
        orientation_xyzw: quaternion of R_world_body (world ENU, body FLU).
        orientation_covariance: (3, 3) about the world's axes [rad^2].
        angular_velocity: of the body in its own axes [rad/s]; None if not known (its covariance is then -1).
    """
    unknown = [-1.0] + [0.0] * 8
    return make(
        IMU,
        header=header_message(make, stamp_ns, frame_id),
        orientation=_quaternion(make, orientation_xyzw),
        orientation_covariance=np.asarray(orientation_covariance, float).ravel().tolist(),
        angular_velocity=_vector(make, (0.0, 0.0, 0.0) if angular_velocity is None else angular_velocity),
        angular_velocity_covariance=unknown if angular_velocity is None else [0.0] * 9,
        linear_acceleration=_vector(make, (0.0, 0.0, 0.0)),
        linear_acceleration_covariance=unknown,
    )


def transform_message(
    make: MessageFactory, stamp_ns: int, calibration: Calibration, camera_frame: str, tof_frame: str
) -> Any:
    """The TFMessage for /tf_static: parent is the camera, child the ToF sensor: T_camera_tof."""
    from scipy.spatial.transform import Rotation  # half a second that a node without ToF need not spend

    transform = make(
        "geometry_msgs/msg/Transform",
        translation=_vector(make, calibration.t_camera_tof),
        rotation=_quaternion(make, Rotation.from_matrix(calibration.R_camera_tof).as_quat(canonical=True)),
    )
    stamped = make(
        "geometry_msgs/msg/TransformStamped",
        header=header_message(make, stamp_ns, camera_frame),
        child_frame_id=tof_frame,
        transform=transform,
    )
    return make(TF, transforms=[stamped])


def _byte_array(data: Any) -> NDArray[np.uint8]:
    return data if isinstance(data, np.ndarray) else np.frombuffer(data, np.uint8)


def _vector(make: MessageFactory, xyz: Sequence[float] | Array) -> Any:
    x, y, z = (float(value) for value in xyz)
    return make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _quaternion(make: MessageFactory, xyzw: Sequence[float] | Array) -> Any:
    x, y, z, w = (float(value) for value in xyzw)
    return make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
