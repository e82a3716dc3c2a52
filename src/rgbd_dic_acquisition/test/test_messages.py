"""Messages <-> arrays: every encoding, padding and byte order, and what is refused."""

import contextlib
from types import SimpleNamespace

import numpy as np
import pytest
from rgbd_dic_acquisition.bag import make_message
from rgbd_dic_acquisition.calibration import Calibration, Camera
from rgbd_dic_acquisition.errors import BagError, ImageError
from rgbd_dic_acquisition.message_types import serialise
from rgbd_dic_acquisition.serialised_image import SerialisedImage

from rgbd_dic_acquisition import messages


def image(encoding, data, rows=2, cols=3, step=None, is_bigendian=0):
    size = {"mono8": 1, "8UC1": 1, "mono16": 2, "16UC1": 2, "32FC1": 4}.get(encoding, 3)
    step = cols * size if step is None else step
    return SimpleNamespace(encoding=encoding, data=data, height=rows, width=cols, step=step, is_bigendian=is_bigendian)


@pytest.mark.parametrize(
    ("encoding", "dtype"),
    [("mono8", "u1"), ("8UC1", "u1"), ("mono16", "u2"), ("16UC1", "u2"), ("32FC1", "f4")],
)
@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize("padding", [0, 5])
def test_image_of_every_encoding(encoding, dtype, big_endian, padding):
    expected = np.arange(6).reshape(2, 3).astype(dtype)
    rows = [row.astype(np.dtype(dtype).newbyteorder(">" if big_endian else "<")).tobytes() for row in expected]
    data = b"".join(row + b"\xff" * padding for row in rows)
    msg = image(encoding, data, step=len(rows[0]) + padding, is_bigendian=int(big_endian))
    pixels = messages.image_from_message(msg)
    assert pixels.dtype == np.dtype(dtype)
    np.testing.assert_array_equal(pixels, expected)


@pytest.mark.parametrize("container", [bytes, bytearray, memoryview, lambda b: np.frombuffer(b, np.uint8)])
def test_data_may_come_in_any_container(container):
    pixels = messages.image_from_message(image("mono8", container(bytes(range(6)))))
    assert pixels.tolist() == [[0, 1, 2], [3, 4, 5]]


@pytest.mark.parametrize(
    ("msg", "text"),
    [
        (image("rgb8", bytes(18)), "'rgb8' is not supported; use one of mono8"),
        (image("mono8", bytes(5)), "must have 6 bytes; it has 5"),
        (image("mono8", bytes(7)), "must have 6 bytes; it has 7"),
        (image("mono8", b""), "must have 6 bytes; it has 0"),
        (image("mono8", b"", rows=0), "empty: 3 x 0 pixels"),
        (image("mono16", bytes(6), step=3), "row of 3 bytes"),
    ],
)
def test_bad_image_is_refused_with_the_reason(msg, text):
    with pytest.raises(ImageError, match=text):
        messages.image_from_message(msg)


def test_depth_in_millimetres_has_nan_for_zero():
    data = np.array([[0, 1, 1234], [65535, 0, 2]], "<u2").tobytes()
    depth = messages.depth_from_message(image("16UC1", data))
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, [[np.nan, 0.001, 1.234], [65.535, np.nan, 0.002]], rtol=1e-6)


def test_depth_in_metres_has_nan_for_all_that_is_no_return():
    data = np.array([[np.nan, np.inf, -np.inf], [0.0, -1.0, 1.5]], "<f4").tobytes()
    depth = messages.depth_from_message(image("32FC1", data))
    np.testing.assert_array_equal(np.isfinite(depth), [[False] * 3, [False, False, True]])
    assert depth[1, 2] == 1.5


def test_depth_of_another_encoding_is_refused():
    with pytest.raises(ImageError, match="depth encoding 'mono8'"):
        messages.depth_from_message(image("mono8", bytes(6)))


def test_depth_survives_the_way_there_and_back_to_half_a_millimetre():
    depth = np.array([[np.nan, 0.0004, 1.2344], [70.0, -1.0, 9.9996]])
    msg = messages.depth_message(make_message, 7, "tof", depth)
    back = messages.depth_from_message(msg)
    np.testing.assert_allclose(back, [[np.nan, np.nan, 1.234], [np.nan, np.nan, 10.0]], rtol=1e-6)


def cloud(points, dtype="<f4", row_padding=0, names="xyz", big_endian=False):
    """A cloud of points (rows, cols, 3), one unused float in front of each."""
    rows, cols = points.shape[:2]
    size = np.dtype(dtype).itemsize
    packed = np.concatenate([np.full((rows, cols, 1), 9.0), points], axis=-1).astype(dtype)
    data = b"".join(row.tobytes() + bytes(row_padding) for row in packed)
    fields = [
        SimpleNamespace(name=name, offset=(i + 1) * size, datatype=7 if size == 4 else 8, count=1)
        for i, name in enumerate(names)
    ]
    return SimpleNamespace(
        height=rows,
        width=cols,
        fields=fields,
        is_bigendian=big_endian,
        point_step=4 * size,
        row_step=4 * size * cols + row_padding,
        data=data,
    )


@pytest.mark.parametrize(("dtype", "big"), [("<f4", False), (">f4", True), ("<f8", False)])
def test_points_of_a_cloud(dtype, big):
    points = np.array([[[1, 2, 3], [np.nan, 0, 1], [4, 5, 6]], [[0, 0, 0], [0, 0, np.inf], [-1, -2, 0.5]]])
    got = messages.points_from_message(cloud(points, dtype, row_padding=3, big_endian=big))
    np.testing.assert_array_equal(got, [[1, 2, 3], [4, 5, 6], [-1, -2, 0.5]])
    assert got.dtype == np.float64


def test_bad_cloud_is_refused():
    points = np.ones((2, 2, 3))
    with pytest.raises(ImageError, match="missing or of another type: z"):
        messages.points_from_message(cloud(points, names="xyw"))
    short = cloud(points)
    short.data = short.data[:-1]
    with pytest.raises(ImageError, match="must have 64 bytes; it has 63"):
        messages.points_from_message(short)


def test_empty_cloud_has_no_points():
    assert messages.points_from_message(cloud(np.ones((1, 0, 3)))).shape == (0, 3)


def test_image_message_keeps_pixels_stamp_and_frame():
    pixels = np.arange(12, dtype=np.uint16).reshape(3, 4)
    msg = messages.image_message(make_message, 1_750_000_000_123_456_789, "camera", pixels, "mono16")
    assert messages.stamp_to_ns(msg.header.stamp) == 1_750_000_000_123_456_789
    assert (msg.header.frame_id, msg.height, msg.width, msg.step) == ("camera", 3, 4, 8)
    np.testing.assert_array_equal(messages.image_from_message(msg), pixels)


def test_image_message_refuses_pixels_of_another_type():
    with pytest.raises(ImageError, match="float64, cannot be sent as 'mono8'"):
        messages.image_message(make_message, 0, "camera", np.zeros((2, 2)), "mono8")


def test_camera_info_gives_the_camera_back():
    camera = Camera(480, 360, 819.5, 822.0, 239.5, 179.5, 0.0084, 0.0843)
    info = messages.camera_info_message(make_message, 5, "camera", camera)
    assert Camera.from_camera_info(info) == camera
    assert list(info.p) == [819.5, 0, 239.5, 0, 0, 822.0, 179.5, 0, 0, 0, 1, 0]


def test_static_transform_has_the_camera_as_parent():
    camera = Camera(4, 3, 2, 2, 1, 1)
    quarter_turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    calibration = Calibration(camera, camera, quarter_turn, np.array([0.1, 0.2, 0.3]))
    (sent,) = messages.transform_message(make_message, 0, calibration, "camera", "tof").transforms
    assert (sent.header.frame_id, sent.child_frame_id) == ("camera", "tof")
    shift, turn = sent.transform.translation, sent.transform.rotation
    np.testing.assert_allclose([shift.x, shift.y, shift.z], [0.1, 0.2, 0.3])
    np.testing.assert_allclose([turn.x, turn.y, turn.z, turn.w], [0, 0, 0.5**0.5, 0.5**0.5], atol=1e-15)


def test_imu_without_rates_says_so():
    msg = messages.imu_message(make_message, 0, "base_link", [0, 0, 0, 1], 0.01 * np.eye(3))
    assert msg.orientation.w == 1
    assert msg.orientation_covariance[4] == 0.01
    assert msg.angular_velocity_covariance[0] == msg.linear_acceleration_covariance[0] == -1


def test_message_with_a_wrong_field_is_refused():
    with pytest.raises(BagError, match="has no field secs; it has sec, nanosec"):
        make_message("builtin_interfaces/msg/Time", secs=1)


@pytest.mark.parametrize("frame_id", ["", "a", "camera", "camera_optical_frame"])
@pytest.mark.parametrize(("encoding", "dtype"), [("mono8", "u1"), ("16UC1", "u2"), ("32FC1", "f4")])
def test_image_in_its_bytes(frame_id, encoding, dtype):
    """Whatever the lengths of the texts before them, on which it depends where the numbers begin."""
    expected = np.arange(6).reshape(2, 3).astype(dtype)
    data = serialise(messages.image_message(make_message, 1_700_000_000_123_456_789, frame_id, expected, encoding))
    message = SerialisedImage.of(data)
    assert (message.stamp_ns, message.frame_id) == (1_700_000_000_123_456_789, frame_id)
    assert np.shares_memory(message.data, np.frombuffer(data, np.uint8))
    np.testing.assert_array_equal(messages.image_from_message(message), expected)


def test_bytes_that_are_no_image():
    """All beginnings of a message, and what is left of it when a byte is another."""
    data = serialise(messages.image_message(make_message, 1, "camera", np.zeros((2, 3), np.uint8), "mono8"))
    for length in range(len(data)):
        with pytest.raises(ImageError, match="no image message"):
            SerialisedImage.of(data[:length])
    for place in range(len(data)):
        for byte in (0, 127, 255):
            with contextlib.suppress(ImageError):
                messages.image_from_message(SerialisedImage.of(bytes([*data[:place], byte, *data[place + 1 :]])))
