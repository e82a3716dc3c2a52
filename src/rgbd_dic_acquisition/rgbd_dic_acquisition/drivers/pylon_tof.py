"""A ToF camera through Basler's pylon, read by pypylon."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

from pypylon import genicam, pylon

from ..errors import DeviceError
from .tof_components import CONFIDENCE, INTENSITY, RANGE, Component
from .tof_device import Grab, choose
from .tof_features import Features
from .tof_settings import TofSettings

BUFFERS = 16
KINDS = {
    pylon.ComponentType_Intensity: INTENSITY,
    pylon.ComponentType_Range: RANGE,
    pylon.ComponentType_Confidence: CONFIDENCE,
}


class PylonTof:
    """The camera that the settings name; see TofDevice."""

    def __init__(self, settings: TofSettings) -> None:
        self._camera: pylon.InstantCamera | None = None
        try:
            factory = pylon.TlFactory.GetInstance()
            devices = factory.EnumerateDevices()
            info = devices[choose(settings, [_names(info) for info in devices], "by pylon")]
            self.name = " ".join(filter(None, _names(info)[:2]))
            self._camera = pylon.InstantCamera(factory.CreateDevice(info))
            self._camera.Open()
            self._camera.MaxNumBuffer.Value = BUFFERS
        except genicam.GenericException as error:
            self.close()
            raise DeviceError(f"the device cannot be opened through pylon: {_first_line(error)}") from error
        nodes = self._camera.GetNodeMap()
        self.features = Features(nodes.GetNode, genicam, (genicam.GenericException,), str.capitalize)
        self._ticks_a_second = self.features.get("GevTimestampTickFrequency") or 1_000_000_000

    def start(self) -> None:
        try:
            self._camera.StartGrabbing(pylon.GrabStrategy_OneByOne)
        except genicam.GenericException as error:
            raise DeviceError(f"{self.name} does not start to stream: {_first_line(error)}") from error

    def grab(self, timeout_s: float) -> Grab | None:
        try:
            if self._camera.IsCameraDeviceRemoved():
                raise DeviceError(f"{self.name} was disconnected")
            result = self._camera.RetrieveResult(max(round(1e3 * timeout_s), 0), pylon.TimeoutHandling_Return)
            if not result.IsValid():
                return None
            try:
                number = result.BlockID
                if not result.GrabSucceeded():
                    return Grab(number=number, failure=result.ErrorDescription or "the buffer failed")
                device_ns = result.TimeStamp * 1_000_000_000 // self._ticks_a_second
                return Grab(tuple(components(result.GetDataContainer())), device_ns or None, number)
            finally:
                result.Release()
        except genicam.GenericException as error:
            raise DeviceError(f"{self.name} does not deliver any more: {_first_line(error)}") from error

    def close(self) -> None:
        if self._camera is not None:
            with contextlib.suppress(genicam.GenericException):
                self._camera.Close()
            with contextlib.suppress(genicam.GenericException):
                self._camera.DestroyDevice()
        self._camera = None


def components(container: pylon.PylonDataContainer) -> Iterator[Component]:
    """The components of pylon's data container, which is released."""
    try:
        for index in range(container.DataComponentCount):
            component = container.GetDataComponentByIndex(index)
            try:
                kind = KINDS.get(component.ComponentType, "other")
                size = (component.Width, component.Height)
                data = bytes(component.GetMemoryView()) if kind != "other" else b""
                yield Component(kind, component.PixelType & 0xFFFFFFFF, *size, data, component.PaddingX)
            finally:
                component.Release()
    finally:
        container.Release()


def _names(info: Any) -> tuple[str, ...]:
    keys = ("ModelName", "SerialNumber", "UserDefinedName", "IpAddress", "FullName")
    return tuple(info.GetPropertyValue(key)[1] if info.GetPropertyAvailable(key) else "" for key in keys)


def _first_line(error: Exception) -> str:
    return (str(error).strip() or repr(error)).splitlines()[0]
