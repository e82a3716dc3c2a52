"""A GigE Vision camera that shows given images: Aravis' fake camera, which speaks the real protocol.

    python -m rgbd_dic_acquisition.simulator.gige_camera images.npy --address 127.0.0.1

Its clock runs apart from the host's as asked, and can have a latch. Needs libaravis-0.8-0; it is called through
ctypes, as its introspection data lets the hook that fills the images go after the first call.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import signal
import struct
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from ..errors import DeviceError
from .live import there_and_back

LIBRARY = "libaravis-0.8.so.0"
# Registers that Aravis' fake camera leaves free, and features that are laid over them.
LATCH, LATCHED, TEMPERATURE = 0x1000, 0x1008, 0x1010
TEMPERATURE_C = 41.5
WIDTH, HEIGHT = 0x100, 0x104  # its own registers of the region's size
FEATURES = f"""
<Category Name="Clock"><pFeature>TimestampLatch</pFeature><pFeature>TimestampLatchValue</pFeature>
<pFeature>DeviceTemperature</pFeature></Category>
<Command Name="TimestampLatch"><pValue>LatchRegister</pValue><CommandValue>1</CommandValue></Command>
<IntReg Name="LatchRegister"><Address>{LATCH}</Address><Length>4</Length><AccessMode>RW</AccessMode>
<pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
<IntReg Name="TimestampLatchValue"><Address>{LATCHED}</Address><Length>8</Length><AccessMode>RO</AccessMode>
<pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
<FloatReg Name="DeviceTemperature"><Address>{TEMPERATURE}</Address><Length>4</Length><AccessMode>RO</AccessMode>
<pPort>Device</pPort><Endianess>BigEndian</Endianess></FloatReg>
"""
_FILL = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32)
_TAKES = {  # what the functions take and give: p a pointer, u 32 bits, U 64 bits, i an int, n nothing
    "arv_fake_camera_new": ("p", "p"),
    "arv_fake_camera_get_genicam_xml": ("pp", "p"),
    "arv_fake_camera_read_register": ("pup", "i"),
    "arv_fake_camera_write_memory": ("puup", "i"),
    "arv_fake_camera_set_fill_pattern": ("ppp", "n"),
    "arv_gv_fake_camera_new_full": ("ppp", "p"),
    "arv_gv_fake_camera_get_fake_camera": ("p", "p"),
    "arv_gv_fake_camera_is_running": ("p", "i"),
    "arv_buffer_get_data": ("pp", "p"),
    "arv_buffer_get_timestamp": ("p", "U"),
    "arv_buffer_set_timestamp": ("pU", "n"),
    "arv_buffer_get_frame_id": ("p", "U"),
}
_KINDS = {"p": ctypes.c_void_p, "u": ctypes.c_uint32, "U": ctypes.c_uint64, "i": ctypes.c_int, "n": None}


class GigeCamera:
    """Runs from when it is made until the process ends.

    Args:
        images: (N, rows, cols) uint8, shown there and back by the host's clock; the camera must be set to this size.
        rate_hz: images a second of that; the camera sends at the rate that it is set to.
        has_latch: whether its clock can be asked for its time, and it has a temperature.
        clock: (device time at host time 0 [ns], rate of the device's clock over the host's, - 1).
        log: a file that gets a line `frame number,host time,device time,index` for each frame, before it is sent.
    """

    def __init__(
        self,
        images: np.ndarray,
        rate_hz: float,
        address: str = "127.0.0.1",
        serial: str = "SIMULATED",
        clock: tuple[int, float] = (0, 0.0),
        has_latch: bool = False,
        log: Path | None = None,
    ) -> None:
        self._images, self._period_ns, self._clock = images, round(1e9 / rate_hz), clock
        self._log = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND) if log else None
        self._library = _library()
        with tempfile.NamedTemporaryFile("w", suffix=".xml") as features:
            if has_latch:
                features.write(self._with_features())
                features.flush()
            name = os.fsencode(features.name) if has_latch else None
            self._server = self._library.arv_gv_fake_camera_new_full(address.encode(), serial.encode(), name)
        if not self._server or not self._library.arv_gv_fake_camera_is_running(self._server):
            raise DeviceError(f"the camera cannot listen on {address}: is that an address of this computer, and free?")
        self._camera = self._library.arv_gv_fake_camera_get_fake_camera(self._server)
        self._hook = _FILL(self._fill)  # kept: C holds no reference
        self._library.arv_fake_camera_set_fill_pattern(self._camera, ctypes.cast(self._hook, ctypes.c_void_p), None)
        if has_latch:
            self._write(TEMPERATURE, struct.pack(">f", TEMPERATURE_C))
            threading.Thread(target=self._answer_latches, daemon=True).start()

    def _device_ns(self, host_ns: int) -> int:
        start_ns, drift = self._clock
        return start_ns + host_ns + round(host_ns * drift)

    def _fill(self, buffer: int, *_: int) -> None:
        host_ns = self._library.arv_buffer_get_timestamp(buffer)
        index = there_and_back(round(host_ns / self._period_ns), len(self._images))
        image = np.ascontiguousarray(self._images[index])
        if (self._read(HEIGHT), self._read(WIDTH)) == image.shape:
            ctypes.memmove(self._library.arv_buffer_get_data(buffer, None), image.ctypes.data, image.nbytes)
        device_ns = self._device_ns(host_ns)
        self._library.arv_buffer_set_timestamp(buffer, device_ns)
        if self._log is not None:
            number = self._library.arv_buffer_get_frame_id(buffer)
            os.write(self._log, f"{number},{host_ns},{device_ns},{index}\n".encode())

    def _answer_latches(self) -> None:
        while True:
            if self._read(LATCH):
                self._write(LATCHED, struct.pack(">Q", self._device_ns(time.time_ns())))
                self._write(LATCH, bytes(4))
            time.sleep(0.0005)

    def _read(self, address: int) -> int:
        value = ctypes.c_uint32()
        self._library.arv_fake_camera_read_register(self._camera, address, ctypes.byref(value))
        return value.value

    def _write(self, address: int, data: bytes) -> None:
        self._library.arv_fake_camera_write_memory(self._camera, address, len(data), data)

    def _with_features(self) -> str:
        size = ctypes.c_size_t()
        model = self._library.arv_fake_camera_new(b"model")
        xml = ctypes.string_at(self._library.arv_fake_camera_get_genicam_xml(model, ctypes.byref(size)), size.value)
        return xml.decode().replace("</RegisterDescription>", f"{FEATURES}</RegisterDescription>")


def _library() -> ctypes.CDLL:
    try:
        library = ctypes.CDLL(LIBRARY)
    except OSError as error:
        raise DeviceError(f"{error}. On Debian or Ubuntu: sudo apt install libaravis-0.8-0") from error
    for name, (takes, gives) in _TAKES.items():
        function = getattr(library, name)
        function.argtypes, function.restype = [_KINDS[kind] for kind in takes], _KINDS[gives]
    return library


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", type=Path, help="(N, rows, cols) uint8 as a .npy file")
    parser.add_argument("--rate", type=float, default=60.0, help="images a second, there and back [Hz]")
    parser.add_argument("--address", default="127.0.0.1", help="of this computer, where to listen")
    parser.add_argument("--serial", default="SIMULATED", help="serial number")
    parser.add_argument("--clock-start", type=int, default=0, help="its clock less the host's [ns]")
    parser.add_argument("--clock-drift", type=float, default=0.0, help="its clock's rate over the host's, - 1")
    parser.add_argument("--latch", action="store_true", help="give it a latch of its clock, and a temperature")
    parser.add_argument("--log", type=Path, help="file for a line on each frame that is sent")
    given = parser.parse_args()
    clock = (given.clock_start - round(time.time_ns() * given.clock_drift), given.clock_drift)
    images = np.load(given.images, mmap_mode="r")
    try:
        camera = GigeCamera(images, given.rate, given.address, given.serial, clock, given.latch, given.log)
    except DeviceError as error:
        print(error, file=sys.stderr)
        return 1
    print(f"camera {given.serial} listens on {given.address}", flush=True)
    signal.sigwait({signal.SIGINT, signal.SIGTERM})
    del camera
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
