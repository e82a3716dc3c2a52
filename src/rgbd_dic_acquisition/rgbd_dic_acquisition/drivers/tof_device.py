"""What a ToF camera offers, whichever library reads it, and the choice between the two."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from ..errors import DeviceError
from .tof_components import Component
from .tof_features import Features
from .tof_settings import TofSettings

# Source -> its module and class here, and the packages that they need.
LIBRARIES = {
    "gentl": (".gentl_tof", "GentlTof", "harvesters and genicam"),
    "pylon": (".pylon_tof", "PylonTof", "pypylon"),
}


@dataclass(frozen=True)
class Grab:
    """One buffer that the device has filled, or has failed to fill.

    Attributes:
        components: what it holds; their data are copies.
        device_ns: time of the frame on the device's clock [ns]; None if it has none.
        number: the device's count of frames, to see which are missing; None if it does not count.
        failure: why it cannot be used; empty if it can.
    """

    components: tuple[Component, ...] = ()
    device_ns: int | None = None
    number: int | None = None
    failure: str = ""


class TofDevice(Protocol):
    """An open device.

    Attributes:
        name: model and serial number.
        features: to set it up before `start`.
    """

    name: str
    features: Features

    def start(self) -> None:
        """Begin to stream.

        Raises:
            DeviceError: it does not.
        """

    def grab(self, timeout_s: float) -> Grab | None:
        """The next buffer, or None if none came in time.

        Raises:
            DeviceError: the device is gone.
        """

    def close(self) -> None:
        """Let go of the device; may be called at any time, and more than once."""


def device_class(library: str) -> Callable[[TofSettings], TofDevice]:
    """What opens a device through a library of LIBRARIES.

    Raises:
        DeviceError: the library is not installed; with the command that installs it.
    """
    module, name, packages = LIBRARIES[library]
    try:
        return getattr(importlib.import_module(module, __package__), name)
    except ImportError as error:
        raise DeviceError(
            f"source '{library}' needs the Python packages {packages}, which are not there ({error}): make setup-tof"
        ) from error


def choose(settings: TofSettings, found: list[tuple[str, ...]], where: str) -> int:
    """Which of the devices found is the one that the settings name.

    Args:
        found: for each device what it may be called by: model, serial number, user-defined name, address.
        where: what was searched.

    Raises:
        DeviceError: none of them, or more than one.
    """
    fitting = [index for index, names in enumerate(found) if not settings.device or settings.device in names]
    listed = "; ".join(", ".join(filter(None, names)) for names in found) or "none"
    if not fitting:
        wanted = f"device '{settings.device}'" if settings.device else "device"
        raise DeviceError(f"no {wanted} is found {where} (found: {listed}): check power, cable and IP addresses")
    if len(fitting) > 1:
        raise DeviceError(f"more than one device is found {where} ({listed}): name one by its serial number")
    return fitting[0]
