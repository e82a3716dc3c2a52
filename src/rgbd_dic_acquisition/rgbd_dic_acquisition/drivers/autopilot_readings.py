"""What an autopilot's MAVLink messages say of attitude and time, in ROS' frames and in host time."""

from __future__ import annotations

import math
import time
from collections import Counter
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from .attitude import Quaternion, enu_flu_from_ned_frd, quaternion_from_rpy
from .autopilot_clock import AutopilotClock

Vector = tuple[float, float, float]

# How long ATTITUDE is left aside after an ATTITUDE_QUATERNION.
PREFER_QUATERNION_S = 1.0
LONGEST_PERIOD_S = 1.0
LATEST_UNIX_NS = 2**31 * 10**9  # what a ROS time can hold


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


class AutopilotReadings:
    """Takes the messages of one autopilot.

    Attributes:
        system: the autopilot's MAVLink system; 0 until one is heard.
        counts: messages by what became of them.
        heard_at, attitude_at, quaternion_at: when anything, an attitude, an ATTITUDE_QUATERNION came last
            [s, monotonic]; minus infinity before.
        period_s: between attitudes [s], by the autopilot's clock; LONGEST_PERIOD_S while not known.
    """

    def __init__(self, system: int, clock: AutopilotClock, counts: Counter[str]) -> None:
        self.system = system
        self.counts = counts
        self.heard_at = self.attitude_at = self.quaternion_at = -math.inf
        self.period_s = LONGEST_PERIOD_S
        self._clock = clock
        self._boot_ms = 0

    def is_from_autopilot(self, message: mavlink.MAVLink_message) -> bool:
        """Whether it is from the autopilot of the system that is read, or the first that is heard."""
        if message.get_srcComponent() != mavlink.MAV_COMP_ID_AUTOPILOT1:
            return False
        self.system = self.system or message.get_srcSystem()
        return message.get_srcSystem() == self.system

    def take(self, message: mavlink.MAVLink_message, arrival_ns: int) -> Attitude | SystemTime | None:
        """What a message of the autopilot says; None if it is of another kind or cannot be used."""
        kind = message.get_type()
        self.heard_at = now = time.monotonic()
        if kind == "ATTITUDE_QUATERNION":
            self.quaternion_at = now
            return self._attitude(message, (message.q1, message.q2, message.q3, message.q4), arrival_ns)
        if kind == "ATTITUDE" and now - self.quaternion_at > PREFER_QUATERNION_S:
            angles = (message.roll, message.pitch, message.yaw)
            q = quaternion_from_rpy(*angles) if all(map(math.isfinite, angles)) else (math.nan,) * 4
            return self._attitude(message, q, arrival_ns)
        if kind == "SYSTEM_TIME":
            return self._system_time(message, arrival_ns)
        if kind == "TIMESYNC":
            self._clock.timesync.reply(message.tc1, message.ts1, arrival_ns)
        self.counts[kind.lower() if kind in ("TIMESYNC", "HEARTBEAT") else "other"] += 1
        return None

    def _attitude(self, message: mavlink.MAVLink_message, q_ned_frd: Quaternion, arrival_ns: int) -> Attitude | None:
        norm = math.hypot(*q_ned_frd)
        if not abs(norm - 1) < 0.01 or message.time_boot_ms == 0:  # also true of NaN; 0 says that it is not known
            self.counts["invalid"] += 1
            return None
        if 0 <= self._boot_ms - message.time_boot_ms < LONGEST_PERIOD_S * 1e3:
            self.counts["overtaken"] += 1  # or sent twice within the step of the autopilot's clock
            return None
        self.counts["attitude"] += 1
        self.attitude_at = time.monotonic()
        self._observe_period(message.time_boot_ms)
        stamp = self._clock.stamp(message.time_boot_ms, arrival_ns)
        w, x, y, z = enu_flu_from_ned_frd(q_ned_frd)
        rates = (message.rollspeed, -message.pitchspeed, -message.yawspeed)
        return Attitude(
            stamp.stamp_ns,
            stamp.uncertainty_ns,
            (x / norm, y / norm, z / norm, w / norm),
            rates if all(map(math.isfinite, rates)) else None,
        )

    def _observe_period(self, boot_ms: int) -> None:
        passed_s = (boot_ms - self._boot_ms) * 1e-3
        if 0 < passed_s < LONGEST_PERIOD_S:
            is_first = self.period_s == LONGEST_PERIOD_S
            self.period_s = passed_s if is_first else self.period_s + (passed_s - self.period_s) / 4
        self._boot_ms = boot_ms

    def _system_time(self, message: mavlink.MAVLink_message, arrival_ns: int) -> SystemTime | None:
        """None also while the autopilot does not know the time itself."""
        unix_ns = message.time_unix_usec * 1000
        if message.time_boot_ms == 0 or unix_ns >= LATEST_UNIX_NS:
            self.counts["invalid"] += 1
            return None
        self.counts["system_time"] += 1
        stamp = self._clock.stamp(message.time_boot_ms, arrival_ns)
        return SystemTime(stamp.stamp_ns, unix_ns) if unix_ns else None
