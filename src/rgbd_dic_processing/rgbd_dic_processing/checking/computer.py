"""Checks of the computer: memory of the drivers, disk, clock, heat. They read /proc and /sys under `root`."""

from __future__ import annotations

import ctypes
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

from .finding import Finding, graded, not_checked, passed

ROOT = Path("/")
SEGMENT_BYTES = 32 << 20  # shared memory of each node (config/fastdds.xml)
PROBE_BYTES = 64 << 20
CAMERA_MAKERS = {"1e10": "FLIR", "2676": "Basler"}
USB3_MBIT = 5000
UNSYNCHRONISED = 0x40  # STA_UNSYNC of adjtimex(2)


def socket_buffers(wanted_bytes: int, root: Path = ROOT) -> Finding:
    """Whether a GigE camera's socket gets the buffer that it is set to."""
    name, limit = "socket buffers", _number(root / "proc/sys/net/core/rmem_max")
    if limit is None:
        return not_checked(name, "net.core.rmem_max cannot be read")
    text = f"net.core.rmem_max is {limit / 1e6:.1f} MB, the camera asks for {wanted_bytes / 1e6:.1f} MB"
    return graded(name, text, f"sudo sysctl -w net.core.rmem_max={max(wanted_bytes, 33554432)}", limit >= wanted_bytes)


def usb_memory(needed_bytes: int, root: Path = ROOT) -> Finding:
    """Whether the kernel lends USB enough memory for all buffers of the camera; 0 is without limit."""
    name, path = "usbfs memory", "sys/module/usbcore/parameters/usbfs_memory_mb"
    limit = _number(root / path)
    if limit is None:
        return not_checked(name, f"/{path} cannot be read")
    text = f"{limit} MB, the camera's buffers need {needed_bytes / 1e6:.0f} MB"
    good = limit == 0 or (limit << 20) >= needed_bytes
    return graded(name, text, f"echo {max(200, 2 * needed_bytes >> 20)} | sudo tee /{path}", good)


def usb_speed(root: Path = ROOT) -> Finding:
    """Whether a camera of a known maker is on a USB 3 port."""
    name = "USB port"
    for device in sorted((root / "sys/bus/usb/devices").glob("*/idVendor")):
        maker, speed = CAMERA_MAKERS.get(device.read_text().strip()), _number(device.with_name("speed"))
        if maker and speed is not None:
            text = f"{maker} camera at {speed} Mbit/s"
            return graded(name, text, "use a USB 3 port of its own, and a cable for USB 3", speed >= USB3_MBIT)
    return not_checked(name, f"no camera of {' or '.join(CAMERA_MAKERS.values())} is on USB")


def shared_memory(nodes: int, folder: Path = Path("/dev/shm")) -> Finding:
    """Whether the middleware has room for the images of all nodes."""
    name, needed = "shared memory", nodes * SEGMENT_BYTES
    try:
        free = shutil.disk_usage(folder).free
    except OSError as error:
        return not_checked(name, f"{folder}: {error.strerror}")
    text = f"{free / 1e6:.0f} MB free in {folder}, {nodes} nodes take {needed / 1e6:.0f} MB"
    remedy = (
        f"remove what killed programs left there ({folder}/fastrtps_*) while no node runs, or enlarge it: "
        f"sudo mount -o remount,size=1G {folder} (containers: --shm-size=1g)"
    )
    return graded(name, text, remedy, free >= needed, free >= 4 * SEGMENT_BYTES)


def _adjtimex() -> tuple[int, int]:
    """Status bits and largest error [us] of the kernel's clock."""

    class Timex(ctypes.Structure):
        _fields_ = (
            ("modes", ctypes.c_uint),
            *((field, ctypes.c_long) for field in ("offset", "freq", "maxerror", "esterror")),
            ("status", ctypes.c_int),
            ("rest", ctypes.c_byte * 256),
        )

    answer = Timex()
    if ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(answer)) < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return answer.status, answer.maxerror


def host_clock(read: Callable[[], tuple[int, int]] = _adjtimex) -> Finding:
    """Whether the computer's clock is synchronised; the sensors' are, to it, in any case."""
    name = "computer's clock"
    try:
        status, error_us = read()
    except (OSError, AttributeError) as error:
        return not_checked(name, f"the kernel does not tell ({error})")
    good = not status & UNSYNCHRONISED
    text = f"synchronised, to {error_us / 1e3:.0f} ms" if good else "not synchronised"
    remedy = (
        "set it before take-off, not in flight: timedatectl set-ntp true with a network, or chrony with GPS. Pairing "
        "does not need it; comparing with other instruments does"
    )
    return graded(name, text, remedy, good, bearable=True)


def free_disk(folder: Path, bytes_per_s: float, minutes: float) -> Finding:
    """Whether the recording of the planned flight fits."""
    free, needed = shutil.disk_usage(_existing(folder)).free, bytes_per_s * 60 * minutes
    text = (
        f"{free / 1e9:.1f} GB free at {folder}, {minutes:g} minutes take {needed / 1e9:.1f} GB "
        f"({bytes_per_s / 1e6:.0f} MB/s)"
    )
    remedy = (
        f"make room, or record elsewhere with --out; at this rate there is room for {free / bytes_per_s / 60:.0f} min"
    )
    return graded("free disk", text, remedy, free >= 1.2 * needed, free >= needed)


def disk_speed(folder: Path, bytes_per_s: float) -> Finding:
    """Whether the disk takes the recording: a file is written, synchronised and removed."""
    name, probe = "speed of the disk", _existing(folder) / ".rgbd_dic_probe"
    block = os.urandom(1 << 20)
    try:
        started = time.monotonic()
        with probe.open("wb") as file:
            for _ in range(PROBE_BYTES // len(block)):
                file.write(block)
            file.flush()
            os.fsync(file.fileno())
        speed = PROBE_BYTES / (time.monotonic() - started)
    except OSError as error:
        remedy = "choose another folder with --out"
        return graded(name, f"cannot write to {probe.parent}: {error.strerror}", remedy, False)
    finally:
        probe.unlink(missing_ok=True)
    text = f"{speed / 1e6:.0f} MB/s to {probe.parent}, the recording takes {bytes_per_s / 1e6:.0f} MB/s"
    remedy = "record to a faster disk (NVMe, USB 3 SSD), not to an SD card"
    return graded(name, text, remedy, speed >= 1.5 * bytes_per_s, speed >= bytes_per_s)


def governor(root: Path = ROOT) -> Finding:
    """Whether the processor runs at full speed when it is asked to."""
    name, pattern = "processor's governor", "sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor"
    found = sorted({path.read_text().strip() for path in root.glob(pattern)})
    if not found:
        return not_checked(name, "it has none, or does not tell")
    remedy = "sudo cpupower frequency-set -g performance (Jetson: sudo nvpmodel -m 0 and sudo jetson_clocks)"
    return graded(name, ", ".join(found), remedy, found == ["performance"], bearable=True)


def temperature(root: Path = ROOT) -> Finding:
    """Whether the computer is near the heat at which it slows down."""
    name = "computer's temperature"
    found = [_number(path) for path in root.glob("sys/class/thermal/thermal_zone*/temp")]
    celsius = [value / 1000 for value in found if value is not None]
    if not celsius:
        return not_checked(name, "it does not tell")
    text, remedy = f"{max(celsius):.0f} degrees C", "cool it: shade, a fan, a pause"
    return graded(name, text, remedy, max(celsius) < 75, max(celsius) < 90)


def load() -> Finding:
    """Whether other programs leave the processor to the measurement."""
    busy, cores = os.getloadavg()[0], os.cpu_count() or 1
    text = f"load of the last minute {busy:.1f} on {cores} cores"
    return graded("other programs", text, "end what else runs (top shows it)", busy < 0.5 * cores, bearable=True)


def ros_domain(domain: int, ours: set[str]) -> Finding:
    """Whether nodes of this project, or others, run in the domain of the flight."""
    name = "ROS domain"
    try:
        import rclpy
        from rgbd_dic_acquisition.nodes.spinning import prepare_process
    except ImportError as error:
        return not_checked(name, f"no ROS here ({error})")
    prepare_process()
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("rgbd_dic_check", context=context)
    try:
        time.sleep(2.0)
        found = set(node.get_node_names()) - {"rgbd_dic_check"}
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)
    if not found:
        return passed(name, f"{domain}, nobody else is there")
    text = f"{domain}: {', '.join(sorted(found))} run there"
    return graded(name, text, "end them, or choose another --domain", False, bearable=not found & ours)


def _existing(folder: Path) -> Path:
    """The folder, or the nearest one above it that is there."""
    folder = folder.resolve()
    return next(path for path in (folder, *folder.parents) if path.is_dir())


def _number(path: Path) -> int | None:
    try:
        return int(path.read_text())
    except (OSError, ValueError):
        return None
