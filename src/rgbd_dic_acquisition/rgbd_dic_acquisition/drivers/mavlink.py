"""Attitude and time of an autopilot over MAVLink."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from ..clock import HostClock
from ..settings import Settings, setting
from .byte_links import ByteLink, check_url, open_link

Quaternion = tuple[float, float, float, float]  # w, x, y, z
Vector = tuple[float, float, float]

MARKERS = (mavlink.PROTOCOL_MARKER_V1, mavlink.PROTOCOL_MARKER_V2)
HEARTBEAT_S = 1.0
REOPEN_S = 1.0
# How long ATTITUDE is left aside after an ATTITUDE_QUATERNION.
PREFER_QUATERNION_S = 1.0
NED_TO_ENU: Quaternion = (0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0)
FLU_TO_FRD: Quaternion = (0.0, 1.0, 0.0, 0.0)


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

    def __post_init__(self) -> None:
        super().__post_init__()
        check_url(self.url)


@dataclass(frozen=True)
class Attitude:
    """How the vehicle is turned.

    Attributes:
        stamp_ns: host time of the measurement [ns since the epoch].
        uncertainty_ns: standard uncertainty of the stamp [ns]; infinite while the clocks are being compared.
        orientation_xyzw: R_world_body, world east-north-up, body forward-left-up.
        angular_velocity: of the body in its own axes, forward-left-up [rad/s]; None if not known.
    """

    stamp_ns: int
    uncertainty_ns: float
    orientation_xyzw: Quaternion
    angular_velocity: Vector | None


@dataclass(frozen=True)
class SystemTime:
    """The autopilot's idea of UTC, `unix_ns`, at the host time `stamp_ns` [ns since the epoch]."""

    stamp_ns: int
    unix_ns: int


class Autopilot:
    """Reads one autopilot, never blocks, and opens its link again by itself when that is lost.

    Attributes:
        counts: messages by what became of them: "attitude", "system_time", "other", "garbage" or "invalid";
            and how often the link was "reopened".
        problem: why nothing comes, in words; empty while all is well.
    """

    def __init__(self, settings: MavlinkSettings, now_ns: Callable[[], int] = time.time_ns) -> None:
        self.counts: Counter[str] = Counter()
        self.problem = "nothing heard yet"
        self._settings = settings
        self._now_ns = now_ns
        self._clock = HostClock(resolution_ns=1_000_000)
        self._system = settings.system_id
        self._link: ByteLink | None = None
        self._parser = self._new_parser()
        self._open_at = self._heartbeat_at = time.monotonic()
        self._heard_at = self._quaternion_at = -math.inf

    @property
    def clock_restarts(self) -> int:
        """How often the autopilot's time has jumped back: it was restarted."""
        return self._clock.restarts

    def read(self) -> list[Attitude | SystemTime]:
        """What has come since the last call, in the order of arrival."""
        now = time.monotonic()
        try:
            if self._link is None:
                if now < self._open_at:
                    return []
                self._open(now)
            pieces = self._link.read()
            if now >= self._heartbeat_at:
                self._heartbeat_at = now + HEARTBEAT_S
                self._link.write(self._heartbeat())
        except OSError as error:
            self._lose(f"link {self._settings.url} is down: {error}")
            return []
        arrival_ns = self._now_ns()
        readings = [reading for piece in pieces for reading in self._parse(piece, arrival_ns)]
        silent_s = now - self._heard_at
        if silent_s > self._settings.silence_s and math.isfinite(silent_s):
            self.problem = f"nothing heard for {silent_s:.1f} s on {self._settings.url}"
            if self._link.notices_loss and now - self._opened_at > self._settings.silence_s:
                self._lose(self.problem)
        return readings

    def close(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None

    def _open(self, now: float) -> None:
        self._open_at = now + REOPEN_S
        self._link = open_link(self._settings.url)
        self._opened_at = now
        self._parser = self._new_parser()

    def _lose(self, problem: str) -> None:
        self.close()
        self.counts["reopened"] += 1
        self.problem = problem
        self._open_at = max(self._open_at, time.monotonic() + REOPEN_S / 10)

    def _new_parser(self) -> mavlink.MAVLink:
        parser = mavlink.MAVLink(None, self._settings.own_system_id, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER)
        parser.robust_parsing = True
        return parser

    def _heartbeat(self) -> bytes:
        message = self._parser.heartbeat_encode(
            mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE
        )
        packed = message.pack(self._parser)
        self._parser.seq = (self._parser.seq + 1) % 256
        return packed

    def _parse(self, piece: bytes, arrival_ns: int) -> list[Attitude | SystemTime]:
        readings = (self._take(message, arrival_ns) for message in self._messages(piece))
        return [reading for reading in readings if reading is not None]

    def _messages(self, piece: bytes) -> Iterator[mavlink.MAVLink_message]:
        parser = self._parser
        message = parser.parse_char(piece)
        while message is not None:
            yield message
            frame = bytes(message.get_msgbuf()) if message.get_type() != "BAD_DATA" else bytes(message.data)
            if self._is_false_start(message, frame):
                # The parser has skipped as many bytes as garbage promised; look for messages among them.
                parser.buf[: parser.buf_index] = frame[1:]
                parser.buf_index = 0
            message = parser.parse_char(b"")
        del parser.buf[: parser.buf_index]
        parser.buf_index = 0
        if self._link.keeps_boundaries:
            parser.buf.clear()

    def _is_false_start(self, message: mavlink.MAVLink_message, frame: bytes) -> bool:
        if message.get_type() == "BAD_DATA":
            return frame[0] in MARKERS
        if not message.get_type().startswith("UNKNOWN"):
            return False
        following = self._parser.buf[self._parser.buf_index :][:1]
        return len(following) == 1 and following[0] not in MARKERS  # it has no known checksum

    def _take(self, message: mavlink.MAVLink_message, arrival_ns: int) -> Attitude | SystemTime | None:
        kind = message.get_type()
        if kind == "BAD_DATA":
            self.counts["garbage"] += 1
            return None
        if message.get_srcComponent() != mavlink.MAV_COMP_ID_AUTOPILOT1:
            return None
        self._system = self._system or message.get_srcSystem()
        if message.get_srcSystem() != self._system:
            return None
        now = time.monotonic()
        self._heard_at = now
        self.problem = ""
        if kind == "ATTITUDE_QUATERNION":
            self._quaternion_at = now
            return self._attitude(message, (message.q1, message.q2, message.q3, message.q4), arrival_ns)
        if kind == "ATTITUDE" and now - self._quaternion_at > PREFER_QUATERNION_S:
            angles = (message.roll, message.pitch, message.yaw)
            return self._attitude(message, quaternion_from_rpy(*angles), arrival_ns)
        if kind == "SYSTEM_TIME":
            self.counts["system_time"] += 1
            stamp = self._clock.stamp(message.time_boot_ms * 1_000_000, arrival_ns)
            unix_ns = message.time_unix_usec * 1000
            return SystemTime(stamp.stamp_ns, unix_ns) if unix_ns else None
        self.counts["other"] += 1
        return None

    def _attitude(self, message: mavlink.MAVLink_message, q_ned_frd: Quaternion, arrival_ns: int) -> Attitude | None:
        norm = math.hypot(*q_ned_frd)
        if not abs(norm - 1) < 0.01:  # also true of NaN
            self.counts["invalid"] += 1
            return None
        self.counts["attitude"] += 1
        stamp = self._clock.stamp(message.time_boot_ms * 1_000_000, arrival_ns)
        w, x, y, z = enu_flu_from_ned_frd(q_ned_frd)
        rates = (message.rollspeed, -message.pitchspeed, -message.yawspeed)
        return Attitude(
            stamp.stamp_ns,
            stamp.uncertainty_ns,
            (x / norm, y / norm, z / norm, w / norm),
            rates if all(map(math.isfinite, rates)) else None,
        )


def enu_flu_from_ned_frd(q: Quaternion) -> Quaternion:
    """R_world_body from north-east-down and forward-right-down to east-north-up and forward-left-up.

    As mavros has it: NED_ENU_Q * q * AIRCRAFT_BASELINK_Q, each side turned by its static rotation.
    """
    return _product(_product(NED_TO_ENU, q), FLU_TO_FRD)


def quaternion_from_rpy(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Rz(yaw) Ry(pitch) Rx(roll); angles in radians."""
    about_x = (math.cos(roll / 2), math.sin(roll / 2), 0.0, 0.0)
    about_y = (math.cos(pitch / 2), 0.0, math.sin(pitch / 2), 0.0)
    about_z = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
    return _product(_product(about_z, about_y), about_x)


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
