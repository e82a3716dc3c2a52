"""A GenICam camera that Aravis has connected to, set and started."""

from __future__ import annotations

import contextlib
import math
import os
import threading
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..calibration import Camera
from ..clock import NS
from ..errors import DeviceError, SettingsError
from ..settings import Settings, setting
from .aravis_library import aravis, device_id, refused
from .datagram_guard import accept_only_from, let_wait

LATCH_EVERY_S = 1.0
# Before the first image: so many latches, and more until one took no longer than this, but not for longer than that.
# The narrowest counts, so those that are held up on a busy computer do no harm.
FIRST_LATCHES, NARROW_NS, FIRST_LATCHES_S = 8, 1_000_000, 0.5
CLOSE_S = 1.0
RECEIVING = ("arv_gv_stream", "arv_uv_stream")  # names of Aravis' threads
RECEIVING_NICE = -10
# Commands and values of a clock that can be asked for its time, by SFNC 2 and by GigE Vision 1.
LATCHES = (("TimestampLatch", "TimestampLatchValue"), ("GevTimestampControlLatch", "GevTimestampValue"))
TICKS_A_SECOND = "GevTimestampTickFrequency"
TEMPERATURE = "DeviceTemperature"


@dataclass(frozen=True)
class AravisSettings(Settings):
    """The camera and how it takes images; their size is that of calibration.yaml."""

    transport: str = setting("usb3", doc="cable that it is on", choices=("usb3", "gige"))
    serial: str = setting("", doc="serial number of the camera; empty: the only one that is found")
    address: str = setting("", doc="IP address of a GigE camera, which is then the only one asked; empty: by serial")
    offset_x_px: int = setting(0, doc="first column of the region on the sensor", unit="px", low=0, high=100000)
    offset_y_px: int = setting(0, doc="first row of the region on the sensor", unit="px", low=0, high=100000)
    exposure_s: float = setting(0.002, doc="exposure time", unit="s", low=1e-6, high=10.0)
    gain: float = setting(10.0, doc="amplification in the camera's own unit (FLIR: dB)", low=0.0, high=100.0)
    frame_rate_hz: float = setting(60.0, doc="images a second when it runs free", unit="Hz", low=0.01, high=10000.0)
    trigger_source: str = setting("", doc="input that starts each exposure, such as Line0; empty: it runs free")
    stamps: str = setting(
        "start", doc="which end of the exposure the camera's time stamps belong to", choices=("start", "end")
    )
    delivery_s: float = setting(
        0.0, doc="shortest time from the stamp to the arrival, where the clock has no latch", unit="s", low=0, high=1.0
    )
    buffers: int = setting(20, doc="images that wait here while the node is busy", unit="frames", low=3, high=1000)
    packet_bytes: int = setting(
        0, doc="GigE packet with headers; 0: as large as the network passes", unit="bytes", low=0, high=65535
    )
    socket_buffer_bytes: int = setting(
        4194304, doc="GigE receive buffer; the system limits it: net.core.rmem_max", unit="bytes", low=0, high=2**31 - 1
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.address and self.transport != "gige":
            raise SettingsError(f"AravisSettings.address = '{self.address}': needs transport: gige")
        if not self.trigger_source and self.exposure_s * self.frame_rate_hz > 1:
            raise SettingsError(
                f"AravisSettings.exposure_s = {self.exposure_s:g} s is longer than the time between images at "
                f"frame_rate_hz = {self.frame_rate_hz:g}: shorten the exposure or lower the rate"
            )


class Connection:
    """A camera that was found, set and started.

    Attributes:
        latches: (device time, host time before, after) [ns], to be taken out by the reader.
        readings: values that change, in words.
    """

    def __init__(self, settings: AravisSettings, camera: Camera) -> None:
        Arv = aravis()
        self._gone = threading.Event()
        self.latches: deque[tuple[int, int, int]] = deque(maxlen=60)
        self.readings: dict[str, str] = {}
        self._closed = threading.Event()
        self._asked_ns = 0  # when the camera was first asked for its time without an answer yet
        self._housekeeper: threading.Thread | None = None
        name = device_id(settings.transport, settings.serial, settings.address)
        with refused(f"camera {name}"):
            self._camera = Arv.Camera.new(name)
            self._device = self._camera.get_device()
            if self.lost:
                raise DeviceError(f"camera {name} is controlled by another program: end that one")
            model = f"{self._camera.get_vendor_name()} {self._camera.get_model_name()}"
            self.told = {"camera": f"{model}, serial number {self._camera.get_device_serial_number()}"}
            self._configure(settings, camera)
            self._compare_clocks()
            self.stream = self._start(settings)
        self._housekeeper = threading.Thread(target=self._keep_house, name="camera housekeeping", daemon=True)
        self._housekeeper.start()

    @property
    def lost(self) -> bool:
        """Whether the camera does not answer any more, or is not ours."""
        return self._gone.is_set() or (self._camera.is_gv_device() and not self._device.is_controller())

    def close(self) -> None:
        """Stop and let go. A camera that does not answer is left to time out by itself, which takes many seconds."""
        self._closed.set()
        leaving = threading.Thread(target=self._let_go, name="closing the camera", daemon=True)
        leaving.start()
        leaving.join(CLOSE_S)

    def _let_go(self) -> None:
        if self._housekeeper is not None:
            self._housekeeper.join()
        if not self.lost:
            with refused("stopping", ignore=True):
                self._camera.stop_acquisition()
        self.stream = self._device = self._camera = None

    def _configure(self, settings: AravisSettings, camera: Camera) -> None:
        Arv, device = aravis(), self._camera
        device.set_range_check_policy(Arv.RangeCheckPolicy.ENABLE)
        device.set_acquisition_mode(Arv.AcquisitionMode.CONTINUOUS)
        device.set_pixel_format(Arv.PIXEL_FORMAT_MONO_8)
        region = (settings.offset_x_px, settings.offset_y_px, camera.width, camera.height)
        device.set_region(*region)
        _same("region of x, y, width, height", region, tuple(device.get_region()))
        if device.is_exposure_auto_available():
            device.set_exposure_time_auto(Arv.Auto.OFF)
        device.set_exposure_time(settings.exposure_s * 1e6)
        exposure_s = device.get_exposure_time() * 1e-6
        _close("exposure_s", settings.exposure_s, exposure_s)
        self.exposure_ns = round(exposure_s * NS)
        if device.is_gain_auto_available():
            device.set_gain_auto(Arv.Auto.OFF)
        device.set_gain(settings.gain)
        _close("gain", settings.gain, device.get_gain())
        if settings.trigger_source:
            device.set_trigger(settings.trigger_source)
        else:
            device.clear_triggers()
            device.set_frame_rate(settings.frame_rate_hz)
            _close("frame_rate_hz", settings.frame_rate_hz, device.get_frame_rate())
        if device.is_gv_device():
            if settings.packet_bytes:
                device.gv_set_packet_size(settings.packet_bytes)
            else:
                device.gv_auto_packet_size()

    def _start(self, settings: AravisSettings) -> Any:
        Arv = aravis()
        if self._camera.is_gv_device():
            self._camera.gv_set_stream_options(Arv.GvStreamOption.PACKET_SOCKET_DISABLED)
        stream = self._camera.create_stream(None, None)
        if self._camera.is_gv_device():
            # Aravis believes what it is sent; a forged frame makes it write outside its buffers.
            accept_only_from(self._device.get_device_address().get_address().to_string(), stream.get_port())
            if settings.socket_buffer_bytes:
                stream.set_property("socket-buffer", Arv.GvStreamSocketBuffer.FIXED)
                stream.set_property("socket-buffer-size", settings.socket_buffer_bytes)
                let_wait(stream.get_port(), settings.socket_buffer_bytes)  # Aravis does so with the first packet
        payload = self._camera.get_payload()
        for _ in range(settings.buffers):
            stream.push_buffer(Arv.Buffer.new_allocate(payload))
        _prefer_receiving()
        self._camera.start_acquisition()
        return stream

    def _keep_house(self) -> None:
        """Once a second what needs an answer of the camera, for which one may wait: its time, its temperature."""
        camera = self._camera
        try:
            with refused("camera"):
                warm = camera.is_feature_available(TEMPERATURE)
                while not self._closed.is_set():
                    if self._clock:
                        self._latch(*self._clock)
                    if warm:
                        self.readings["temperature [degrees C]"] = f"{camera.get_float(TEMPERATURE):.1f}"
                    camera.get_integer("Width")  # whether it is still there, if it has neither
                    self._closed.wait(LATCH_EVERY_S)
        except DeviceError:
            self._gone.set()
        except SettingsError as error:
            self.readings["problem"] = str(error)

    def _compare_clocks(self) -> None:
        try:
            with refused("the camera's clock"):
                self._clock = self._find_clock()
                end = time.monotonic() + FIRST_LATCHES_S
                while self._clock and time.monotonic() < end and not self._is_compared():
                    self._latch(*self._clock)
        except SettingsError as error:  # images can do without
            self.readings["problem"], self._clock = str(error), None

    def _is_compared(self) -> bool:
        narrowest_ns = min((after_ns - before_ns for _, before_ns, after_ns in self.latches), default=NS)
        return len(self.latches) >= FIRST_LATCHES and narrowest_ns <= NARROW_NS

    def _find_clock(self) -> tuple[str, str, int] | None:
        """Command and value of the latch, if there is one, and how many units of it are a second."""
        camera = self._camera
        for command, value in LATCHES:
            if camera.is_feature_available(command):
                ticks = (command, value) == LATCHES[1] and camera.is_feature_available(TICKS_A_SECOND)
                return command, value, camera.get_integer(TICKS_A_SECOND) if ticks else NS
        return None

    def _latch(self, command: str, value: str, second: int) -> None:
        """What has changed may be the late answer to a question before, so time counts from the first that has none."""
        before_ns = self._asked_ns = self._asked_ns or time.time_ns()
        old = self._camera.get_integer(value)
        self._camera.execute_command(command)
        for _ in range(20):
            latched, after_ns = self._camera.get_integer(value), time.time_ns()
            if latched != old:
                self.latches.append((latched * NS // second, before_ns, after_ns))
                self._asked_ns = 0
                return


def _prefer_receiving() -> None:
    """Let the thread that receives go before the rest of a busy computer, where this process may say so."""
    for thread in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # it has ended, or the right is missing
            if (thread / "comm").read_text().strip() in RECEIVING:
                os.setpriority(os.PRIO_PROCESS, int(thread.name), RECEIVING_NICE)


def _same(name: str, wanted: tuple[int, ...], got: tuple[int, ...]) -> None:
    if wanted != got:
        raise SettingsError(
            f"the camera takes {got} for the {name}, not {wanted}: set it, or calibration.yaml, to that"
        )


def _close(name: str, wanted: float, got: float) -> None:
    if not math.isclose(wanted, got, rel_tol=0.01, abs_tol=0.05 if name == "gain" else 0):
        raise SettingsError(f"the camera takes {got:g} for {name} = {wanted:g}: set a value that it can have")
