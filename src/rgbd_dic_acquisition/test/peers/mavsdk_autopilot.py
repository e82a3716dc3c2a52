"""An autopilot on the MAVLink implementation of MAVSDK, which shares no code with pymavlink.

It flies `flight_truth`, or plays a file there and back by the host's clock. It counts its own time from its start with
a drift, sends attitude and time late by a fixed delay as one that has much else to do, answers TIMESYNC at once, and
sets the rate of ATTITUDE_QUATERNION when it is told to.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import threading
import time
from collections import deque
from pathlib import Path

import numpy as np
from flight_truth import PITCH_RAD, ROLL_RAD, YAW_RATE_RAD_S, yaw_rad
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.mavlink_direct_server import MavlinkDirectServer, MavlinkMessage

QUATERNION = ("q1", "q2", "q3", "q4")  # w, x, y, z
SET_MESSAGE_INTERVAL, ATTITUDE_QUATERNION, ACCEPTED = 511, 31, 0


class Autopilot:
    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self.start_ns = time.time_ns()
        self.rate_hz = options.rate_hz
        self.played = None if options.played is None else np.load(options.played)
        self.log = None if options.log is None else options.log.open("a", buffering=1)
        configuration = Configuration.create_with_component_type(ComponentType.AUTOPILOT)
        self.mavsdk = Mavsdk(configuration)
        self.mavsdk.add_any_connection_with_handle(options.url)
        self.server = MavlinkDirectServer(self.mavsdk.server_component_by_type(ComponentType.AUTOPILOT))
        self.server.subscribe_message("TIMESYNC", self.answer_timesync)
        self.server.subscribe_command(SET_MESSAGE_INTERVAL, self.set_interval)

    def boot_ns(self, host_ns: int) -> int:
        elapsed_ns = host_ns - self.start_ns
        return round(self.options.boot_s * 1e9 + elapsed_ns + elapsed_ns * self.options.drift)

    def send(self, name: str, **fields: object) -> None:
        self.server.send_message(MavlinkMessage(message_name=name, fields_json=json.dumps(fields)))

    def answer_timesync(self, message: MavlinkMessage, _: object) -> None:
        received_ns = time.time_ns()
        fields = json.loads(message.fields_json)
        if int(fields["tc1"]) == 0:
            sender = {"target_system": message.system_id, "target_component": message.component_id}
            self.send("TIMESYNC", tc1=self.boot_ns(received_ns), ts1=int(fields["ts1"]), **sender)

    def set_interval(self, message: MavlinkMessage, _: object) -> None:
        fields = json.loads(message.fields_json)
        if int(fields["param1"]) == ATTITUDE_QUATERNION:
            self.rate_hz = 1e6 / float(fields["param2"])
        sender = {"target_system": message.system_id, "target_component": message.component_id}
        self.send("COMMAND_ACK", command=SET_MESSAGE_INTERVAL, result=ACCEPTED, **sender)

    def attitude(self, host_ns: int) -> tuple[str, dict[str, object]]:
        boot_ms = self.boot_ns(host_ns) // 1_000_000
        if self.played is not None:
            q = played_at(self.played, self.options.played_ns, host_ns)
            numbers = dict(zip(QUATERNION, q, strict=True))
            return "ATTITUDE_QUATERNION", {"time_boot_ms": boot_ms, **numbers, **dict.fromkeys(body_rates(), 0.0)}
        yaw = math.remainder(yaw_rad(host_ns), 2 * math.pi)
        rates = body_rates()
        if self.options.message == "ATTITUDE":
            angles = {"roll": ROLL_RAD, "pitch": PITCH_RAD, "yaw": yaw}
            return "ATTITUDE", {"time_boot_ms": boot_ms, **angles, **rates}
        q = dict(zip(QUATERNION, quaternion(ROLL_RAD, PITCH_RAD, yaw), strict=True))
        return "ATTITUDE_QUATERNION", {"time_boot_ms": boot_ms, **q, **rates}

    def system_time(self, host_ns: int) -> tuple[str, dict[str, object]]:
        return "SYSTEM_TIME", {"time_unix_usec": host_ns // 1000, "time_boot_ms": self.boot_ns(host_ns) // 1_000_000}

    def fly(self, stop: threading.Event) -> None:
        waiting: deque[tuple[int, int, str, dict[str, object]]] = deque()
        next_ns = next_time_ns = time.time_ns()
        while not stop.is_set():
            now_ns = time.time_ns()
            send_ns = now_ns + round(self.options.delay_s * 1e9)
            if self.rate_hz and now_ns >= next_ns:
                period_ns = round(1e9 / self.rate_hz)  # two in one millisecond would have the same time since boot
                next_ns = max(next_ns + period_ns, now_ns + period_ns // 2)
                waiting.append((send_ns, now_ns, *self.attitude(now_ns)))
            if now_ns >= next_time_ns:
                next_time_ns = max(next_time_ns + 10**9, now_ns)
                waiting.append((send_ns, now_ns, *self.system_time(now_ns)))
            while waiting and waiting[0][0] <= now_ns:
                _, measured_ns, name, fields = waiting.popleft()
                if self.log is not None and "q1" in fields:
                    self.log.write(
                        ",".join(str(each) for each in (measured_ns, *(fields[q] for q in QUATERNION))) + "\n"
                    )
                self.send(name, **fields)
            time.sleep(0.0005)


def played_at(quaternions: np.ndarray, there_ns: int, host_ns: int) -> tuple[float, ...]:
    """The one of (N, 4) that is shown at a host time, there and back."""
    phase_ns = host_ns % (2 * there_ns)
    part = min(phase_ns, 2 * there_ns - phase_ns) / there_ns
    return tuple(quaternions[round(part * (len(quaternions) - 1))].tolist())


def body_rates() -> dict[str, float]:
    """Of a turn about the vertical, in the forward-right-down axes of the tilted body [rad/s]."""
    return {
        "rollspeed": -math.sin(PITCH_RAD) * YAW_RATE_RAD_S,
        "pitchspeed": math.sin(ROLL_RAD) * math.cos(PITCH_RAD) * YAW_RATE_RAD_S,
        "yawspeed": math.cos(ROLL_RAD) * math.cos(PITCH_RAD) * YAW_RATE_RAD_S,
    }


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """w, x, y, z as MAVLink's mavlink_euler_to_quaternion has it."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("url", help="as MAVSDK has it: udpout://, tcpin:// or serial://")
    parser.add_argument("--message", default="ATTITUDE_QUATERNION", choices=("ATTITUDE_QUATERNION", "ATTITUDE"))
    parser.add_argument("--rate-hz", type=float, default=50.0, help="of attitude, until it is told another")
    parser.add_argument("--delay-s", type=float, default=0.0, help="from an attitude to its sending")
    parser.add_argument("--boot-s", type=float, default=100.0, help="its own time at the start")
    parser.add_argument("--drift", type=float, default=50e-6)
    parser.add_argument("--played", type=Path, help="(N, 4) w, x, y, z as a .npy file, there and back; rates are 0")
    parser.add_argument("--played-ns", type=int, help="from the first of them to the last")
    parser.add_argument("--log", type=Path, help="file for a line `host time,w,x,y,z` on each attitude that is sent")
    autopilot = Autopilot(parser.parse_args())
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    print("flying", flush=True)
    autopilot.fly(stop)
    autopilot.mavsdk.destroy()


if __name__ == "__main__":
    main()
