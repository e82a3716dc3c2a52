"""Revival around a sensor that does as the test says."""

from __future__ import annotations

import math
import threading
import time
from collections import Counter

import pytest
from rgbd_dic_acquisition.errors import DeviceError, SettingsError
from rgbd_dic_acquisition.revival import Revival

from rgbd_dic_acquisition import revival

WAIT_S = 0.005


class Sensor:
    """Gives what `frame` is; an error in it is raised. `refuses` says why it cannot be opened."""

    def __init__(self, period_s: float = 0.01) -> None:
        self.counts: Counter[str] = Counter()
        self.told: dict[str, str] = {}
        self.period_s = period_s
        self.frame: str | Exception | None = "image"
        self.refuses: Exception | None = None
        self.opened = self.closed = 0
        self.gate = threading.Event()
        self.gate.set()

    def open(self) -> None:
        self.gate.wait(10)
        if self.refuses is not None:
            raise self.refuses
        self.opened += 1

    def close(self) -> None:
        self.closed += 1

    def read(self, timeout_s: float) -> str | None:
        if isinstance(self.frame, Exception):
            raise self.frame
        if self.frame is None:
            time.sleep(timeout_s)
            return None
        self.counts["received"] += 1
        return self.frame


@pytest.fixture
def sensor(monkeypatch):
    monkeypatch.setattr(revival, "RETRY_S", 0.01)
    monkeypatch.setattr(revival, "SILENT_AFTER_S", 0.02)
    monkeypatch.setattr(revival, "REOPEN_AFTER_S", 0.1)
    return Sensor()


@pytest.fixture
def revived(sensor):
    kept = Revival(sensor)
    kept.open()
    yield kept
    sensor.gate.set()
    kept.close()


def _read_until(kept, condition, seconds: float = 10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, kept.problem
        kept.read(WAIT_S)


def test_opening_does_not_hold_up_the_reader(sensor):
    sensor.gate.clear()
    kept = Revival(sensor)
    kept.open()
    assert kept.read(WAIT_S) is None and not kept.runs
    sensor.gate.set()
    _read_until(kept, lambda: kept.runs)
    assert kept.read(WAIT_S) == "image" and kept.problem == ""
    kept.close()
    assert sensor.closed == 2  # once before it was opened


def test_a_sensor_that_is_not_there_is_tried_again(sensor, revived):
    sensor.refuses = DeviceError("no camera")
    revived.open()
    _read_until(revived, lambda: revived.problem == "no camera")
    assert revived.reopened == 0
    sensor.refuses = None
    _read_until(revived, lambda: revived.runs)
    assert revived.read(WAIT_S) == "image" and revived.problem == ""


def test_a_short_silence_is_told_and_not_mended(sensor, revived):
    _read_until(revived, lambda: revived.read(WAIT_S) == "image")
    sensor.frame = None
    _read_until(revived, lambda: revived.problem)
    assert "no frame comes" in revived.problem and revived.reopened == 0
    sensor.frame = "image"
    _read_until(revived, lambda: not revived.problem)
    assert revived.reopened == 0 and sensor.opened == 1


def test_a_long_silence_opens_the_sensor_anew(sensor, revived):
    _read_until(revived, lambda: revived.read(WAIT_S) == "image")
    sensor.frame = None
    _read_until(revived, lambda: revived.reopened == 1)
    sensor.frame = "image"
    _read_until(revived, lambda: sensor.opened == 2 and revived.runs and not revived.problem)


def test_a_lost_sensor_is_closed_and_opened_anew(sensor, revived):
    _read_until(revived, lambda: revived.read(WAIT_S) == "image")
    sensor.frame = DeviceError("unplugged")
    sensor.gate.clear()
    assert revived.read(WAIT_S) is None
    assert revived.problem == "unplugged" and revived.reopened == 1
    sensor.frame = "image"
    sensor.gate.set()
    _read_until(revived, lambda: sensor.opened == 2 and revived.runs)
    assert sensor.closed == 2


def test_frames_that_come_only_in_part_are_not_silence(sensor, revived):
    _read_until(revived, lambda: revived.read(WAIT_S) == "image")
    sensor.frame = None
    end = time.monotonic() + 0.3
    while time.monotonic() < end:
        sensor.counts["incomplete"] += 1
        revived.read(WAIT_S)
    assert revived.reopened == 0 and revived.problem == ""


def test_a_stop_of_this_process_is_not_silence(sensor, revived):
    """What came meanwhile waits to be read."""
    _read_until(revived, lambda: revived.read(WAIT_S) == "image")
    time.sleep(0.3)
    assert revived.read(WAIT_S) == "image" and revived.problem == "" and revived.reopened == 0


def test_a_triggered_sensor_is_never_silent(sensor):
    sensor.period_s, sensor.frame = math.inf, None
    kept = Revival(sensor)
    kept.open()
    end = time.monotonic() + 0.3
    while time.monotonic() < end:
        kept.read(WAIT_S)
    assert kept.problem == "" and kept.reopened == 0
    kept.close()


def test_a_refused_setting_is_an_error_of_the_user(sensor):
    sensor.refuses = SettingsError("exposure")
    kept = Revival(sensor)
    kept.open()
    with pytest.raises(SettingsError, match="exposure"):
        _read_until(kept, lambda: False)
    kept.close()


def test_closing_ends_the_tries(sensor):
    sensor.refuses = DeviceError("no camera")
    kept = Revival(sensor)
    kept.open()
    _read_until(kept, lambda: kept.problem)
    kept.close()
    assert sensor.opened == 0
