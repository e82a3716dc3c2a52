"""Each check before take-off passes on what is right, and fails or warns, with a remedy, on what is wrong."""

from __future__ import annotations

import os
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from rgbd_dic_acquisition.calibration import Calibration, save_calibration
from rgbd_dic_acquisition.drivers.aravis_library import aravis
from rgbd_dic_acquisition.drivers.tof_settings import TofSettings
from rgbd_dic_acquisition.simulator.flight import Flight, FlightSettings
from rgbd_dic_acquisition.simulator.ground_truth import save_regions
from rgbd_dic_processing.checking import autopilot, cameras, computer, installed, panel
from rgbd_dic_processing.checking.finding import Finding, Level
from rgbd_dic_processing.checking.listening import Heard, HeardAutopilot
from rgbd_dic_processing.core.regions_file import load_regions
from rgbd_dic_processing.core.settings import PairingSettings, ProcessingSettings

MB = 1 << 20
SETTINGS = ProcessingSettings()


def is_level(finding: Finding, level: Level) -> bool:
    """Of that level, and with a remedy if something is wrong."""
    print(finding)
    return finding.level == level and bool(finding.remedy) == (level in (Level.WARN, Level.FAIL))


def tree(root: Path, files: dict[str, str]) -> Path:
    """A file system with these files."""
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(f"{text}\n")
    return root


def test_socket_buffers(tmp_path: Path) -> None:
    assert is_level(computer.socket_buffers(4 * MB, tmp_path), Level.NOT_CHECKED)
    tree(tmp_path, {"proc/sys/net/core/rmem_max": "212992"})
    assert is_level(computer.socket_buffers(4 * MB, tmp_path), Level.FAIL)
    assert is_level(computer.socket_buffers(212992, tmp_path), Level.PASS)


def test_usb(tmp_path: Path) -> None:
    limit, port = "sys/module/usbcore/parameters/usbfs_memory_mb", "sys/bus/usb/devices/2-1"
    assert is_level(computer.usb_memory(31 * MB, tmp_path), Level.NOT_CHECKED)
    assert is_level(computer.usb_speed(tmp_path), Level.NOT_CHECKED)
    tree(tmp_path, {limit: "16", f"{port}/idVendor": "1e10", f"{port}/speed": "480"})
    assert is_level(computer.usb_memory(31 * MB, tmp_path), Level.FAIL)
    assert is_level(computer.usb_speed(tmp_path), Level.FAIL)
    tree(tmp_path, {limit: "200", f"{port}/speed": "5000"})
    assert is_level(computer.usb_memory(31 * MB, tmp_path), Level.PASS)
    assert is_level(computer.usb_speed(tmp_path), Level.PASS)
    assert is_level(computer.usb_memory(31 * MB, tree(tmp_path, {limit: "0"})), Level.PASS)  # without limit


def test_shared_memory_and_disk(tmp_path: Path) -> None:
    """On the real file system of the test."""
    assert is_level(computer.shared_memory(1, tmp_path), Level.PASS)
    assert is_level(computer.shared_memory(1 << 30, tmp_path), Level.WARN)
    assert is_level(computer.shared_memory(1, tmp_path / "missing"), Level.NOT_CHECKED)
    assert is_level(computer.free_disk(tmp_path / "to" / "be" / "made", 1e3, 1), Level.PASS)
    assert is_level(computer.free_disk(tmp_path, 1e9, 1e6), Level.FAIL)
    assert is_level(computer.disk_speed(tmp_path, 1.0), Level.PASS)
    assert is_level(computer.disk_speed(tmp_path, 1e15), Level.FAIL)
    assert is_level(computer.disk_speed(Path("/proc"), 1.0), Level.FAIL)  # nobody can write there
    assert not list(tmp_path.iterdir())


def test_clock_of_the_computer() -> None:
    def forbidden() -> tuple[int, int]:
        raise OSError("not permitted")

    assert is_level(computer.host_clock(lambda: (0x2001, 12_000)), Level.PASS)
    assert is_level(computer.host_clock(lambda: (0x0041, 16_000_000)), Level.WARN)
    assert is_level(computer.host_clock(forbidden), Level.NOT_CHECKED)
    assert computer.host_clock().level != Level.FAIL  # the kernel's own


def test_processor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scaling, heat = "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "sys/class/thermal/thermal_zone0/temp"
    assert is_level(computer.governor(tmp_path), Level.NOT_CHECKED)
    assert is_level(computer.temperature(tmp_path), Level.NOT_CHECKED)
    tree(tmp_path, {scaling: "powersave", heat: "95000"})
    assert is_level(computer.governor(tmp_path), Level.WARN)
    assert is_level(computer.temperature(tmp_path), Level.FAIL)
    tree(tmp_path, {scaling: "performance", heat: "51500"})
    assert is_level(computer.governor(tmp_path), Level.PASS)
    assert is_level(computer.temperature(tmp_path), Level.PASS)
    monkeypatch.setattr(os, "getloadavg", lambda: (0.0, 0.0, 0.0))
    assert is_level(computer.load(), Level.PASS)
    monkeypatch.setattr(os, "getloadavg", lambda: (1000.0, 0.0, 0.0))
    assert is_level(computer.load(), Level.WARN)


def test_ros_domain() -> None:
    rclpy = pytest.importorskip("rclpy")
    domain, context = 43, rclpy.Context()
    assert is_level(computer.ros_domain(domain, {"dic_node"}), Level.PASS)
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("dic_node", context=context)
    try:
        assert is_level(computer.ros_domain(domain, {"dic_node"}), Level.FAIL)
        assert is_level(computer.ros_domain(domain, {"plane_node"}), Level.WARN)
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_drivers_that_are_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("gi", "pypylon", "pymavlink", "pymavlink.dialects.v20"):
        monkeypatch.setitem(sys.modules, module, None)
    for module in ("pylon_tof", "mavlink"):
        monkeypatch.delitem(sys.modules, f"rgbd_dic_acquisition.drivers.{module}", raising=False)
    aravis.cache_clear()
    try:
        assert is_level(installed.camera_driver(), Level.FAIL)
        assert is_level(installed.tof_driver("pylon"), Level.FAIL)
        assert is_level(installed.autopilot_driver(), Level.FAIL)
    finally:
        aravis.cache_clear()
    assert is_level(installed.tof_driver("kinect"), Level.FAIL)
    assert is_level(installed.camera_driver("simulated"), Level.WARN)


def test_drivers_that_are_there() -> None:
    assert is_level(installed.autopilot_driver(), Level.PASS)
    for check, module in ((installed.camera_driver, "gi"), (lambda: installed.tof_driver("gentl"), "harvesters")):
        pytest.importorskip(module)
        assert is_level(check(), Level.PASS)


@pytest.fixture(scope="module")
def flight() -> Flight:
    return Flight(FlightSettings())


@pytest.fixture(scope="module")
def image(flight: Flight) -> np.ndarray:
    return flight.image(0.0, 0)


@pytest.fixture(scope="module")
def regions_path(flight: Flight, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("regions") / "regions.yaml"
    save_regions(flight, 0.0, path)
    return path


def test_calibration(flight: Flight, tmp_path: Path) -> None:
    path, good = tmp_path / "calibration.yaml", flight.calibration

    def checked(calibration: Calibration) -> Finding:
        save_calibration(calibration, path)
        return installed.calibration_file(path)[0]

    assert is_level(checked(good), Level.PASS)
    assert is_level(installed.calibration_file(tmp_path / "missing.yaml")[0], Level.FAIL)
    assert is_level(checked(replace(good, tof=None)), Level.FAIL)
    assert is_level(checked(replace(good, camera=replace(good.camera, fx=2 * good.camera.fx))), Level.WARN)
    assert is_level(checked(replace(good, camera=replace(good.camera, cx=0.0))), Level.WARN)
    assert is_level(checked(replace(good, camera=replace(good.camera, k1=-9.0))), Level.WARN)
    assert is_level(checked(replace(good, t_camera_tof=1e3 * good.t_camera_tof)), Level.WARN)  # millimetres
    assert is_level(checked(replace(good, R_camera_tof=np.diag([-1.0, -1.0, 1.0]))), Level.WARN)


def test_regions(flight: Flight, regions_path: Path, tmp_path: Path) -> None:
    finding, regions, subsets = panel.regions_file(regions_path, flight.calibration, SETTINGS)
    assert is_level(finding, Level.PASS) and regions is not None and subsets > 100
    entries = yaml.safe_load(regions_path.read_text())
    corners = entries["panel"]
    for name, changed in (("no_crack", {"crack": None}), ("outside", {"panel": [[-9.0, -9.0], *corners[1:]]})):
        path = tmp_path / f"{name}.yaml"
        content = {key: value for key, value in {**entries, **changed}.items() if value is not None}
        path.write_text(yaml.safe_dump(content))
        assert is_level(panel.regions_file(path, flight.calibration, SETTINGS)[0], Level.FAIL), name


def test_focus(flight: Flight, image: np.ndarray, regions_path: Path) -> None:
    regions = load_regions(regions_path)

    def checked(seen: np.ndarray) -> Finding:
        return panel.pattern(seen, flight.calibration, regions, SETTINGS, noise=1.0, footprint_m=1e-3)

    assert is_level(checked(image), Level.PASS)
    assert checked(cv2.GaussianBlur(image, (0, 0), 8.0)).level in (Level.WARN, Level.FAIL)  # out of focus
    assert is_level(checked(np.full_like(image, 200)), Level.FAIL)  # another wall


def test_light(image: np.ndarray) -> None:
    assert is_level(cameras.brightness(image.ravel()), Level.PASS)
    assert is_level(cameras.brightness((image * 0.4).astype(np.uint8).ravel()), Level.WARN)
    assert is_level(cameras.brightness((image * 0.1).astype(np.uint8).ravel()), Level.FAIL)
    assert is_level(cameras.brightness(np.minimum(image * 2.0, 255).astype(np.uint8).ravel()), Level.FAIL)


def test_depth(flight: Flight, regions_path: Path) -> None:
    regions, depth_m = load_regions(regions_path), flight.depth(0.0, 0).depth_m.astype(np.float32)

    def checked(seen_m: np.ndarray, tof: TofSettings | None = None) -> dict[str, Level]:
        findings, _ = panel.depth(seen_m, flight.calibration, regions, SETTINGS, tof or TofSettings())
        for finding in findings:
            assert is_level(finding, finding.level)
        return {finding.name: finding.level for finding in findings}

    assert set(checked(depth_m).values()) == {Level.PASS} and len(checked(depth_m)) == 3
    rng = np.random.default_rng(1)
    assert checked(np.where(rng.random(depth_m.shape) < 0.4, np.nan, depth_m))["depth of the panel"] == Level.WARN
    assert checked(np.full_like(depth_m, np.nan))["depth of the panel"] == Level.FAIL
    assert checked(depth_m + rng.normal(0, 0.02, depth_m.shape).astype("f4"))["plane"] == Level.WARN
    assert checked(depth_m + rng.uniform(-1, 1, depth_m.shape).astype("f4"))["plane"] == Level.FAIL
    far = TofSettings(depth_min_m=0.3, depth_max_m=1.25)
    assert checked(depth_m, far)["distance"] == Level.WARN  # the panel is 1.2 m away
    assert checked(depth_m, TofSettings(depth_min_m=1.5))["distance"] == Level.FAIL


def heard(rate_hz: float, count: int = 100, **values: object) -> Heard:
    stamps = [round(index * 1e9 / rate_hz) for index in range(count)]
    told = {"clock": "by latches, to 0.010 ms", "camera": "FLIR"}
    counts = Counter({"received": count, "lost": 0, "incomplete": 0})
    return replace(Heard("", stamps, None, counts, told, 10_000.0), **values)


def test_a_camera_that_is_there_and_one_that_is_not() -> None:
    assert is_level(cameras.answers("camera", heard(60.0), "2 ms"), Level.PASS)
    assert is_level(cameras.answers("camera", Heard("no camera answers"), "2 ms"), Level.FAIL)
    lacking = heard(20.0, told={"device": "Blaze", "not done": "FastMode"})
    assert is_level(cameras.answers("ToF camera", lacking, "0.3 to 5 m"), Level.WARN)


@pytest.mark.parametrize("rate_hz, level", [(59.8, Level.PASS), (55.0, Level.WARN), (30.0, Level.FAIL)])
def test_frame_rate(rate_hz: float, level: Level) -> None:
    assert is_level(cameras.frame_rate("rate", heard(rate_hz), 60.0), level)


@pytest.mark.parametrize("lost, level", [(0, Level.PASS), (1, Level.WARN), (30, Level.FAIL)])
def test_lost_frames(lost: int, level: Level) -> None:
    assert is_level(cameras.lost_frames("frames", heard(60.0, counts=Counter(lost=lost))), level)


def test_clock_of_a_camera() -> None:
    def checked(clock: str, uncertainty_ns: float) -> Finding:
        return cameras.camera_clock("clock", heard(60.0, told={"clock": clock}, uncertainty_ns=uncertainty_ns))

    assert is_level(checked("by latches, to 0.010 ms", 1e4), Level.PASS)
    assert is_level(checked("by arrivals, to 0.100 ms", 1e5), Level.WARN)
    assert is_level(checked("by latches, to 3.000 ms", 3e6), Level.WARN)
    assert is_level(checked("by arrivals, to 12.000 ms", 12e6), Level.FAIL)
    assert is_level(checked("none: stamps are the arrival", float("inf")), Level.WARN)


def test_pairing() -> None:
    images, frames = heard(60.0, 300), heard(20.0, 100)
    assert is_level(cameras.pairing(images, frames, PairingSettings()), Level.PASS)
    gone = heard(20.0, 100, stamps_ns=[*frames.stamps_ns[:40], *frames.stamps_ns[70:]])
    assert is_level(cameras.pairing(images, gone, PairingSettings()), Level.FAIL)
    elsewhere = heard(20.0, 100, stamps_ns=[stamp + 10**12 for stamp in frames.stamps_ns])
    assert cameras.pairing(images, elsewhere, PairingSettings()).level == Level.NOT_CHECKED
    assert cameras.pairing(images, Heard("not there"), PairingSettings()).level == Level.NOT_CHECKED


def test_intrinsics_of_the_tof_camera(flight: Flight) -> None:
    camera = flight.calibration.tof
    assert is_level(cameras.tof_intrinsics(camera, camera), Level.PASS)
    assert is_level(cameras.tof_intrinsics(camera, replace(camera, fx=1.1 * camera.fx)), Level.WARN)
    assert is_level(cameras.tof_intrinsics(camera, replace(camera, width=camera.width + 1)), Level.FAIL)
    assert is_level(cameras.tof_intrinsics(camera, None), Level.NOT_CHECKED)


def test_autopilot() -> None:
    def turns(rate_hz: float, **values: object) -> HeardAutopilot:
        return replace(HeardAutopilot("", heard(rate_hz).stamps_ns, True, 1e6), **values)

    assert is_level(autopilot.attitude(turns(50.0)), Level.PASS)
    assert is_level(autopilot.attitude(turns(10.0)), Level.WARN)
    assert is_level(autopilot.attitude(turns(1.0)), Level.FAIL)
    assert is_level(autopilot.attitude(HeardAutopilot("nothing heard yet")), Level.FAIL)
    assert is_level(autopilot.timesync(turns(50.0)), Level.PASS)
    assert is_level(autopilot.timesync(turns(50.0, uncertainty_ns=2e7)), Level.WARN)
    assert is_level(autopilot.timesync(turns(50.0, is_synchronised=False)), Level.WARN)
