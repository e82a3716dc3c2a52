"""Components of ToF frames against arrays that are known exactly."""

from __future__ import annotations

import numpy as np
import pytest
from rgbd_dic_acquisition.drivers.tof_components import (
    CONFIDENCE,
    INTENSITY,
    PIXEL_FORMATS,
    RANGE,
    Component,
    Coordinates,
    depth_frame,
)
from rgbd_dic_acquisition.errors import ImageError

ROWS, COLS = 5, 7
CODES = {known.name: code for code, known in PIXEL_FORMATS.items()}
# Powers of two, so that every product below is exact.
C16 = Coordinates(unit_m=1.0, scale=(1.0, 1.0, 2.0**-12), offset=(0.0, 0.0, 0.25), invalid=0.0)


def _component(kind: str, name: str, array: np.ndarray, padding: int = 0) -> Component:
    """The array (rows, cols, ...) as a device would send it, rows padded with bytes that mean something else."""
    rows = np.ascontiguousarray(array).reshape(len(array), -1).view(np.uint8)
    padded = np.pad(rows, ((0, 0), (0, padding)), constant_values=0xAA)
    return Component(kind, CODES[name], array.shape[1], array.shape[0], padded.tobytes(), padding)


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.mark.parametrize("padding", [0, 6])
def test_c16_is_scale_times_stored_plus_offset(rng, padding):
    stored = rng.integers(1, 65536, (ROWS, COLS)).astype("<u2")
    stored[1, 2] = stored[4, 6] = 0
    frame = depth_frame(11, [_component(RANGE, "Coord3D_C16", stored, padding)], C16)
    expected = np.where(stored == 0, np.nan, stored / 4096 + 0.25)
    np.testing.assert_array_equal(frame.depth_m, expected.astype(np.float32))
    assert frame.depth_m.dtype == np.float32 and frame.stamp_ns == 11
    assert frame.points_m is None and frame.intensity is None and frame.confidence is None


def test_millimetres_of_the_blaze_become_metres():
    # Basler: z [mm] = Scan3dCoordinateScale * g; in the long range the scale is about 10000 mm / 65536.
    stored = np.array([[6554, 13107, 0]], "<u2")
    coordinates = Coordinates(unit_m=1e-3, scale=(1.0, 1.0, 0.152588))
    frame = depth_frame(0, [_component(RANGE, "Coord3D_C16", stored)], coordinates)
    np.testing.assert_allclose(frame.depth_m, [[1.00006, 1.99997, np.nan]], atol=1e-5)


@pytest.mark.parametrize("invalid", [0.0, float("nan"), -1.0])
@pytest.mark.parametrize("layout", ["pixels", "planes", "parts"])
def test_points_come_from_each_layout(rng, layout, invalid):
    points = (rng.integers(-2048, 2048, (ROWS, COLS, 3)) / 1024).astype("<f4")
    points[..., 2] = np.abs(points[..., 2]) + 0.5
    stored = points.copy()
    stored[2, 3] = invalid
    points[2, 3] = np.nan
    planes = [np.ascontiguousarray(stored[..., axis]) for axis in range(3)]
    if layout == "pixels":
        components = [_component(RANGE, "Coord3D_ABC32f", stored)]
    elif layout == "planes":
        data = b"".join(plane.tobytes() for plane in planes)
        components = [Component(RANGE, CODES["Coord3D_ABC32f_Planar"], COLS, ROWS, data)]
    else:
        names = ("Coord3D_A32f", "Coord3D_B32f", "Coord3D_C32f")
        components = [_component(RANGE, name, plane) for name, plane in zip(names, planes, strict=True)]
    frame = depth_frame(0, components, Coordinates(unit_m=1.0, invalid=invalid))
    np.testing.assert_array_equal(frame.points_m, points)
    np.testing.assert_array_equal(frame.depth_m, points[..., 2])


def test_each_axis_has_its_own_scale_and_offset():
    stored = np.array([[[8.0, 16.0, 32.0]]], "<f4")
    coordinates = Coordinates(0.5, (1.0, 2.0, 4.0), (1.0, -1.0, 2.0))
    frame = depth_frame(0, [_component(RANGE, "Coord3D_ABC32f", stored)], coordinates)
    np.testing.assert_array_equal(frame.points_m, [[[4.5, 15.5, 65.0]]])


def test_depth_outside_the_limits_is_none_and_has_no_confidence():
    z = np.array([[0.5, 1.0, 2.0, 3.0, 3.5, -1.0, np.inf, np.nan]], "<f4")
    confidence = np.arange(100, 108, dtype="<u2")[None]
    intensity = confidence + np.uint16(1)
    components = [
        _component(CONFIDENCE, "Confidence16", confidence),
        _component(INTENSITY, "Mono16", intensity),
        _component(RANGE, "Coord3D_C32f", z),
    ]
    frame = depth_frame(0, components, Coordinates(unit_m=1.0), limits_m=(1.0, 3.0))
    np.testing.assert_array_equal(frame.depth_m, [[np.nan, 1, 2, 3, np.nan, np.nan, np.nan, np.nan]])
    np.testing.assert_array_equal(frame.confidence, [[0, 101, 102, 103, 0, 0, 0, 0]])
    np.testing.assert_array_equal(frame.intensity, intensity)


def test_nothing_marks_an_invalid_pixel_where_the_device_has_no_such_value():
    stored = np.array([[0, 1]], "<u2")
    coordinates = Coordinates(1.0, (1.0, 1.0, 1.0), (0.0, 0.0, 2.0), invalid=None)
    frame = depth_frame(0, [_component(RANGE, "Coord3D_C16", stored)], coordinates)
    np.testing.assert_array_equal(frame.depth_m, [[2, 3]])


def test_grey_values_keep_their_numbers(rng):
    z = np.ones((ROWS, COLS), "<u2")
    eight, ten = (rng.integers(0, top, (ROWS, COLS)) for top in (256, 1024))
    components = [
        _component(RANGE, "Coord3D_C16", z),
        _component(CONFIDENCE, "Confidence8", eight.astype("u1"), 1),
        _component(INTENSITY, "Mono10", ten.astype("<u2"), 2),
    ]
    frame = depth_frame(0, components, C16)
    np.testing.assert_array_equal(frame.confidence, eight)
    np.testing.assert_array_equal(frame.intensity, ten)
    assert frame.confidence.dtype == frame.intensity.dtype == np.uint16


def test_what_is_neither_of_the_three_is_passed_over():
    z = np.ones((2, 2), "<u2")
    frame = depth_frame(0, [Component("other", 0x1234, 0, 0, b""), _component(RANGE, "Coord3D_C16", z)], C16)
    assert np.isfinite(frame.depth_m).all()


def test_without_a_scale_there_is_no_depth():
    with pytest.raises(ImageError, match="does not tell the scale of its coordinates, Scan3dCoordinateScale"):
        depth_frame(0, [GOOD], None)


GOOD = _component(RANGE, "Coord3D_C16", np.ones((2, 3), "<u2"))


@pytest.mark.parametrize(
    ("components", "said"),
    [
        ([], "no component 'Range' with depth, only none"),
        ([_component(INTENSITY, "Mono8", np.ones((2, 3), "u1"))], "only intensity"),
        ([_component(RANGE, "Coord3D_A32f", np.ones((2, 3), "<f4"))], "no component 'Range' with depth"),
        ([Component(RANGE, 0x0220001E, 3, 2, bytes(99))], "0x0220001e, which is not read: set PixelFormat"),
        ([Component(RANGE, CODES["Coord3D_C16"], 3, 2, bytes(11))], "must have 12 bytes; it has 11"),
        ([Component(RANGE, CODES["Coord3D_C16"], 3, 2, bytes(13), 2)], "must have 14 bytes; it has 13"),
        ([Component(RANGE, CODES["Coord3D_C16"], 0, 2, bytes(99))], "of 0 x 2 pixels"),
        ([GOOD, _component(INTENSITY, "Mono8", np.ones((3, 3), "u1"))], "3 x 3 pixels uint8; the range has 3 x 2"),
        ([GOOD, _component(CONFIDENCE, "Coord3D_C32f", np.ones((2, 3), "<f4"))], "must have an integer for each"),
        ([GOOD, _component(RANGE, "Coord3D_A32f", np.ones((2, 4), "<f4"))], "planes of the range differ in size"),
    ],
)
def test_what_does_not_fit_is_refused(components, said):
    with pytest.raises(ImageError, match=said):
        depth_frame(0, components, C16)


def test_whatever_a_device_claims_is_decoded_or_refused(rng):
    """Sizes, formats and amounts of data that do not belong together: an ImageError, or a frame of that size."""
    codes = [*CODES.values(), 0, 0xFFFFFFFF]
    frames = 0
    for _ in range(3000):
        components = []
        for kind in rng.permutation([RANGE, INTENSITY, CONFIDENCE, "other"])[: rng.integers(5)]:
            width, height = (int(rng.choice([0, 1, 2, 3, 2**31, 2**63])) for _ in range(2))
            padding, size = int(rng.choice([-2, 0, 1, 7, 2**40])), int(rng.integers(80))
            code = int(rng.choice(codes))
            components.append(Component(str(kind), code, width, height, rng.bytes(size), padding))
        try:
            frame = depth_frame(0, components, C16, limits_m=(0.3, 5.0))
        except ImageError:
            continue
        frames += 1
        measured = frame.depth_m[np.isfinite(frame.depth_m)]
        assert frame.depth_m.size <= 9 and np.all((measured >= 0.3) & (measured <= 5.0))
    assert frames > 10
