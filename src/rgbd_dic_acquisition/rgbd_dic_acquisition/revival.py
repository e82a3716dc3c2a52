"""A sensor that is opened in the background, watched, and opened again when it falls silent or is lost."""

from __future__ import annotations

import threading
import time
from collections import Counter
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Generic, Protocol, TypeVar

from .errors import DeviceError

F = TypeVar("F")
# A sensor is silent when nothing has come for three of its periods and this [s] ...
SILENT_AFTER_S = 0.1
# ... and is opened anew when the silence lasts this long [s]: a frozen one may go on by itself.
REOPEN_AFTER_S = 1.0
RETRY_S = 0.2


class RevivableSource(Protocol[F]):
    """A source of frames that can be opened again after `close`.

    Attributes:
        counts: frames by what became of them.
        told: what is known of the sensor, in words.
        period_s: time between frames; infinite if they come when they come.
        uncertainty_ns: standard uncertainty of the latest stamp [ns]; infinite until known, or without a clock.
    """

    counts: Counter[str]
    told: dict[str, str]
    period_s: float
    uncertainty_ns: float

    def open(self) -> None: ...

    def close(self) -> None: ...

    def read(self, timeout_s: float) -> F | None: ...


class Revival(Generic[F]):
    """Keeps a source going. `read` never waits longer than it is told, and raises nothing that passes by itself.

    Attributes:
        problem: why nothing comes, in words; empty while all is well.
        reopened: how often the sensor was lost and had to be opened anew.
    """

    def __init__(self, source: RevivableSource[F]) -> None:
        self.problem = ""
        self.reopened = 0
        self._source = source
        self._ended = threading.Event()
        self._beside = ThreadPoolExecutor(1, "sensor")
        self._opening: Future[None] | None = None
        self._silent_s = 0.0
        self._seen = 0

    @property
    def runs(self) -> bool:
        """Whether the sensor is open."""
        return self._opening is None

    def open(self) -> None:
        """Begin to open the source; returns at once."""
        self._opening = self._beside.submit(self._open)

    def close(self) -> None:
        """Stop; waits for what is under way."""
        self._ended.set()
        self._beside.shutdown()
        self._source.close()

    def read(self, timeout_s: float) -> F | None:
        """The next frame, or None if none came in time.

        Raises:
            SettingsError: the sensor refuses a setting; it will not be opened again.
        """
        if self._opening is not None:
            wait([self._opening], timeout_s)
            if not self._opening.done():
                return None
            self._opening.result()
            self._opening, self._silent_s = None, 0.0
        started = time.monotonic()
        try:
            frame = self._source.read(timeout_s)
        except DeviceError as error:
            self._lose(str(error))
            return None
        self._watch(time.monotonic() - started)
        return frame

    def _watch(self, waited_s: float) -> None:
        """Count only time spent waiting: what came while this process was stopped is still there to be read."""
        seen = self._source.counts.total()
        if seen != self._seen:
            self._seen, self._silent_s, self.problem = seen, 0.0, ""
            return
        self._silent_s += waited_s
        limit_s = 3 * self._source.period_s + SILENT_AFTER_S
        if self._silent_s > limit_s:
            self.problem = f"no frame comes, where one is due every {self._source.period_s:.3g} s"
        if self._silent_s > limit_s + REOPEN_AFTER_S:
            self._lose(self.problem)

    def _lose(self, problem: str) -> None:
        self.problem = problem
        self.reopened += 1
        self.open()

    def _open(self) -> None:
        self._source.close()
        while not self._ended.is_set():
            try:
                self._source.open()
                return
            except DeviceError as error:
                self.problem = str(error)
            self._ended.wait(RETRY_S)
