"""What the live page shows, between the node that hears it and the server that tells it: safe for both threads."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, InvalidStateError
from dataclasses import dataclass, field
from datetime import datetime, timezone
from queue import SimpleQueue
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import RgbdDicError

from ..core.crack import CrackOpening
from ..core.opening_log import Openings
from .flight_record import FlightRecord

PICTURE_LINGER_S = 2.0  # pictures are made until nobody has asked for so long
MINUTE_S = 60.0
COARSEST = 2  # how often a picture is halved for a slow link
BINS = 400  # of the chart of the whole flight
MOST_EVENTS = 200


class TooManyViewers(RgbdDicError):
    """The page is open as often as the settings allow."""


@dataclass(frozen=True)
class Picture:
    """A picture for the page, and where the regions lie in it.

    width, height: of the camera's image [px]. small: the whole of it with fewer pixels, mono8.
    outlines: name -> points [px of the camera's image]; empty if the panel was not found, with the reason.
    jpegs: those that were made.
    """

    number: int
    stamp_ns: int
    width: int
    height: int
    small: NDArray[np.uint8]
    quality: int
    outlines: dict[str, Any]
    reason: str
    jpegs: dict[int, bytes] = field(default_factory=dict)

    def jpeg(self, coarse: int) -> bytes:
        """With half of the pixels each way, so many times. Made when it is first asked for: nobody may ask."""
        if coarse not in self.jpegs:
            shown = self.small
            for _ in range(coarse):
                shown = cv2.pyrDown(shown)
            self.jpegs[coarse] = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, self.quality])[1].tobytes()
        return self.jpegs[coarse]


@dataclass
class Order:
    """Something that a viewer asks of the graph."""

    what: str
    content: Any = None
    done: Future = field(default_factory=Future)

    def answer(self, result: Any) -> None:
        """What came of it, or the RgbdDicError why nothing did; too late, nobody hears it."""
        with contextlib.suppress(InvalidStateError):
            if isinstance(result, RgbdDicError):
                self.done.set_exception(result)
            else:
                self.done.set_result(result)


class LiveState:
    """Filled by the node, read by the server."""

    def __init__(self, most_viewers: int):
        self._lock = threading.Lock()
        self._record = FlightRecord()
        self._nodes: dict[str, dict[str, Any]] = {}
        self._events: list[dict[str, Any]] = []
        self._offers: dict[str, Any] = {}
        self._most_viewers, self._viewers = most_viewers, 0
        self._viewer_heard = self._picture_asked = float("-inf")
        self._picture: Picture | None = None
        self._waiting: list[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = []
        self.orders: SimpleQueue[Order] = SimpleQueue()

    # The node's side

    def watched(self, linger_s: float) -> bool:
        """Whether any viewer was heard within the last seconds; one whose connection is lost is not."""
        with self._lock:
            return time.monotonic() - self._viewer_heard < linger_s

    def picture_wanted(self) -> bool:
        with self._lock:
            asked = bool(self._waiting) or time.monotonic() - self._picture_asked < PICTURE_LINGER_S
            return asked and self._viewers > 0

    def add_opening(self, opening: CrackOpening) -> None:
        with self._lock:
            self._record.add(opening)

    def fill(self, known: Openings) -> None:
        """What was measured while nobody looked."""
        with self._lock:
            self._record.fill(known)

    def last_stamp_ns(self) -> int:
        """Of the latest opening; 0 before the first."""
        with self._lock:
            return self._record.last.stamp_ns if self._record.last is not None else 0

    def set_node(self, name: str, status: dict[str, Any]) -> None:
        with self._lock:
            self._nodes[name] = {**status, "heard": time.monotonic()}

    def set_offers(self, offers: dict[str, Any]) -> None:
        """What the graph offers: "reference", "regions" (whether it can), "recording" (None, True or False)."""
        with self._lock:
            self._offers = offers

    def add_event(self, stamp_ns: int, text: str) -> None:
        with self._lock:
            self._events = [*self._events[1 - MOST_EVENTS :], {"stamp_ns": stamp_ns, "text": text}]

    def set_picture(self, picture: Picture) -> None:
        with self._lock:
            self._picture = picture
            waiting, self._waiting = self._waiting, []
        for loop, event in waiting:
            with contextlib.suppress(RuntimeError):  # the server has ended
                loop.call_soon_threadsafe(event.set)

    # The server's side

    @contextlib.contextmanager
    def viewer(self) -> Iterator[None]:
        """Somebody looks.

        Raises:
            TooManyViewers: if as many look already as may.
        """
        with self._lock:
            if self._viewers >= self._most_viewers:
                raise TooManyViewers(f"{self._viewers} viewers look already, which is the most that are served")
            self._viewers += 1
            self._viewer_heard = time.monotonic()
        try:
            yield
        finally:
            with self._lock:
                self._viewers -= 1

    def hear_viewer(self) -> None:
        """One of them has said that it has what it was sent."""
        with self._lock:
            self._viewer_heard = time.monotonic()

    async def next_picture(self, after: int, timeout_s: float) -> Picture | None:
        """A picture of a higher number; None if there is none in time."""
        event = asyncio.Event()
        with self._lock:
            self._picture_asked = time.monotonic()
            if self._picture is not None and self._picture.number > after:
                return self._picture
            self._waiting.append((asyncio.get_running_loop(), event))
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(event.wait(), timeout_s)
        with self._lock:
            self._waiting = [entry for entry in self._waiting if entry[1] is not event]
            newer = self._picture is not None and self._picture.number > after
            return self._picture if newer else None

    def news(self, flight: int, number: int) -> tuple[dict[str, Any], int, int]:
        """The latest opening and the samples from this number on; returns the flight and the number to ask for next."""
        with self._lock:
            record = self._record
            number = number if flight == record.flight else 0
            samples, following = record.since(number, MINUTE_S)
            content = {"flight": record.flight, "from_start": number == 0, "samples": samples}
            if record.last is not None:
                content["last"] = _shown(record.last, record)
        return content, record.flight, following

    def surroundings(self) -> dict[str, Any]:
        """What changes slowly: nodes, what the graph offers, events, the whole flight."""
        now = time.monotonic()
        with self._lock:
            return {
                "nodes": [
                    {"name": name, **status, "heard": round(now - status["heard"], 1)}
                    for name, status in sorted(self._nodes.items())
                ],
                "offers": self._offers,
                "viewers": self._viewers,
                "overview": self._record.overview(BINS),
                "events": [
                    {"time": round(self._record.time_s(event["stamp_ns"]), 2), "text": event["text"]}
                    for event in self._events
                ],
            }

    async def order(self, what: str, content: Any = None, timeout_s: float = 10.0) -> Any:
        """Have the node do something; returns what it says.

        Raises:
            RgbdDicError: if it cannot, or does not answer in time.
        """
        order = Order(what, content)
        self.orders.put(order)
        try:
            return await asyncio.wait_for(asyncio.wrap_future(order.done), timeout_s)
        except asyncio.TimeoutError as error:
            raise RgbdDicError(f"the graph did not answer within {timeout_s:g} s") from error


def _shown(opening: CrackOpening, record: FlightRecord) -> dict[str, Any]:
    """An opening as the page shows it; no value where it is not valid."""

    def mm(value: float) -> float | None:
        return value * 1e3 if value == value else None

    return {
        "stamp_ns": str(opening.stamp_ns),  # more digits than JavaScript has
        "time": round(record.time_s(opening.stamp_ns), 3),
        "clock": datetime.fromtimestamp(opening.stamp_ns * 1e-9, timezone.utc).strftime("%Y-%m-%d %H:%M:%S"),
        "method": opening.method,
        "valid": opening.valid,
        "state": opening.status.name,
        "reason": opening.reason,
        "opening_mm": mm(opening.opening_m),
        "u_mm": mm(opening.u_opening_m),
        "sliding_mm": mm(opening.sliding_m),
        "left": opening.n_left,
        "right": opening.n_right,
        "latency_s": opening.latency_s if opening.latency_s == opening.latency_s else None,
        "depth_offset_s": opening.depth_offset_s if opening.depth_offset_s == opening.depth_offset_s else None,
        "reference_age_s": round((opening.stamp_ns - opening.reference_stamp_ns) * 1e-9, 1)
        if opening.reference_stamp_ns
        else None,
    }
