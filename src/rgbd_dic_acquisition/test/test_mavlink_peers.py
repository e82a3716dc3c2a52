"""The autopilot's attitude in host time, from autopilots that are not pymavlink: MAVSDK and node-mavlink.

They fly a turn that is a function of host time (`peers/flight_truth.py`), so that attitude and stamp check each other.
"""

from __future__ import annotations

import contextlib
import random
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from autopilot_peers import Peer, Peers, SerialCable, free_port
from rgbd_dic_acquisition.drivers.attitude import enu_flu_from_ned_frd, quaternion_from_rpy
from rgbd_dic_acquisition.drivers.autopilot_readings import Attitude, SystemTime
from rgbd_dic_acquisition.drivers.mavlink import Autopilot, MavlinkSettings
from scipy.spatial.transform import Rotation

sys.path.append(str(Path(__file__).parent / "peers"))
from flight_truth import PITCH_RAD, ROLL_RAD, YAW_RATE_RAD_S, yaw_rad

DELAY_S = 0.02
# What two processes on two busy cores add to half a millisecond of time_boot_ms and the noise of TIMESYNC.
TOLERANCE_S = 3e-3


@pytest.fixture
def peers(tmp_path):
    started = Peers(tmp_path)
    yield started
    started.end()


class Link(NamedTuple):
    """Our end, how to start the other one, and what is in between."""

    autopilot: Autopilot
    start: Callable[..., Peer]
    cable: SerialCable | None
    port: int


@pytest.fixture
def connected(peers):
    """Makes a Link of some kind to an autopilot on MAVSDK."""
    closing = contextlib.ExitStack()

    def connect(kind, **settings):
        cable, port = None, free_port(socket.SOCK_STREAM if kind == "tcp" else socket.SOCK_DGRAM)
        if kind == "serial":
            cable = SerialCable()
            closing.callback(cable.unplug)
        theirs, ours = {
            "udp": (f"udpout://127.0.0.1:{port}", f"udpin://127.0.0.1:{port}"),
            "udpout": (f"udpin://127.0.0.1:{port}", f"udpout://127.0.0.1:{port}"),
            "tcp": (f"tcpin://127.0.0.1:{port}", f"tcp://127.0.0.1:{port}"),
            "serial": tuple(f"serial://{end}:115200" for end in (cable.ends if cable else ("", ""))),
        }[kind]
        autopilot = Autopilot(MavlinkSettings(url=ours, timesync_rate_hz=50.0, **settings))
        closing.callback(autopilot.close)
        return Link(autopilot, partial(peers.mavsdk, theirs), cable, port)

    with closing:
        yield connect


def read(autopilot, seconds=None, attitudes=None, until=lambda: False, limit_s=20.0):
    """Readings of so many seconds, or until there are so many attitudes, or until something is so."""
    readings, begin = [], time.monotonic()
    while not until():
        passed_s = time.monotonic() - begin
        if seconds is not None and passed_s > seconds:
            break
        if attitudes is not None and sum(isinstance(reading, Attitude) for reading in readings) >= attitudes:
            break
        assert passed_s < limit_s, (autopilot.problem, autopilot.counts)
        readings += autopilot.read(0.02)
    return readings


def settle(autopilot):
    """Until TIMESYNC has taken the delay off, which it does at a twentieth of the time that passes."""
    read(autopilot, until=lambda: autopilot.clock.is_synchronised)
    return read(autopilot, seconds=0.8)


def errors_s(readings):
    """How much later than the truth the stamps are, by the turn."""
    errors = []
    for reading in readings:
        if isinstance(reading, Attitude):
            q = enu_flu_from_ned_frd(quaternion_from_rpy(ROLL_RAD, PITCH_RAD, yaw_rad(reading.stamp_ns)))
            truth = Rotation.from_quat(np.roll(q, -1))
            turn = (truth * Rotation.from_quat(reading.orientation_xyzw).inv()).as_rotvec()
            assert np.hypot(turn[0], turn[1]) < 1e-4  # nothing but time is wrong; single precision
            errors.append(-turn[2] / YAW_RATE_RAD_S)  # yaw is counted downwards
    return np.array(errors)


def assert_right(readings):
    errors = errors_s(readings)
    assert len(errors) > 20
    assert np.median(np.abs(errors)) < TOLERANCE_S, errors
    stamps = [reading.stamp_ns for reading in readings if isinstance(reading, Attitude)]
    assert np.all(np.diff(stamps) > 0)


@pytest.mark.parametrize("kind", ["udp", "udpout", "tcp", "serial"])
def test_attitude_is_in_host_time(connected, kind):
    autopilot, start, *_ = connected(kind)
    start(delay_s=DELAY_S)
    first = read(autopilot, attitudes=10)
    assert np.median(errors_s(first)) > DELAY_S / 2, "arrival alone does not know of the delay"
    settle(autopilot)
    readings = read(autopilot, seconds=1.2)
    read(autopilot, until=lambda: not autopilot.problem)
    assert_right(readings)
    attitude = next(reading for reading in readings if isinstance(reading, Attitude))
    # The turn is about the vertical, down in north-east-down: in the tilted body, forward-left-up.
    np.testing.assert_allclose(
        Rotation.from_quat(attitude.orientation_xyzw).apply(attitude.angular_velocity),
        (0, 0, -YAW_RATE_RAD_S),
        atol=1e-6,
    )
    (unix, *_) = [reading for reading in readings if isinstance(reading, SystemTime)]
    assert abs(unix.unix_ns - unix.stamp_ns) < 20e6


def test_attitude_as_euler_angles(connected):
    autopilot, start, *_ = connected("udp")
    start(message="ATTITUDE")
    settle(autopilot)
    assert_right(read(autopilot, seconds=1))


def test_attitude_is_asked_for_where_it_does_not_come_by_itself(connected):
    autopilot, start, *_ = connected("udp", attitude_rate_hz=100.0)
    start(rate_hz=0.0)
    read(autopilot, attitudes=100)
    rates = 1e9 / np.diff([r.stamp_ns for r in read(autopilot, seconds=1) if isinstance(r, Attitude)])
    assert np.median(rates) == pytest.approx(100, rel=0.3)


def test_an_autopilot_that_sends_no_attitude_is_said(connected):
    autopilot, start, *_ = connected("udp")
    start(rate_hz=0.0)
    read(autopilot, until=lambda: "ask for it with link.attitude_rate_hz" in autopilot.problem)
    assert autopilot.counts["heartbeat"] + autopilot.counts["system_time"] > 0


@pytest.mark.parametrize("kind", ["udp", "tcp", "serial"])
def test_killed_and_restarted(connected, kind):
    """Silence is said; afterwards it goes on by itself with the new clock, and no stamp is wrong in between."""
    autopilot, start, *_ = connected(kind)
    peer = start(boot_s=300.0, delay_s=DELAY_S)
    settle(autopilot)
    peer.kill()
    read(autopilot, until=lambda: autopilot.problem)
    assert "no attitude for" in autopilot.problem or "is down" in autopilot.problem
    start(boot_s=5.0, delay_s=DELAY_S)
    first = read(autopilot, attitudes=20)
    assert autopilot.clock.restarts == 1
    assert np.all(np.abs(errors_s(first)) < DELAY_S + 0.5), "at the worst as late as it arrived"
    settle(autopilot)
    assert_right(read(autopilot, seconds=1))
    read(autopilot, until=lambda: not autopilot.problem)


@pytest.mark.parametrize("kind", ["udp", "tcp", "serial"])
def test_frozen_and_thawed(connected, kind):
    autopilot, start, *_ = connected(kind, silence_s=1.0)
    peer = start(delay_s=DELAY_S)
    settle(autopilot)
    peer.signal(signal.SIGSTOP)
    read(autopilot, until=lambda: "nothing heard for" in autopilot.problem)
    read(autopilot, seconds=1.5)
    peer.signal(signal.SIGCONT)
    read(autopilot, attitudes=50)
    settle(autopilot)
    readings = read(autopilot, seconds=1)
    assert_right(readings)
    read(autopilot, until=lambda: not autopilot.problem)
    assert autopilot.clock.restarts == 0


def test_garbage_on_its_port_costs_nothing(connected):
    """Another program sends nonsense to the same port all the time."""
    autopilot, start, _, port = connected("udp")
    start(delay_s=DELAY_S)
    read(autopilot, seconds=1)
    address = ("127.0.0.1", port)
    stop = threading.Event()

    def rave():
        rng = random.Random(3)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as source:
            while not stop.is_set():
                source.sendto(bytes([rng.choice([0xFD, 0xFE, 0x55])]) + rng.randbytes(rng.randrange(400)), address)
                time.sleep(0.001)

    thread = threading.Thread(target=rave)
    thread.start()
    try:
        settle(autopilot)
        answered = autopilot.counts["timesync"]
        readings = read(autopilot, seconds=1)
    finally:
        stop.set()
        thread.join()
    assert_right(readings)
    assert autopilot.counts["garbage"] > 100
    assert autopilot.counts["timesync"] - answered > 20, "requests must not go to who sends garbage"
    read(autopilot, until=lambda: not autopilot.problem)


def test_garbage_on_the_serial_line_costs_what_it_hits(connected):
    autopilot, start, cable, _ = connected("serial")
    start(delay_s=DELAY_S)
    settle(autopilot)
    rng = random.Random(4)
    readings = []
    for _ in range(100):
        cable.noise(bytes([0xFD]) + rng.randbytes(rng.randrange(1, 60)))
        readings += read(autopilot, seconds=0.02)
    assert_right(readings)
    assert len(errors_s(readings)) > 60
    read(autopilot, until=lambda: not autopilot.problem)


def test_node_mavlink(peers):
    port = free_port()
    autopilot = Autopilot(MavlinkSettings(url=f"udpin://127.0.0.1:{port}", timesync_rate_hz=50.0))
    peers.node_mavlink(port)
    settle(autopilot)
    readings = read(autopilot, seconds=1)
    autopilot.close()
    assert_right(readings)
    assert autopilot.clock.delivery_ns == pytest.approx(30e6, abs=5e6)
    assert autopilot.counts["garbage"] == autopilot.counts["invalid"] == 0
