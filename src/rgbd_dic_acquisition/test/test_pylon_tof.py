"""A ToF camera through pylon: its camera emulation, whose buffers can be made to fail, and GenDC files."""

from __future__ import annotations

import dataclasses
import struct
import time
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from rgbd_dic_acquisition.drivers.tof_camera import TofCamera
from rgbd_dic_acquisition.drivers.tof_components import CONFIDENCE, INTENSITY, RANGE, Coordinates, depth_frame
from rgbd_dic_acquisition.drivers.tof_settings import TofSettings
from rgbd_dic_acquisition.errors import DeviceError

INSTALL = "pypylon is missing: make setup-tof"
pylon = pytest.importorskip("pypylon.pylon", reason=INSTALL)
from rgbd_dic_acquisition.drivers.pylon_tof import PylonTof, components  # noqa: E402 - only where pylon is

SERIAL = "0815-0001"
ROWS, COLS = 48, 64
MONO16, C16, ABC32F, CONFIDENCE16 = 0x01100007, 0x011000B8, 0x026000C0, 0x011000C7
IDS = {INTENSITY: 1, RANGE: 4, CONFIDENCE: 6}


@pytest.fixture(autouse=True)
def two_emulated_cameras(monkeypatch):
    monkeypatch.setenv("PYLON_CAMEMU", "2")


@pytest.fixture
def depth(tmp_path) -> tuple[Path, np.ndarray]:
    """A folder with one image of 16 bit, for the emulation to show."""
    stored = np.random.default_rng(5).integers(2000, 30000, (ROWS, COLS)).astype(np.uint16)
    stored[3, 4] = 0
    cv2.imwrite(str(tmp_path / "depth.png"), stored)
    return tmp_path, stored


class EmulatedTof:
    """pylon's emulated camera showing a depth image in millimetres.

    Its only component, an intensity, is taken for a range, and it is given the scale that it does not tell.
    """

    def __init__(self, settings: TofSettings, images: Path) -> None:
        self._device = PylonTof(settings)
        self.name, own = self._device.name, self._device.features
        added = {"Scan3dCoordinateScale": SimpleNamespace(Value=1.0)}
        self.features = dataclasses.replace(own, find=lambda name: added.get(name) or own.find(name))
        shown = {"Width": COLS, "Height": ROWS, "PixelFormat": "Mono16", "TestImageSelector": "Off"}
        for name, value in {**shown, "ImageFilename": str(images), "ImageFileMode": "On"}.items():
            assert self.features.set(name, value)

    def start(self) -> None:
        self._device.start()

    def grab(self, timeout_s: float):
        grab = self._device.grab(timeout_s)
        if grab is None or not grab.components:
            return grab
        (component,) = grab.components
        assert (component.kind, component.pixel_format) == (INTENSITY, MONO16)
        return dataclasses.replace(grab, components=(dataclasses.replace(component, kind=RANGE, pixel_format=C16),))

    def close(self) -> None:
        self._device.close()

    def fail(self, buffers: int) -> None:
        self.features.set("ForceFailedBufferCount", buffers)
        self.features.execute("ForceFailedBuffer")


def test_forced_failures_are_counted_and_the_frames_go_on(depth):
    folder, stored = depth
    made: list[EmulatedTof] = []

    def connect(settings: TofSettings) -> EmulatedTof:
        made.append(EmulatedTof(settings, folder))
        return made[-1]

    settings = TofSettings(device=SERIAL, depth_min_m=0.0, depth_max_m=10.0, frame_rate_hz=20.0)
    frames, end = [], time.monotonic() + 60
    with TofCamera("pylon", settings, connect) as source:
        while len(frames) < 12 and time.monotonic() < end:
            frame = source.read(0.02)
            if frame is not None:
                frames.append(frame)
                if len(frames) == 4:
                    made[0].fail(5)
    assert source.counts == {"frames": 12, "failed": 5, "lost": 0}
    assert source.failure == "The buffer was incompletely grabbed."
    expected = np.where(stored == 0, np.nan, stored * 1e-3)
    for frame in frames:
        np.testing.assert_allclose(frame.depth_m, np.where(expected > 10, np.nan, expected), rtol=1e-6)
    assert np.all(np.diff([frame.stamp_ns for frame in frames]) > 0)


def test_a_camera_without_range_gives_no_frame_and_says_why():
    with TofCamera("pylon", TofSettings(device=SERIAL)) as source:
        end = time.monotonic() + 60
        while source.counts["failed"] < 3 and time.monotonic() < end:
            assert source.read(0.02) is None
    assert "no component 'Range' with depth, only intensity" in source.failure
    assert source.told["device"] == f"Emulation {SERIAL}"
    assert "has no component Range, Intensity, Confidence" in source.told["not done"]


def test_the_device_is_named_when_there_are_more():
    with pytest.raises(DeviceError, match=rf"more than one device is found by pylon .*{SERIAL}"):
        PylonTof(TofSettings())
    with pytest.raises(DeviceError, match=r"no device '7' is found by pylon .*0815-0000"):
        PylonTof(TofSettings(device="7"))


def gendc(parts: list[tuple[str, int, np.ndarray]], rows: int, cols: int) -> bytes:
    """A GenDC 1.1 container (EMVA, GenDC specification, chapter 2) with one 2D part for each component."""
    count, component_size, part_size = len(parts), 56, 56
    header_size = 56 + 8 * count
    offsets = [header_size + index * (component_size + part_size) for index in range(count)]
    descriptor_size = header_size + count * (component_size + part_size)
    data = [array.tobytes() for _, _, array in parts]
    starts = np.cumsum([descriptor_size, *map(len, data)]).tolist()
    total = starts[-1] - descriptor_size
    container = b"GNDC" + bytes([1, 1, 0, 0]) + struct.pack("<HHIQHHI", 0x1000, 0, header_size, 1, 0, 0, 0)
    container += struct.pack("<QQII", total, descriptor_size, descriptor_size, count)
    container += struct.pack(f"<{count}Q", *offsets)
    for (kind, pixel_format, _), offset, start, content in zip(parts, offsets, starts, data, strict=False):
        container += struct.pack("<HHIHHHHIIQ", 0x2000, 0, component_size, 0, 0, 0, 0, 0, 0, 1)
        container += struct.pack("<QIHHQ", IDS[kind], pixel_format, 0, 1, offset + component_size)
        container += struct.pack("<HHIIHH", 0x4200, 0, part_size, pixel_format, 0, 0)
        container += struct.pack("<QQQIIHHI", start, len(content), start, cols, rows, 0, 0, 0)
    return container + b"".join(data)


def _load(folder: Path, content: bytes) -> tuple:
    path = folder / "frame.gendc"
    path.write_bytes(content)
    container = pylon.PylonDataContainer()
    container.Load(str(path))
    return tuple(components(container))


@pytest.fixture
def rng():
    return np.random.default_rng(9)


def test_the_components_of_a_gendc_file_are_found_by_their_type(tmp_path, rng):
    rows, cols = 5, 7
    stored, intensity, confidence = (rng.integers(1, 65536, (rows, cols)).astype("<u2") for _ in range(3))
    stored[1, 1] = 0
    parts = [(CONFIDENCE, CONFIDENCE16, confidence), (RANGE, C16, stored), (INTENSITY, MONO16, intensity)]
    coordinates = Coordinates(1.0, (1.0, 1.0, 2.0**-12))
    frame = depth_frame(3, _load(tmp_path, gendc(parts, rows, cols)), coordinates)
    np.testing.assert_array_equal(frame.depth_m, np.where(stored == 0, np.nan, stored / 4096).astype(np.float32))
    np.testing.assert_array_equal(frame.intensity, intensity)
    np.testing.assert_array_equal(frame.confidence, np.where(stored == 0, 0, confidence))


def test_the_points_of_a_gendc_file_are_exact(tmp_path, rng):
    points = (rng.integers(-4096, 4096, (5, 7, 3)) / 1024).astype("<f4")
    points[..., 2] = np.abs(points[..., 2]) + 0.25
    points[2, 2] = np.nan
    coordinates = Coordinates(1.0, invalid=float("nan"))
    frame = depth_frame(3, _load(tmp_path, gendc([(RANGE, ABC32F, points)], 5, 7)), coordinates)
    np.testing.assert_array_equal(frame.points_m, points)
    assert frame.intensity is None and frame.confidence is None
