"""A ToF camera with the features of a Blaze behind a GenTL producer of its own, for tests.

The producer (fake_blaze.cpp) is compiled when first asked for. Its features have the names, units and limits of
Basler's documentation; what they are set to is found in the camera's memory, which also holds the faults that the
camera is to have. The camera's clock has another start and another rate than the host's.
"""

from __future__ import annotations

import functools
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rgbd_dic_acquisition.calibration import Camera

SOURCE = Path(__file__).with_name("fake_blaze.cpp")
SERIAL = "24000101"
WIDTH, HEIGHT = 64, 48
FORMATS = {"Coord3D_C16": 0x011000B8, "Coord3D_ABC32f": 0x026000C0, "Mono16": 0x01100007, "Confidence16": 0x011000C7}
COMPONENTS = {"Range": ("Coord3D_C16", "Coord3D_ABC32f"), "Intensity": ("Mono16",), "Confidence": ("Confidence16",)}

# Registers: name -> address, type, value at power-on. Lists are indexed by a selector.
REGISTERS: dict[str, tuple[int, str, Any]] = {
    "OperatingMode": (0x000, "u4", 0),
    "FastMode": (0x004, "u4", 1),
    "DepthMin": (0x008, "u4", 0),
    "DepthMax": (0x00C, "u4", 1498),
    "ExposureTime": (0x010, "f8", 750.0),
    "ConfidenceThreshold": (0x018, "u4", 208),
    "AcquisitionFrameRateEnable": (0x01C, "u4", 0),
    "AcquisitionFrameRate": (0x020, "f8", 30.0),
    "DistortionCorrection": (0x028, "u4", 0),
    "TriggerMode": (0x030, "u4", 1),
    "ComponentSelector": (0x040, "u4", 0),
    "ComponentEnable": (0x044, "u4", [0, 1, 0]),
    "PixelFormat": (0x050, "u4", [FORMATS[formats[0]] for formats in COMPONENTS.values()]),
    "Scan3dCoordinateSelector": (0x060, "u4", 0),
    "Scan3dCoordinateScale": (0x068, "f8", [1.0, 1.0, 10000 / 65536]),
    "Scan3dCoordinateOffset": (0x080, "f8", [0.0, 0.0, 0.0]),
    "Scan3dInvalidDataValue": (0x098, "f8", [0.0, 0.0, 0.0]),
    "Scan3dFocalLength": (0x0B0, "f8", 51.25),
    "Scan3dPrincipalPointU": (0x0B8, "f8", 31.125),
    "Scan3dPrincipalPointV": (0x0C0, "f8", 24.5),
    "Width": (0x0C8, "u4", WIDTH),
    "Height": (0x0CC, "u4", HEIGHT),
    "AcquisitionStart": (0x0D0, "u4", 0),
    "AcquisitionStop": (0x0D4, "u4", 0),
    "TLParamsLocked": (0x0D8, "u4", 0),
    "Scan3dDistanceUnit": (0x0DC, "u4", 0),
    "TimestampLatch": (0x0E0, "u4", 0),
    "TimestampLatchValue": (0x0E8, "i8", 0),
}
LATCH = ("TimestampLatch", "TimestampLatchValue")
FAULTS: dict[str, tuple[int, str, Any]] = {
    "present": (0x800, "u4", 1),  # 0: unplugged
    "frozen": (0x804, "u4", 0),  # 1: sends nothing
    "fail": (0x808, "u4", 0),  # so many of the next buffers are incomplete
    "skip": (0x80C, "u4", 0),  # so many of the next frames are lost on their way
    "made": (0x810, "u4", 0),  # buffers sent so far
    "skew_ppm": (0x818, "f8", 60.0),
    "offset_ns": (0x820, "i8", 7_000_000_000_000),
    "jitter_s": (0x828, "f8", 0.0),
    "tick_ns": (0x830, "u4", 1),  # what its time stamps count ...
    "ticks_only": (0x834, "u4", 0),  # ... 0: and call nanoseconds all the same
    "played_ns": (0x838, "i8", 0),  # how long a sequence takes to its end, from where it is played back; 0: one frame
}


@functools.cache
def producer(camera: Path | None = None) -> Path:
    """The compiled producer; it finds the camera of this folder where the environment names none."""
    path = Path(tempfile.mkdtemp(prefix="fake_blaze_")) / "fake_blaze.cti"
    flags = ["-std=c++17", "-O1", "-Wall", "-fPIC", "-shared", "-pthread"]
    flags += [f'-DFAKE_BLAZE_FOLDER="{camera}"'] if camera else []
    subprocess.run([compiler(), *flags, "-o", str(path), str(SOURCE)], check=True)
    return path


def compiler() -> str | None:
    return shutil.which("g++") or shutil.which("c++")


class FakeBlaze:
    """The folder of one camera; its producer finds it by the environment variable FAKE_BLAZE.

    Args:
        played: a file of frames (N, 3, rows, cols) uint16 that are played there and back by the host's clock, in place
            of one of random numbers; what was sent is then in `sent.csv`, as of the GigE Vision camera.
        played_ns: from the first of them to the last.

    Attributes:
        stored, intensity, confidence: (rows, cols) uint16, what the camera sends; 0 in `stored` is no depth.
    """

    def __init__(
        self,
        folder: Path,
        latch: bool = True,
        size: tuple[int, int] = (WIDTH, HEIGHT),
        played: Path | None = None,
        played_ns: int = 0,
    ) -> None:
        self.environment = {"FAKE_BLAZE": str(folder)}
        if played is None:
            (folder / "frame.bin").write_bytes(self._random_frame(size[::-1]))
        else:
            (folder / "frame.bin").symlink_to(played.resolve())
            (folder / "sent.csv").touch()
        (folder / "device.xml").write_text(description(latch))
        (folder / "memory.bin").write_bytes(bytes(4096))
        self._memory = np.memmap(folder / "memory.bin", np.uint8, "r+")
        for name, (_, _, value) in {**REGISTERS, **FAULTS}.items():
            self[name] = value
        self["Width"], self["Height"] = size
        self["played_ns"] = played_ns
        self._folder = folder

    def show(self, frames: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], rate_hz: float, camera: Camera) -> None:
        """From when it is opened next: depth [m] (NaN where there is none), intensity and confidence of several scenes,
        (rows, cols) each, so many a second, there and back by the host's clock, seen by this camera."""
        scale_m = self["Scan3dCoordinateScale"][2] * 1e-3
        stored = [(np.nan_to_num(np.rint(depth_m / scale_m)), *others) for depth_m, *others in frames]
        data = b"".join(each.astype("<u2").tobytes() for frame in stored for each in frame)
        (self._folder / "frame.bin").write_bytes(data)
        self["Width"], self["Height"] = camera.width, camera.height
        self["played_ns"] = round((len(frames) - 1) / rate_hz * 1e9)
        self["Scan3dFocalLength"] = camera.fx
        self["Scan3dPrincipalPointU"], self["Scan3dPrincipalPointV"] = camera.cx, camera.cy

    def _random_frame(self, shape: tuple[int, int]) -> bytes:
        rng = np.random.default_rng(101)
        self.stored = rng.integers(6554, 26214, shape).astype("<u2")  # 1 m to 4 m
        self.stored[rng.random(shape) < 0.1] = 0
        self.intensity, self.confidence = (rng.integers(1, 65536, shape).astype("<u2") for _ in range(2))
        return b"".join(each.tobytes() for each in (self.stored, self.intensity, self.confidence))

    def __getitem__(self, name: str) -> Any:
        values = self._view(name)
        return values.tolist() if values.size > 1 else values[0].item()

    def __setitem__(self, name: str, value: Any) -> None:
        self._view(name)[:] = value

    def _view(self, name: str) -> np.ndarray:
        address, kind, start = {**REGISTERS, **FAULTS}[name]
        count = len(start) if isinstance(start, list) else 1
        dtype = np.dtype(f"<{kind}")
        return self._memory[address : address + count * dtype.itemsize].view(dtype)


def description(latch: bool = True) -> str:
    """The camera's features in the language of GenApi; whether its clock can be latched."""
    commands, latched = (LATCH[:1], LATCH[1:]) if latch else ((), ())
    indexed = {"ComponentEnable": "ComponentSelector", "PixelFormat": "ComponentSelector"}
    indexed |= {f"Scan3d{name}": "Scan3dCoordinateSelector" for name in _PER_AXIS}
    nodes = [_register(name, indexed.get(name)) for name in REGISTERS]
    modes = {"ShortRange": 0, "LongRange": 1}
    formats = {name: (FORMATS[name], index) for index, names in enumerate(COMPONENTS.values()) for name in names}
    nodes += [
        _enumeration("OperatingMode", modes),
        _enumeration("TriggerMode", {"Off": 0, "On": 1}),
        _enumeration("Scan3dDistanceUnit", {"Millimeter": 0, "Pixel": 1}),
        _enumeration("ComponentSelector", {name: index for index, name in enumerate(COMPONENTS)}, "PixelFormat"),
        _enumeration("Scan3dCoordinateSelector", {f"Coordinate{axis}": index for index, axis in enumerate("ABC")}),
        _enumeration("PixelFormat", {name: code for name, (code, _) in formats.items()}, "", formats),
        "<Enumeration Name='AcquisitionMode'><EnumEntry Name='Continuous'><Value>0</Value></EnumEntry>"
        "<Value>0</Value></Enumeration>",
        *(_boolean(name) for name in ("FastMode", "DistortionCorrection", "AcquisitionFrameRateEnable")),
        _boolean("ComponentEnable"),
        _limited("Integer", "DepthMin", "0", "<pMax>DepthMaxReg</pMax>"),
        _limited("Integer", "DepthMax", "0", "<pMax>DepthLimit</pMax>"),
        _formula("IntSwissKnife", "DepthLimit", {"M": "OperatingModeReg"}, "(M=1) ? 9990 : 1498"),
        _limited("Integer", "ConfidenceThreshold", "0", "<Max>65535</Max>"),
        _limited("Float", "ExposureTime", "100", "<Max>1000</Max>"),
        _limited("Float", "AcquisitionFrameRate", "1", "<pMax>RateLimit</pMax>", "<pIsLocked>RateLocked</pIsLocked>"),
        _formula("SwissKnife", "RateLimit", {"F": "FastModeReg"}, "(F=1) ? 30 : 20"),
        _formula("IntSwissKnife", "RateLocked", {"E": "AcquisitionFrameRateEnableReg"}, "1 - E"),
        # Basler: the scale depends on the pixel format; points are millimetres as they are.
        "<Float Name='Scan3dCoordinateScale'><pValue>ScaleNow</pValue></Float>",
        _formula(
            "SwissKnife",
            "ScaleNow",
            {"S": "Scan3dCoordinateScaleReg", "F": "PixelFormatReg"},
            f"(F={FORMATS['Coord3D_ABC32f']}) ? 1 : S",
        ),
        *(f"<Float Name='{name}'><pValue>{name}Reg</pValue></Float>" for name in _FLOATS),
        *(f"<Integer Name='{name}'><pValue>{name}Reg</pValue></Integer>" for name in (*_INTEGERS, *latched)),
        *(
            f"<Command Name='{name}'><pValue>{name}Reg</pValue><CommandValue>1</CommandValue></Command>"
            for name in ("AcquisitionStart", "AcquisitionStop", *commands)
        ),
        "<Port Name='Device' NameSpace='Standard'/>",
    ]
    version = "SchemaMajorVersion='1' SchemaMinorVersion='1' SchemaSubMinorVersion='0'"
    guids = "ProductGuid='11111111-2222-3333-4444-555555555555' VersionGuid='11111111-2222-3333-4444-666666666666'"
    return (
        "<?xml version='1.0' encoding='utf-8'?>\n"
        f"<RegisterDescription ModelName='fake_blaze' VendorName='rgbd_dic' StandardNameSpace='GEV' {version} "
        f"MajorVersion='1' MinorVersion='0' SubMinorVersion='0' {guids} "
        "xmlns='http://www.genicam.org/GenApi/Version_1_1'>\n"
        "<Category Name='Root' NameSpace='Standard'><pFeature>Width</pFeature></Category>\n"
        + "\n".join(nodes)
        + "\n</RegisterDescription>\n"
    )


_PER_AXIS = ("CoordinateScale", "CoordinateOffset", "InvalidDataValue")
_FLOATS = (
    *("Scan3dCoordinateOffset", "Scan3dInvalidDataValue", "Scan3dFocalLength"),
    *("Scan3dPrincipalPointU", "Scan3dPrincipalPointV"),
)
_INTEGERS = ("Width", "Height", "TLParamsLocked")


def _register(name: str, selector: str | None) -> str:
    address, kind, _ = REGISTERS[name]
    size = int(kind[1])
    index = f"<pIndex Offset='{size}'>{selector}Reg</pIndex>" if selector else ""
    common = (
        f"<Address>{address}</Address>{index}<Length>{size}</Length><AccessMode>RW</AccessMode><pPort>Device</pPort>"
    )
    common += "<Cachable>NoCache</Cachable>"
    if kind == "f8":
        return f"<FloatReg Name='{name}Reg'>{common}<Endianess>LittleEndian</Endianess></FloatReg>"
    return f"<IntReg Name='{name}Reg'>{common}<Sign>Unsigned</Sign><Endianess>LittleEndian</Endianess></IntReg>"


def _enumeration(
    name: str, entries: Mapping[str, int], selected: str = "", only_with: Mapping[str, tuple[int, int]] | None = None
) -> str:
    """`only_with`: entry -> (value, index of the component that has it)."""
    made, extra = [], []
    for entry, value in entries.items():
        there = ""
        if only_with:
            there = f"<pIsAvailable>{name}_{entry}</pIsAvailable>"
            formula = f"C={only_with[entry][1]}"
            extra.append(_formula("IntSwissKnife", f"{name}_{entry}", {"C": "ComponentSelectorReg"}, formula))
        made.append(f"<EnumEntry Name='{entry}'>{there}<Value>{value}</Value></EnumEntry>")
    selects = f"<pSelected>{selected}</pSelected>" if selected else ""
    node = f"<Enumeration Name='{name}'>{''.join(made)}<pValue>{name}Reg</pValue>{selects}</Enumeration>"
    return "\n".join([node, *extra])


def _boolean(name: str) -> str:
    values = "<OnValue>1</OnValue><OffValue>0</OffValue>"
    return f"<Boolean Name='{name}'><pValue>{name}Reg</pValue>{values}</Boolean>"


def _limited(kind: str, name: str, low: str, high: str, extra: str = "") -> str:
    return f"<{kind} Name='{name}'>{extra}<pValue>{name}Reg</pValue><Min>{low}</Min>{high}</{kind}>"


def _formula(kind: str, name: str, variables: Mapping[str, str], formula: str) -> str:
    given = "".join(f"<pVariable Name='{short}'>{node}</pVariable>" for short, node in variables.items())
    return f"<{kind} Name='{name}'>{given}<Formula>{formula}</Formula></{kind}>"
