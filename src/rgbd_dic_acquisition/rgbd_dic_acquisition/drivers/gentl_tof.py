"""A ToF camera through a GenTL producer, read by harvesters."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from genicam import genapi, gentl
from harvesters.core import Callback, Harvester, ImageAcquirer, ParameterKey, ParameterSet

from ..errors import DeviceError
from .tof_components import COMPONENT_IDS, PIXEL_FORMATS, Component
from .tof_device import Grab, choose
from .tof_features import Features
from .tof_settings import TofSettings

ERRORS = (gentl.GenericException, genapi.GenericException)
PATHS = "GENICAM_GENTL64_PATH"
BUFFERS = 16
CLOSING_TURNS = 5
# What reading a buffer raises beside ERRORS, such as the width of a part that is no image.
UNREADABLE = (RuntimeError,)


class GentlTof:
    """The device of a GenTL producer that the settings name; see TofDevice."""

    def __init__(self, settings: TofSettings) -> None:
        self._failed = _Failed()
        self._acquirer: ImageAcquirer | None = None
        self._harvester = Harvester()
        try:
            for producer in producers(settings):
                self._harvester.add_file(str(producer))
            self._harvester.update()
            self._open(settings)
        except ERRORS as error:
            self.close()
            raise DeviceError(f"the device cannot be opened through GenTL: {error}") from error
        except BaseException:
            self.close()
            raise

    def _open(self, settings: TofSettings) -> None:
        devices = self._harvester.device_info_list
        files = ", ".join(self._harvester.files)
        index = choose(settings, [_names(info) for info in devices], f"by the GenTL producers {files}")
        self.name = " ".join(filter(None, _names(devices[index])[:2]))
        config = ParameterSet(
            {ParameterKey.ENABLE_AUTO_CHUNK_DATA_UPDATE: False, ParameterKey.NUM_BUFFERS_FOR_FETCH_CALL: BUFFERS}
        )
        on_interrupt = signal.getsignal(signal.SIGINT)
        self._acquirer = self._harvester.create(index, config=config)
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, on_interrupt)  # harvesters takes it for itself
        self._acquirer.add_callback(ImageAcquirer.Events.INCOMPLETE_BUFFER, self._failed)
        nodes = self._acquirer.remote_device.node_map
        self.features = Features(nodes.get_node, genapi, ERRORS, str.lower)

    def start(self) -> None:
        try:
            self._acquirer.start()
        except ERRORS as error:
            raise DeviceError(f"{self.name} does not start to stream: {error}") from error

    def grab(self, timeout_s: float) -> Grab | None:
        timeout_s = max(timeout_s, 1e-3)  # harvesters waits for ever for 0
        self._failed.reset()
        try:
            self._wait_at_once(round(1e3 * timeout_s))
            buffer = self._acquirer.try_fetch(timeout=timeout_s, is_raw=True)
            if buffer is None:
                return Grab(failure=self._failed.reason) if self._failed.reason else None
            try:
                number = _optional(buffer, "frame_id")
                return Grab(tuple(_components(buffer)), self._device_ns(buffer), number)
            except UNREADABLE as error:
                return Grab(number=number, failure=f"the buffer cannot be read: {error}")
            finally:
                buffer.parent.queue_buffer(buffer)
        except ERRORS as error:
            raise DeviceError(f"{self.name} does not deliver any more: {error}") from error

    def _device_ns(self, buffer: Any) -> int | None:
        device_ns = _optional(buffer, "timestamp_ns")
        if device_ns is None:
            ticks, per_second = _optional(buffer, "timestamp"), _optional(self._acquirer.device, "timestamp_frequency")
            device_ns = ticks * 1_000_000_000 // per_second if ticks and per_second else None
        return device_ns or None

    def _wait_at_once(self, timeout_ms: int) -> None:
        """Have harvesters wait in one call, not in a thousand a second."""
        if self._acquirer.timeout_period_on_update_event_data_call != timeout_ms:
            self._acquirer.timeout_period_on_update_event_data_call = timeout_ms

    def close(self) -> None:
        if self._acquirer is not None:
            self._release(self._acquirer)
            self._acquirer = None
        with contextlib.suppress(*ERRORS):
            self._harvester.reset()

    @staticmethod
    def _release(acquirer: ImageAcquirer) -> None:
        """Give back all handles, so that the device can be opened again, even if it answers no more.

        harvesters gives up at the first call that fails, and goes on behind it when it is asked again.
        """
        for stream in acquirer.data_streams:
            with contextlib.suppress(*ERRORS):
                stream.stop_acquisition(gentl.ACQ_STOP_FLAGS_LIST.ACQ_STOP_FLAGS_KILL)
        for _ in range(CLOSING_TURNS):
            with contextlib.suppress(*ERRORS):
                acquirer.destroy()
                return


def producers(settings: TofSettings) -> list[Path]:
    """The .cti files of the settings or of the environment.

    Raises:
        DeviceError: there are none.
    """
    if settings.producer:
        path = Path(settings.producer).expanduser()
        if not path.is_file():
            raise DeviceError(f"producer = {path} is no file: give the path of the GenTL producer (.cti)")
        return [path]
    folders = [Path(folder) for folder in os.environ.get(PATHS, "").split(os.pathsep) if folder]
    found = sorted(path for folder in folders for path in folder.glob("*.cti"))
    if not found:
        raise DeviceError(
            f"no GenTL producer: {PATHS} = '{os.environ.get(PATHS, '')}' names no folder with a .cti file. Install "
            "the maker's producer (for the Blaze: pylon and its supplementary package for blaze), or give its path "
            "as parameter producer"
        )
    return found


class _Failed(Callback):
    """Hears of buffers that harvesters throws away."""

    def __init__(self) -> None:
        self.reason = ""

    def reset(self) -> None:
        self.reason = ""

    def emit(self, context: object = None) -> None:
        self.reason = "the buffer is incomplete"


def _names(info: Any) -> tuple[str, ...]:
    known = info.property_dict
    return tuple(known.get(key) or "" for key in ("model", "serial_number", "user_defined_name", "id_"))


def _components(buffer: Any) -> Iterator[Component]:
    """The components of a GenDC container, or the parts of a multi-part buffer.

    A part tells its type by its pixel format: its data type cannot be read through genicam 1.6.
    """
    memory = memoryview(buffer.raw_buffer)
    described = [
        (COMPONENT_IDS[component.component_id_value], part)
        for component in buffer.components
        if component.component_id_value in COMPONENT_IDS
        for part in component.parts
    ]
    described += [(_kind(part), part) for part in buffer.parts if _kind(part)]
    for kind, part in described:
        data = bytes(memory[part.data_offset : part.data_offset + part.data_size])
        yield Component(kind, part.data_format, part.width, part.height, data, _optional(part, "x_padding") or 0)


def _kind(part: Any) -> str:
    known = PIXEL_FORMATS.get(part.data_format)
    return known.kind if known else ""


def _optional(module: Any, attribute: str) -> int | None:
    try:
        return getattr(module, attribute)
    except ERRORS:
        return None
