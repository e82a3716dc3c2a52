"""The whole checklist, in the order in which it is read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from rgbd_dic_acquisition.calibration import Calibration
from rgbd_dic_acquisition.drivers.aravis_camera import AravisCamera
from rgbd_dic_acquisition.drivers.aravis_connection import AravisSettings
from rgbd_dic_acquisition.drivers.tof_camera import TofCamera
from rgbd_dic_acquisition.drivers.tof_settings import TofSettings
from rgbd_dic_acquisition.payload import Payload

from ..core.regions import Regions
from ..core.settings import ProcessingSettings
from ..live_sensors import AUTOPILOT, GIVES
from . import autopilot, cameras, computer, installed, panel
from .finding import Finding, Level, not_checked
from .listening import Heard, listen

NODES = 9  # of a flight with one method, page and autopilot
NODE_NAMES = {*GIVES, "dic_node", "pairing_node", "plane_node", "compensation_node", "crack_opening_node"}
SUBSET_BYTES = 120  # of the fields that are recorded for each subset and image
CAMERA, TOF = "camera", "ToF camera"


@dataclass(frozen=True)
class Plan:
    """What is to be flown, as far as it is known. noise: of a pixel [grey levels]."""

    payload: Payload | None
    calibration: Path | None
    regions: Path | None
    settings: ProcessingSettings
    out: Path
    minutes: float
    seconds: float
    domain: int
    noise: float

    @property
    def camera(self) -> AravisSettings:
        return self.payload.settings("camera_node", "aravis", AravisSettings) if self.payload else AravisSettings()

    @property
    def tof(self) -> TofSettings:
        return self.payload.settings("tof_node", "tof", TofSettings) if self.payload else TofSettings()


def checklist(plan: Plan) -> Iterator[Finding]:
    """Every check, as it is done."""
    calibration, regions, subsets = None, None, 0
    if plan.calibration is None:
        yield not_checked("calibration", "no --calibration")
    else:
        finding, calibration = installed.calibration_file(plan.calibration)
        yield finding
    if plan.regions is None or calibration is None:
        yield not_checked("regions", "no --regions" if plan.regions is None else "no calibration")
    else:
        finding, regions, subsets = panel.regions_file(plan.regions, calibration, plan.settings)
        yield finding
    if plan.payload is None:
        yield not_checked("sensors", "no --payload")
    else:
        yield from _sensors(plan, plan.payload, calibration, regions)
    yield from _computer(plan, calibration, subsets)


def _sensors(
    plan: Plan, payload: Payload, calibration: Calibration | None, regions: Regions | None
) -> Iterator[Finding]:
    tof_source = payload.source("tof_node")
    drivers = [installed.camera_driver(payload.source("camera_node")), installed.tof_driver(tof_source)]
    link = None
    if AUTOPILOT in payload.parameters:
        drivers.append(installed.autopilot_driver())
        link = _link(payload) if drivers[-1].level == Level.PASS else None
    yield from drivers
    make_camera = make_tof = None
    if drivers[0].level == Level.PASS and calibration is not None:
        make_camera = partial(AravisCamera, plan.camera, calibration.camera, "")
    if drivers[1].level == Level.PASS:
        make_tof = partial(TofCamera, tof_source, plan.tof)
    camera, tof, heard = listen(make_camera, make_tof, link, plan.seconds)
    size = "" if calibration is None else f"{calibration.camera.width} x {calibration.camera.height} px, "
    exposure = f"{size}{plan.camera.exposure_s * 1e3:g} ms, gain {plan.camera.gain:g}"
    yield from _one_camera(CAMERA, camera, exposure, 0.0 if plan.camera.trigger_source else plan.camera.frame_rate_hz)
    yield from _one_camera(TOF, tof, f"{plan.tof.depth_min_m:g} to {plan.tof.depth_max_m:g} m", plan.tof.frame_rate_hz)
    yield from _views(plan, calibration, regions, camera, tof)
    if heard is None:
        yield not_checked("attitude", "no MAVLink" if AUTOPILOT in payload.parameters else f"no {AUTOPILOT} is planned")
    else:
        yield autopilot.attitude(heard)
        yield autopilot.timesync(heard)


def _link(payload: Payload) -> Any:
    from rgbd_dic_acquisition.drivers.mavlink import MavlinkSettings  # needs pymavlink

    return payload.settings(AUTOPILOT, "link", MavlinkSettings)


def _one_camera(name: str, heard: Heard | None, settings: str, rate_hz: float) -> Iterator[Finding]:
    if heard is None:
        yield not_checked(name, "no driver, no calibration, or simulated")
        return
    yield cameras.answers(name, heard, settings)
    if not heard.problem:
        yield cameras.frame_rate(f"{name}: rate", heard, rate_hz)
        yield cameras.lost_frames(f"{name}: frames", heard)
        yield cameras.camera_clock(f"{name}: clock", heard)


def _views(
    plan: Plan,
    calibration: Calibration | None,
    regions: Regions | None,
    camera: Heard | None,
    tof: Heard | None,
) -> Iterator[Finding]:
    """What the cameras see, and whether they see it at the same time."""
    plane, image = None, camera.frame.image if camera and camera.frame else None
    if tof and tof.frame and calibration and calibration.tof:
        yield cameras.tof_intrinsics(calibration.tof, tof.camera)
    if tof and tof.frame and calibration and calibration.tof and regions:
        findings, plane = panel.depth(tof.frame.depth_m, calibration, regions, plan.settings, plan.tof)
        yield from findings
    else:
        yield from panel.not_looked("it needs a ToF frame, the calibration of both cameras and --regions")
    if image is None:
        yield not_checked("light", "no image")
    else:
        yield cameras.brightness(panel.panel_pixels(image, regions))
    if image is None or regions is None:
        yield not_checked("focus and texture", "no image" if image is None else "no regions")
    else:
        footprint_m = float("nan") if plane is None else panel.footprint_m(plane, calibration)
        yield panel.pattern(image, calibration, regions, plan.settings, plan.noise, footprint_m)
    if camera and tof:
        yield cameras.pairing(camera, tof, plan.settings.pairing)


def _computer(plan: Plan, calibration: Calibration | None, subsets: int) -> Iterator[Finding]:
    if plan.camera.transport == "gige":
        yield computer.socket_buffers(plan.camera.socket_buffer_bytes)
    else:
        yield computer.usb_memory(plan.camera.buffers * _image_bytes(calibration))
        yield computer.usb_speed()
    rate = _bytes_per_s(plan, calibration, subsets)
    checks: tuple[Callable[[], Finding], ...] = (
        lambda: computer.shared_memory(NODES),
        lambda: computer.free_disk(plan.out, rate, plan.minutes),
        lambda: computer.disk_speed(plan.out, rate),
        computer.host_clock,
        computer.governor,
        computer.temperature,
        computer.load,
        lambda: computer.ros_domain(plan.domain, NODE_NAMES),
    )
    for check in checks:
        yield check()


def _image_bytes(calibration: Calibration | None) -> int:
    return 1440 * 1080 if calibration is None else calibration.camera.width * calibration.camera.height


def _bytes_per_s(plan: Plan, calibration: Calibration | None, subsets: int) -> float:
    """What a flight records: images, depth with intensity and confidence, and the fields of all subsets."""
    sensor = None if calibration is None else calibration.tof
    depth_bytes = 6 * (640 * 480 if sensor is None else sensor.width * sensor.height)
    per_image = _image_bytes(calibration) + SUBSET_BYTES * (subsets or 1500)
    return plan.camera.frame_rate_hz * per_image + (plan.tof.frame_rate_hz or 20.0) * depth_bytes
