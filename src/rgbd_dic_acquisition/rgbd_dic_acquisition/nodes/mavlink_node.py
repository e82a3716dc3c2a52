"""The autopilot: attitude of the vehicle and the time it believes in."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import Imu, TimeReference

from ..drivers.autopilot_readings import Attitude, SystemTime
from ..drivers.mavlink import Autopilot, MavlinkSettings
from ..messages import header_message, imu_message, stamp_message
from ..settings import setting
from .diagnostics import Diagnostics
from .parameters import declare
from .ros_messages import QosSettings, detail_qos, make
from .spinning import run

# The longest wait for the autopilot [s]: how late timers and signals may be.
WAIT_S = 0.02


@dataclass(frozen=True)
class MavlinkNodeSettings(QosSettings):
    """How the attitude is sent."""

    frame_id: str = setting("base_link", doc="frame of the vehicle: x forward, y left, z up")
    orientation_std_rad: float = setting(
        0.02, doc="standard deviation of the attitude about each axis", unit="rad", low=0.0, high=3.2
    )


class MavlinkNode(Node):
    """Publishes `imu/data` (east-north-up, forward-left-up) and `autopilot/time_reference`."""

    def __init__(self) -> None:
        super().__init__("mavlink_node")
        self._settings = declare(self, MavlinkNodeSettings)
        self._covariance = np.eye(3) * self._settings.orientation_std_rad**2
        self._autopilot = Autopilot(declare(self, MavlinkSettings, "link"))
        self._diagnostics = Diagnostics(self)
        self._counted: Counter[str] = Counter()
        self._restarts = 0
        qos = detail_qos(self._settings)
        self._imu = self._diagnostics.watch(self.create_publisher(Imu, "imu/data", qos))
        self._time = self._diagnostics.watch(self.create_publisher(TimeReference, "autopilot/time_reference", qos))

    def work(self) -> Iterator[float]:
        """Wait for the autopilot, so that the arrival is known at once, and publish what has come."""
        while True:
            for reading in self._autopilot.read(WAIT_S):
                self._publish(reading)
            self._report()
            yield 0.0

    def close(self) -> None:
        self._autopilot.close()

    def _publish(self, reading: Attitude | SystemTime) -> None:
        if isinstance(reading, Attitude):
            self._diagnostics.tell_stamp(reading.uncertainty_ns)
            message = imu_message(
                make,
                reading.stamp_ns,
                self._settings.frame_id,
                reading.orientation_xyzw,
                self._covariance,
                reading.angular_velocity,
            )
            self._imu.publish(message)
            return
        message = make(
            "sensor_msgs/msg/TimeReference",
            header=header_message(make, reading.stamp_ns, ""),
            time_ref=stamp_message(make, reading.unix_ns),
            source="autopilot",
        )
        self._time.publish(message)

    def _report(self) -> None:
        for name, count in (self._autopilot.counts - self._counted).items():
            self._diagnostics.count(name, count)
        self._counted = Counter(self._autopilot.counts)
        clock = self._autopilot.clock
        if clock.restarts != self._restarts:
            self._restarts = clock.restarts
            self.get_logger().warning("the autopilot was restarted; its clock is compared anew")
        self._diagnostics.tell("restarts of the autopilot", str(clock.restarts))
        self._diagnostics.tell("stamps by", "TIMESYNC" if clock.is_synchronised else "arrival", at_once=True)
        self._diagnostics.tell("shortest delivery taken off [ms]", f"{clock.delivery_ns * 1e-6:.2f}")
        self._diagnostics.tell("round trip of TIMESYNC [ms]", f"{clock.timesync.round_trip_ns * 1e-6:.2f}")
        if self._autopilot.problem:
            self._diagnostics.warn(self._autopilot.problem)
        else:
            self._diagnostics.ok()


def main(args: Sequence[str] | None = None) -> int:
    return run(MavlinkNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
