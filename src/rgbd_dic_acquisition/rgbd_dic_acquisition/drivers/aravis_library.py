"""Aravis where it is installed: loading it, finding a camera, and its errors as ours."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from ..errors import DeviceError, SettingsError

INSTALL = (
    "On Debian or Ubuntu: sudo apt install gir1.2-aravis-0.8 libgirepository1.0-dev libcairo2-dev pkg-config gcc; "
    "then make setup-camera, or python3-gi where the system's own Python runs the nodes"
)
GVCP_PORT = 3956
DISCOVERY = bytes.fromhex("4201000200000001")  # of GigE Vision's control protocol: key, flags, command, length, number
ANSWER_S = 0.3
INTERFACES = {"usb3": "USB3Vision", "gige": "GigEVision"}


@cache
def aravis() -> Any:
    """The Aravis library through GObject introspection.

    Raises:
        DeviceError: it, or PyGObject, is not installed; with what to do.
    """
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis
    except (ImportError, ValueError) as error:
        raise DeviceError(f"source aravis needs Aravis 0.8, which cannot be loaded ({error}). {INSTALL}") from error
    return Aravis


@contextmanager
def refused(what: str, ignore: bool = False) -> Iterator[None]:
    """Turns an error of Aravis into a SettingsError if a value is at fault, else a DeviceError; or into nothing."""
    from gi.repository import GLib

    try:
        yield
    except GLib.Error as error:
        if ignore:
            return
        kind = SettingsError if "arv-gc-error" in error.domain else DeviceError
        raise kind(f"{what}: {error.message}") from error


def _ask(address: str) -> None:
    """Whether a GigE camera answers there: sooner than Aravis, which waits for seconds when none does."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
            asking.settimeout(ANSWER_S)
            asking.connect((address, GVCP_PORT))
            asking.send(DISCOVERY)
            asking.recv(1024)
    except OSError as error:
        raise DeviceError(
            f"no camera answers at {address} ({error}): check its cable, its power and both addresses"
        ) from error


def device_id(transport: str, serial: str, address: str) -> str:
    """What Aravis opens the camera by. With an address nobody else on the network is asked.

    Raises:
        DeviceError: no such camera is found, it does not answer, or there are several and none was named.
    """
    Arv = aravis()
    for name, interface in INTERFACES.items():
        (Arv.enable_interface if name == transport else Arv.disable_interface)(interface)
    if address:
        _ask(address)
        return address
    Arv.update_device_list()
    found = {
        Arv.get_device_serial_nbr(index): Arv.get_device_id(index)
        for index in range(Arv.get_n_devices())
        if Arv.get_device_protocol(index) == INTERFACES[transport]
    }
    if serial in found:
        return found[serial]
    if not serial and len(found) == 1:
        return next(iter(found.values()))
    wanted = f"camera of serial number {serial}" if serial else "single camera"
    raise DeviceError(
        f"no {wanted} on {transport}; found: {', '.join(sorted(found)) or 'none'}. Check its cable, its power and "
        "the right to use it, or give serial"
    )
