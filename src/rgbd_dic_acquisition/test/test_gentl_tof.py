"""A ToF camera through GenTL: the virtual producer of the genicam wheel, and a Blaze that obeys the test."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from fake_blaze import FORMATS, HEIGHT, SERIAL, WIDTH, FakeBlaze, compiler, producer
from rgbd_dic_acquisition.calibration import Camera, points_from_depth
from rgbd_dic_acquisition.drivers.tof_camera import TofCamera
from rgbd_dic_acquisition.drivers.tof_device import device_class
from rgbd_dic_acquisition.drivers.tof_settings import TofSettings
from rgbd_dic_acquisition.errors import DeviceError, SettingsError
from rgbd_dic_acquisition.revival import Revival
from rgbd_dic_acquisition.sources import DepthFrame

INSTALL = "make setup-tof"
genicam = pytest.importorskip("genicam", reason=f"genicam is missing: {INSTALL}")
pytest.importorskip("harvesters", reason=f"harvesters is missing: {INSTALL}")
needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C++ compiler: apt-get install g++")

VIKY = Path(genicam.__file__).with_name("viky.cti")
RATE_HZ = 20.0


@pytest.fixture
def blaze(tmp_path, monkeypatch) -> FakeBlaze:
    made = FakeBlaze(tmp_path)
    for name, value in made.environment.items():
        monkeypatch.setenv(name, value)
    return made


def _settings(**values) -> TofSettings:
    return TofSettings(**{"producer": str(producer()), "depth_min_m": 0.3, "frame_rate_hz": RATE_HZ, **values})


def _next(source: TofCamera | Revival, count: int = 1) -> list[DepthFrame]:
    frames, end = [], time.monotonic() + 60
    while len(frames) < count:
        assert time.monotonic() < end, vars(source)
        frame = source.read(0.02)
        frames += [frame] if frame is not None else []
    return frames


def _until(source: TofCamera | Revival, condition: Callable[[], bool], seconds: float = 60.0) -> None:
    """Read until then."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, vars(source)
        source.read(0.02)


@contextlib.contextmanager
def _revived(settings: TofSettings) -> Iterator[tuple[TofCamera, Revival]]:
    camera = TofCamera("gentl", settings)
    revival = Revival(camera)
    revival.open()
    try:
        yield camera, revival
    finally:
        revival.close()


@pytest.mark.parametrize("gendc", [False, True])
def test_the_virtual_producer_gives_range_and_intensity(gendc):
    """Its points are a board seen straight from above, x the column and y the row in millimetres, and a ball on it."""
    settings = TofSettings(device="1", producer=str(VIKY), depth_min_m=0.0, gendc=gendc)
    with TofCamera("gentl", settings) as source:
        frames = _next(source, 8)
    assert source.told["device"] == "Viky 1" and source.told["clock"] == "none: stamps are the arrival"
    assert source.counts == {"frames": 8, "failed": 0, "lost": 0}
    assert "has no component Confidence" in source.told["not done"]
    assert "its range comes as Coord3D_ABC32f_Planar" in source.told["not done"]
    rows, cols = np.mgrid[0:400, 0:400]
    for frame in frames:
        assert frame.depth_m.shape == frame.intensity.shape == (400, 400) and frame.confidence is None
        ball = np.isfinite(frame.depth_m)
        assert 300 < ball.sum() < 500  # 20 mm across: 314 mm^2, and its rim
        expected = np.stack([1e-3 * cols[ball], 1e-3 * rows[ball], frame.depth_m[ball]], axis=-1)
        np.testing.assert_allclose(frame.points_m[ball], expected, atol=1e-7)
        assert np.isnan(frame.points_m[~ball]).all()
    assert len({frame.depth_m.tobytes() for frame in frames}) > 1  # the ball moves
    stamps_s = np.array([frame.stamp_ns for frame in frames]) / 1e9
    assert np.all(np.diff(stamps_s) > 0)


@needs_compiler
def test_a_blaze_is_set_up_and_read(blaze):
    with TofCamera("gentl", _settings()) as source:
        frame = _next(source, 3)[-1]
    assert source.told["device"] == f"fake blaze-101 {SERIAL}" and "not done" not in source.told
    assert source.told["clock"].startswith("by latches")
    assert source.camera == Camera(WIDTH, HEIGHT, 51.25, 51.25, 31.125, 24.5)
    expected = np.where(blaze.stored == 0, np.nan, blaze.stored * (10000 / 65536 * 1e-3))
    np.testing.assert_allclose(frame.depth_m, expected, rtol=3e-7)  # single precision, rounded thrice
    np.testing.assert_array_equal(frame.intensity, blaze.intensity)
    np.testing.assert_array_equal(frame.confidence, np.where(blaze.stored == 0, 0, blaze.confidence))
    assert blaze["OperatingMode"] == 1 and blaze["FastMode"] == 0 and blaze["DistortionCorrection"] == 1
    assert (blaze["DepthMin"], blaze["DepthMax"]) == (300, 5000)
    assert blaze["AcquisitionFrameRate"] == RATE_HZ and blaze["TriggerMode"] == 0
    assert blaze["ExposureTime"] == 750.0 and blaze["ConfidenceThreshold"] == 208  # its own


@needs_compiler
def test_other_settings_reach_the_device(blaze):
    settings = _settings(
        device=SERIAL,
        long_range=False,
        fast_mode=True,
        depth_min_m=0.4,
        depth_max_m=1.2,
        frame_rate_hz=30.0,
        exposure_s=250e-6,
        confidence_threshold=500,
        intensity=False,
        confidence=False,
    )
    with TofCamera("gentl", settings) as source:
        frame = _next(source)[0]
    assert frame.intensity is None and frame.confidence is None
    assert blaze["OperatingMode"] == 0 and blaze["FastMode"] == 1
    assert (blaze["DepthMin"], blaze["DepthMax"]) == (400, 1200)
    assert blaze["AcquisitionFrameRate"] == 30.0 and blaze["ExposureTime"] == 250.0
    assert blaze["ConfidenceThreshold"] == 500 and blaze["ComponentEnable"] == [1, 0, 0]
    inside = (blaze.stored * (10 / 65536) >= 0.4) & (blaze.stored * (10 / 65536) <= 1.2)
    np.testing.assert_array_equal(np.isfinite(frame.depth_m), inside)


@needs_compiler
def test_points_and_depth_of_a_blaze_agree(blaze):
    """The points in millimetres, and the depth through the intrinsics of the device, are the same points."""
    with TofCamera("gentl", _settings(range_format="Coord3D_ABC32f")) as source:
        frame = _next(source)[0]
    assert blaze["PixelFormat"][0] == FORMATS["Coord3D_ABC32f"]
    np.testing.assert_allclose(
        frame.depth_m, np.where(blaze.stored == 0, np.nan, blaze.stored * (10 / 65536)), rtol=1e-6
    )
    through_pinhole = points_from_depth(source.camera, frame.depth_m).reshape(frame.points_m.shape)
    np.testing.assert_allclose(frame.points_m, through_pinhole, atol=1e-6)  # float32 at 4 m
    off = [float(number) for number in source.told["points off the intrinsics [px]"].split(",")]
    assert off == [0.0, 0.0]  # to the two digits that are told


@needs_compiler
def test_a_principal_point_that_is_counted_otherwise_is_told(blaze):
    with TofCamera("gentl", _settings(range_format="Coord3D_ABC32f")) as source:
        blaze["Scan3dPrincipalPointU"] += 0.5  # from now on the points are made with another one than was told
        _next(source)
    assert source.told["points off the intrinsics [px]"] == "-0.50, 0.00"


@needs_compiler
@pytest.mark.parametrize(
    ("values", "error", "said"),
    [
        ({"long_range": False}, SettingsError, "refuses DepthMax = 5000 .possible: 0 to 1498"),
        ({"frame_rate_hz": 30.0}, SettingsError, "refuses AcquisitionFrameRate = 30.0 .possible: 1 to 20"),
        ({"exposure_s": 0.01}, SettingsError, "refuses ExposureTime = 10000.0 .possible: 100 to 1000"),
        ({"device": "1234"}, DeviceError, "no device '1234' is found .*24000101.*check power"),
        ({"producer": "/nowhere.cti"}, DeviceError, "producer = /nowhere.cti is no file"),
    ],
)
def test_what_the_device_refuses_is_told_with_its_limits(blaze, values, error, said):
    with pytest.raises(error, match=said):
        TofCamera("gentl", _settings(**values)).open()
    with TofCamera("gentl", _settings()) as source:  # it was let go of
        _next(source)


@needs_compiler
def test_a_device_that_does_not_measure_lengths_is_refused(blaze):
    blaze["Scan3dDistanceUnit"] = 1
    with pytest.raises(DeviceError, match="measures in Pixel: set Scan3dDistanceUnit to one of Millimeter"):
        TofCamera("gentl", _settings()).open()


def test_opening_leaves_ctrl_c_to_the_program():
    before = signal.getsignal(signal.SIGINT)
    with TofCamera("gentl", TofSettings(device="1", producer=str(VIKY))):
        assert signal.getsignal(signal.SIGINT) is before


def test_more_devices_than_one_must_be_told_apart():
    with pytest.raises(DeviceError, match=r"more than one device is found .*VikyTL_DEV_red"):
        device_class("gentl")(TofSettings(producer=str(VIKY)))


def test_producers_are_found_by_the_environment(monkeypatch, tmp_path):
    monkeypatch.delenv("GENICAM_GENTL64_PATH", raising=False)
    with pytest.raises(DeviceError, match="no GenTL producer: GENICAM_GENTL64_PATH = ''"):
        device_class("gentl")(TofSettings())
    monkeypatch.setenv("GENICAM_GENTL64_PATH", f"{tmp_path}{os.pathsep}{VIKY.parent}")
    device_class("gentl")(TofSettings(device="2")).close()


def test_limits_that_leave_nothing_are_refused():
    with pytest.raises(SettingsError, match=r"depth_min_m = 2.0 m must be below depth_max_m = 1.0 m"):
        TofSettings(depth_min_m=2.0, depth_max_m=1.0)


def test_a_library_that_is_missing_is_told_with_the_remedy(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "rgbd_dic_acquisition.drivers.gentl_tof", None)
    with pytest.raises(DeviceError, match=r"needs the Python packages harvesters and genicam, .*: make setup-tof$"):
        device_class("gentl")


@needs_compiler
@pytest.mark.parametrize("latch", [True, False])
def test_stamps_are_the_moment_of_the_frame_in_host_time(tmp_path, monkeypatch, latch):
    """The camera's clock is two hours off and 60 ppm fast; its frames come up to 30 ms late, or later.

    The error is within four of the standard uncertainties that are told; without a latch, what the fastest of the
    frames took is in it too.
    """
    blaze = FakeBlaze(tmp_path, latch)
    monkeypatch.setenv("FAKE_BLAZE", blaze.environment["FAKE_BLAZE"])
    blaze["jitter_s"] = 0.030
    boot_ns = max(time.time_ns() - time.monotonic_ns() for _ in range(100))
    fastest_ms, known = np.inf, 0
    with TofCamera("gentl", _settings()) as source:
        for _ in range(50):
            frame = _next(source)[0]
            true_ns = boot_ns + (frame.device_ns - blaze["offset_ns"]) / (1 + 1e-6 * blaze["skew_ppm"])
            fastest_ms = min(fastest_ms, (time.time_ns() - true_ns) / 1e6)
            how, told_ms = re.fullmatch(r"by (\w+), to (\S+) ms", source.told["clock"]).groups()
            assert how == ("latches" if latch else "arrivals")
            error_ms, within_ms = (frame.stamp_ns - true_ns) / 1e6, 4 * float(told_ms) + 0.5
            known += np.isfinite(within_ms)
            assert -within_ms < error_ms < within_ms + (0 if latch else fastest_ms)
    assert known > 5


@needs_compiler
@pytest.mark.parametrize("ticks_only", [1, 0])
def test_ticks_are_converted_or_not_taken_for_nanoseconds(blaze, ticks_only):
    blaze["tick_ns"], blaze["ticks_only"] = 8, ticks_only
    with TofCamera("gentl", _settings()) as source:
        _next(source, 20)
        frame, now_ns = _next(source)[0], time.time_ns()
    clock = "by latches" if ticks_only else "none in nanoseconds: stamps are the arrival"
    assert source.told["clock"].startswith(clock)
    assert 0 < now_ns - frame.stamp_ns < 5e9


@needs_compiler
def test_a_clock_is_one_of_nanoseconds_also_where_the_first_frame_is_read_late(blaze):
    with TofCamera("gentl", _settings()) as source:
        time.sleep(0.3)  # as on a busy computer
        _next(source, 30)
    assert source.told["clock"].startswith("by latches")


@needs_compiler
def test_failed_and_lost_buffers_are_counted(blaze):
    with TofCamera("gentl", _settings()) as source:
        before = _next(source)[0]
        blaze["fail"], blaze["skip"] = 2, 3
        _until(source, lambda: source.counts["failed"] == 2)
        assert source.failure == "the buffer is incomplete"
        after = _next(source, 2)
        assert source.counts["lost"] == 3
        assert before.stamp_ns < after[0].stamp_ns < after[1].stamp_ns


@needs_compiler
def test_a_camera_that_goes_silent_is_opened_again(blaze):
    with _revived(_settings()) as (source, revival):
        last = _next(revival, 2)[-1]
        blaze["frozen"] = 1
        _until(revival, lambda: "no frame comes, where one is due every 0.05 s" in revival.problem)
        _until(revival, lambda: revival.reopened > 0)
        blaze["frozen"] = 0
        assert _next(revival)[0].stamp_ns > last.stamp_ns
        assert not revival.problem and source.counts["failed"] == 0


@needs_compiler
def test_a_camera_that_is_unplugged_comes_back(blaze):
    blaze["present"] = 0
    with _revived(_settings()) as (_, revival):
        _until(revival, lambda: "no device is found" in revival.problem)  # not there from the start
        blaze["present"] = 1
        first = _next(revival)[0]
        blaze["present"] = 0
        _until(revival, lambda: "no device is found" in revival.problem)
        blaze["offset_ns"] = 1_000_000_000  # it starts anew, so does its clock
        blaze["present"] = 1
        again = _next(revival, 3)
        assert again[0].stamp_ns > first.stamp_ns and not revival.problem
        assert all(0 < time.time_ns() - frame.stamp_ns < 10e9 for frame in again)
        np.testing.assert_array_equal(again[0].depth_m, first.depth_m)


@needs_compiler
def test_a_camera_that_vanishes_while_it_is_set_up_is_not_taken_for_one_that_lacks_features(blaze):
    def connect(settings: TofSettings):
        device = device_class("gentl")(settings)
        blaze["present"] = 0
        return device

    with pytest.raises(DeviceError, match="does not answer when asked for TriggerMode"):
        TofCamera("gentl", _settings(), connect).open()
    blaze["present"] = 1
    with TofCamera("gentl", _settings()) as source:
        _next(source)


@needs_compiler
def test_a_camera_that_only_fails_is_opened_again(blaze):
    with _revived(_settings()) as (_, revival):
        _next(revival)
        blaze["fail"] = 10_000
        _until(revival, lambda: "sends no good buffer: the buffer is incomplete" in revival.problem)
        blaze["fail"] = 0
        _next(revival)
        assert revival.reopened == 1
