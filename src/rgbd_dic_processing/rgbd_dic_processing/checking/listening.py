"""What the sensors send in a few seconds, all of them at the same time."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

from rgbd_dic_acquisition.errors import RgbdDicError

READ_S = 0.05


@dataclass
class Heard:
    """Of one camera.

    problem: why nothing came; empty if something did. frame: the last one. told: what the driver tells of the device.
    uncertainty_ns: of the last stamp [ns].
    """

    problem: str = ""
    stamps_ns: list[int] = field(default_factory=list)
    frame: Any = None
    counts: Counter[str] = field(default_factory=Counter)
    told: dict[str, str] = field(default_factory=dict)
    uncertainty_ns: float = float("inf")
    camera: Any = None

    @property
    def rate_hz(self) -> float:
        """Frames a second, by the stamps."""
        if len(self.stamps_ns) < 2:
            return 0.0
        return (len(self.stamps_ns) - 1) * 1e9 / (self.stamps_ns[-1] - self.stamps_ns[0])


@dataclass
class HeardAutopilot:
    """problem: what is missing; empty if nothing is. clock_problem: the same of TIMESYNC."""

    problem: str = ""
    stamps_ns: list[int] = field(default_factory=list)
    is_synchronised: bool = False
    uncertainty_ns: float = float("inf")


def listen(
    camera: Callable[[], Any] | None, tof: Callable[[], Any] | None, autopilot: Any | None, seconds: float
) -> tuple[Heard | None, Heard | None, HeardAutopilot | None]:
    """Open all that is given and listen for so long; None for what is not.

    Args:
        camera, tof: make a source of frames; what they raise is the problem.
        autopilot: MavlinkSettings.
    """
    with ThreadPoolExecutor(3) as pool:
        cameras = [None if make is None else pool.submit(_frames, make, seconds) for make in (camera, tof)]
        autopilot = None if autopilot is None else pool.submit(_attitude, autopilot, seconds)
        return tuple(None if future is None else future.result() for future in (*cameras, autopilot))


def _frames(make: Callable[[], Any], seconds: float) -> Heard:
    heard = Heard()
    try:
        with make() as source:
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                frame = source.read(READ_S)
                if frame is not None:
                    heard.frame = frame
                    heard.stamps_ns.append(frame.stamp_ns)
            heard.counts, heard.told, heard.camera = Counter(source.counts), dict(source.told), source.camera
            heard.uncertainty_ns = source.uncertainty_ns
    except RgbdDicError as error:
        heard.problem = str(error)
    if not heard.problem and heard.frame is None:
        heard.problem = f"it answers, but sent no whole frame in {seconds:g} s"
    return heard


def _attitude(settings: Any, seconds: float) -> HeardAutopilot:
    from rgbd_dic_acquisition.drivers.autopilot_readings import Attitude  # needs pymavlink
    from rgbd_dic_acquisition.drivers.mavlink import Autopilot

    heard, autopilot = HeardAutopilot(), Autopilot(settings)
    try:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for reading in autopilot.read(READ_S):
                if isinstance(reading, Attitude):
                    heard.stamps_ns.append(reading.stamp_ns)
                    heard.uncertainty_ns = reading.uncertainty_ns
        heard.problem, heard.is_synchronised = autopilot.problem, autopilot.clock.is_synchronised
    finally:
        autopilot.close()
    return heard
