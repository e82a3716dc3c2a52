"""One autopilot over MAVLink: the link, what is sent to it, and whether all is well."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from ..settings import Settings, setting
from .autopilot_clock import AutopilotClock
from .autopilot_readings import PREFER_QUATERNION_S, Attitude, AutopilotReadings, SystemTime
from .byte_links import ByteLink, Piece, check_url, open_link, wait
from .mavlink_codec import BAD_DATA, MavlinkCodec

HEARTBEAT_S = 1.0
REOPEN_S = 1.0
ASK_S = 5.0  # between requests for a rate that does not come
# Attitude is missing after so many of its own periods and so long; telling it takes some time too.
MISSED_PERIODS, MISSED_S = 3, 0.15


@dataclass(frozen=True)
class MavlinkSettings(Settings):
    """The link to the autopilot."""

    url: str = setting(
        "udpin://127.0.0.1:14550",
        doc="link: udpin://HOST:PORT, udpout://HOST:PORT, tcp://HOST:PORT or serial:///dev/NAME:BAUD",
    )
    system_id: int = setting(0, doc="MAVLink system of the autopilot; 0 takes the first that is heard", low=0, high=255)
    own_system_id: int = setting(1, doc="MAVLink system that this computer belongs to", low=1, high=255)
    silence_s: float = setting(
        3.0,
        doc="silence after which the link counts as lost and is opened anew",
        unit="s",
        low=0.2,
        high=60.0,
    )
    attitude_rate_hz: float = setting(
        0.0,
        doc="rate of ATTITUDE_QUATERNION to ask the autopilot for; 0 takes what it sends by itself",
        unit="Hz",
        low=0.0,
        high=400.0,
    )
    timesync_rate_hz: float = setting(
        10.0,
        doc="rate of TIMESYNC requests; 0 sends none, and stamps go by the arrival of messages alone",
        unit="Hz",
        low=0.0,
        high=100.0,
    )
    timesync_round_trip_s: float = setting(
        0.05, doc="longest round trip of a TIMESYNC request that is used", unit="s", low=0.001, high=1.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_url(self.url)


class Autopilot:
    """Reads one autopilot, and opens its link again by itself when that is lost.

    Attributes:
        counts: messages by what became of them: "attitude", "system_time", "timesync", "heartbeat", "other",
            "garbage", "invalid" or "overtaken"; and how often the link was "reopened".
        problem: what is missing, in words; empty while all is well.
        clock: how the autopilot's time becomes host time.
    """

    def __init__(self, settings: MavlinkSettings, now_ns: Callable[[], int] = time.time_ns) -> None:
        self.counts: Counter[str] = Counter()
        self.problem = "nothing heard yet"
        self.clock = AutopilotClock(round(settings.timesync_round_trip_s * 1e9))
        self._settings = settings
        self._now_ns = now_ns
        self._readings = AutopilotReadings(settings.system_id, self.clock, self.counts)
        self._link: ByteLink | None = None
        self._open_at = self._heartbeat_at = self._timesync_at = self._ask_at = time.monotonic()

    def read(self, timeout_s: float = 0.0) -> list[Attitude | SystemTime]:
        """What has come since the last call, in the order of arrival; waits at most so long if nothing has."""
        now = time.monotonic()
        try:
            if self._link is None:
                if now < self._open_at:
                    time.sleep(min(timeout_s, self._open_at - now))
                    return []
                self._open(now)
            self._speak(now)
            wait(self._link, timeout_s)
            pieces = self._link.read()
        except OSError as error:
            self._lose(f"link {self._settings.url} is down: {error}")
            return []
        arrival_ns = self._now_ns()
        readings = [reading for piece in pieces for reading in self._take(piece, arrival_ns)]
        self._assess(time.monotonic())
        return readings

    def close(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None

    def _open(self, now: float) -> None:
        self._open_at = now + REOPEN_S
        self._link = open_link(self._settings.url)
        self._opened_at = now
        self._codec = MavlinkCodec(self._settings.own_system_id)

    def _lose(self, problem: str) -> None:
        self.close()
        self.counts["reopened"] += 1
        self.problem = problem
        self._open_at = max(self._open_at, time.monotonic() + REOPEN_S / 10)

    def _take(self, piece: Piece, arrival_ns: int) -> list[Attitude | SystemTime]:
        readings = []
        for message in self._codec.messages(piece.data, self._link.keeps_boundaries):
            if message.get_type() == BAD_DATA:
                self.counts["garbage"] += 1
            elif self._readings.is_from_autopilot(message):
                self._link.answer(piece.sender)
                reading = self._readings.take(message, arrival_ns)
                readings += [] if reading is None else [reading]
        return readings

    def _speak(self, now: float) -> None:
        """Say that we are here; ask for the time, and for attitude if it comes too seldom."""
        if now >= self._heartbeat_at:
            self._heartbeat_at = now + HEARTBEAT_S
            kind, version = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, int(mavlink.WIRE_PROTOCOL_VERSION[0])
            no_autopilot, active = mavlink.MAV_AUTOPILOT_INVALID, mavlink.MAV_STATE_ACTIVE
            self._send(mavlink.MAVLink_heartbeat_message(kind, no_autopilot, 0, 0, active, version))
        if now - self._readings.heard_at > self._settings.silence_s:
            return
        if self._settings.timesync_rate_hz and now >= self._timesync_at:
            self._timesync_at = now + 1 / self._settings.timesync_rate_hz
            self._send(mavlink.MAVLink_timesync_message(0, self.clock.timesync.request(self._now_ns())))
        if now >= self._ask_at and self._is_too_seldom(now):
            self._ask_at = now + ASK_S
            autopilot = (self._readings.system, mavlink.MAV_COMP_ID_AUTOPILOT1)
            interval_us = 1e6 / self._settings.attitude_rate_hz
            arguments = (mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION, interval_us, 0, 0, 0, 0, 0)
            command = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
            self._send(mavlink.MAVLink_command_long_message(*autopilot, command, 0, *arguments))

    def _is_too_seldom(self, now: float) -> bool:
        wanted_hz = self._settings.attitude_rate_hz
        is_missing = now - self._readings.quaternion_at > PREFER_QUATERNION_S
        return wanted_hz > 0 and (is_missing or self._readings.period_s * wanted_hz > 1.25)

    def _send(self, message: mavlink.MAVLink_message) -> None:
        self._link.write(self._codec.pack(message))

    def _assess(self, now: float) -> None:
        """State what is missing, the worst first; give up a link that is silent."""
        silent_s, missing_s = now - self._readings.heard_at, now - self._readings.attitude_at
        period_s = self._readings.period_s
        if math.isinf(silent_s):
            self.problem = "nothing heard yet"
        elif silent_s > self._settings.silence_s:
            self.problem = f"nothing heard for {silent_s:.1f} s on {self._settings.url}"
            if self._link.notices_loss and now - self._opened_at > self._settings.silence_s:
                self._lose(self.problem)
        elif math.isinf(missing_s):
            self.problem = (
                "the autopilot is heard, but no ATTITUDE_QUATERNION and no ATTITUDE that can be used: have it send "
                "one, or ask for it with link.attitude_rate_hz"
            )
        elif missing_s > MISSED_PERIODS * period_s + MISSED_S:
            self.problem = f"no attitude for {missing_s:.1f} s; it came every {period_s:.3f} s"
        else:
            self.problem = self.clock.problem if self._settings.timesync_rate_hz else ""
