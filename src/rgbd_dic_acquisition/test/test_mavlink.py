"""The autopilot's attitude over real sockets; the peer is pymavlink's own connection class."""

from __future__ import annotations

import contextlib
import math
import os
import pty
import random
import socket
import time

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink
from rgbd_dic_acquisition.drivers.attitude import enu_flu_from_ned_frd, quaternion_from_rpy
from rgbd_dic_acquisition.drivers.autopilot_readings import Attitude, SystemTime
from rgbd_dic_acquisition.drivers.mavlink import Autopilot, MavlinkSettings
from rgbd_dic_acquisition.errors import SettingsError
from scipy.spatial.transform import Rotation

R_ENU_NED = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
R_FRD_FLU = np.diag([1, -1, -1])


def _free_port(kind=socket.SOCK_DGRAM):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def _matrix(q):
    w, x, y, z = q
    return Rotation.from_quat([x, y, z, w]).as_matrix()


def _read(autopilot, wanted, seconds=5.0):
    readings, end = [], time.monotonic() + seconds
    while len(readings) < wanted and time.monotonic() < end:
        readings += autopilot.read()
        time.sleep(0.001)
    return readings


@pytest.fixture
def udp():
    """(autopilot's side, our side) over UDP on loopback."""
    port = _free_port()
    autopilot = Autopilot(MavlinkSettings(url=f"udpin://127.0.0.1:{port}"))
    autopilot.read()
    peer = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=7, source_component=1, dialect="common")
    yield peer, autopilot
    peer.close()
    autopilot.close()


@pytest.mark.parametrize(
    ("rpy_deg", "enu_flu_rpy_deg"),
    [
        ((0, 0, 0), (0, 0, 90)),  # level, nose north: yaw is counted from east, counter-clockwise
        ((0, 0, 90), (0, 0, 0)),  # nose east
        ((0, 0, -90), (0, 0, 180)),
        ((10, 0, 90), (10, 0, 0)),  # right side down in both
        ((0, 20, 90), (0, -20, 0)),  # nose up is negative about an axis to the left
    ],
)
def test_known_attitudes(rpy_deg, enu_flu_rpy_deg):
    q = enu_flu_from_ned_frd(quaternion_from_rpy(*np.radians(rpy_deg)))
    expected = Rotation.from_euler("ZYX", np.array(enu_flu_rpy_deg)[::-1], degrees=True).as_matrix()
    np.testing.assert_allclose(_matrix(q), expected, atol=1e-12)


def test_any_attitude_is_both_frames_turned():
    rng = np.random.default_rng(7)
    for roll, pitch, yaw in rng.uniform(-math.pi, math.pi, (50, 3)):
        q = quaternion_from_rpy(roll, pitch, yaw)
        ned_frd = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
        np.testing.assert_allclose(_matrix(q), ned_frd, atol=1e-12)
        np.testing.assert_allclose(_matrix(enu_flu_from_ned_frd(q)), R_ENU_NED @ ned_frd @ R_FRD_FLU, atol=1e-12)


def test_attitude_arrives_turned_and_stamped(udp):
    peer, autopilot = udp
    before = time.time_ns()
    for k in range(50):
        peer.mav.attitude_quaternion_send(1000 + 10 * k, *quaternion_from_rpy(0.1, 0.2, 0.3), 0.4, 0.5, 0.6)
        time.sleep(0.01)
    readings = _read(autopilot, 50)
    assert len(readings) == 50
    assert all(isinstance(reading, Attitude) for reading in readings)
    q = enu_flu_from_ned_frd(quaternion_from_rpy(0.1, 0.2, 0.3))
    np.testing.assert_allclose(readings[0].orientation_xyzw, np.roll(q, -1), atol=1e-6)
    np.testing.assert_allclose(readings[0].angular_velocity, (0.4, -0.5, -0.6), atol=1e-6)
    stamps = np.array([reading.stamp_ns for reading in readings])
    assert np.all(np.diff(stamps) > 0)
    assert before <= stamps[0] <= stamps[-1] <= time.time_ns()
    assert autopilot.problem == ""


def test_the_quaternion_is_preferred_and_attitude_used_without_it(udp):
    peer, autopilot = udp
    peer.mav.attitude_send(10, 0.0, 0.0, math.pi / 2, 0, 0, 0)
    (first,) = _read(autopilot, 1)
    np.testing.assert_allclose(np.abs(first.orientation_xyzw), (0, 0, 0, 1), atol=1e-6)
    for k in range(5):
        peer.mav.attitude_quaternion_send(100 + k, 1, 0, 0, 0, 0, 0, 0)
        peer.mav.attitude_send(100 + k, 0.5, 0, 0, 0, 0, 0)
    readings = _read(autopilot, 10, seconds=0.3)
    assert len(readings) == 5
    assert autopilot.counts["other"] == 5


def test_system_time_and_our_heartbeat(udp):
    peer, autopilot = udp
    peer.mav.system_time_send(1_700_000_000_123_456, 5000)
    (reading,) = _read(autopilot, 1)
    assert isinstance(reading, SystemTime)
    assert reading.unix_ns == 1_700_000_000_123_456_000
    assert abs(reading.stamp_ns - time.time_ns()) < 1e9
    deadline, heartbeat = time.monotonic() + 3, None
    while heartbeat is None and time.monotonic() < deadline:
        autopilot.read()
        heartbeat = peer.recv_match(type="HEARTBEAT", blocking=False)
        time.sleep(0.005)
    assert heartbeat.type == mavlink.MAV_TYPE_ONBOARD_CONTROLLER
    assert heartbeat.get_srcComponent() == mavlink.MAV_COMP_ID_ONBOARD_COMPUTER


def test_others_on_the_link_are_not_the_autopilot(udp):
    peer, autopilot = udp
    peer.mav.attitude_send(10, 0, 0, 0, 0, 0, 0)
    peer.mav.srcComponent = mavlink.MAV_COMP_ID_GIMBAL
    peer.mav.attitude_send(11, 1, 0, 0, 0, 0, 0)
    peer.mav.srcComponent, peer.mav.srcSystem = 1, 8
    peer.mav.attitude_send(12, 1, 0, 0, 0, 0, 0)
    assert len(_read(autopilot, 3, seconds=0.3)) == 1


def test_not_a_rotation_is_not_published(udp):
    peer, autopilot = udp
    peer.mav.attitude_quaternion_send(10, math.nan, 0, 0, 0, 0, 0, 0)
    peer.mav.attitude_quaternion_send(20, 0, 0, 0, 0, 0, 0, 0)
    peer.mav.attitude_quaternion_send(30, 1, 0, 0, 0, math.nan, 0, 0)
    (reading,) = _read(autopilot, 3, seconds=0.3)
    assert reading.angular_velocity is None
    assert autopilot.counts["invalid"] == 2


def test_garbage_between_messages_costs_none_of_them(udp):
    peer, autopilot = udp
    rng = random.Random(5)
    for k in range(200):
        peer.port.sendto(
            bytes([rng.choice([0xFD, 0xFE, 0x55])]) + rng.randbytes(rng.randrange(400)), peer.destination_addr
        )
        peer.mav.attitude_send(10 * k + 10, 0, 0, 0, 0, 0, 0)
        if k % 20 == 19:
            time.sleep(0.01)
            autopilot.read()
    _read(autopilot, 200, seconds=0.5)
    assert autopilot.counts["attitude"] == 200
    assert autopilot.counts["garbage"] > 0


def test_a_restarted_autopilot_gets_a_new_clock(udp):
    peer, autopilot = udp
    for boot_ms in (100_000, 100_020, 30, 50):
        peer.mav.attitude_send(boot_ms, 0, 0, 0, 0, 0, 0)
        time.sleep(0.02)
        autopilot.read()
    assert autopilot.clock.restarts == 1
    assert autopilot.counts["attitude"] == 4


def test_silence_is_reported():
    port = _free_port()
    autopilot = Autopilot(MavlinkSettings(url=f"udpin://127.0.0.1:{port}", silence_s=0.2))
    assert autopilot.read() == []
    assert autopilot.problem == "nothing heard yet"
    peer = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_component=1, dialect="common")
    peer.mav.attitude_send(10, 0, 0, 0, 0, 0, 0)
    assert len(_read(autopilot, 1)) == 1
    time.sleep(0.3)
    autopilot.read()
    assert "nothing heard for 0.3 s" in autopilot.problem
    peer.mav.attitude_send(310, 0, 0, 0, 0, 0, 0)
    assert len(_read(autopilot, 1)) == 1
    assert autopilot.problem == ""
    peer.close()
    autopilot.close()


def test_tcp_comes_late_goes_and_comes_back():
    port = _free_port(socket.SOCK_STREAM)
    autopilot = Autopilot(MavlinkSettings(url=f"tcp://127.0.0.1:{port}"))
    _read(autopilot, 1, seconds=0.2)
    assert "is down" in autopilot.problem
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    for k in range(2):
        with socket.create_server(("127.0.0.1", port)) as server:
            server.setblocking(False)
            connection, end = None, time.monotonic() + 5
            while connection is None and time.monotonic() < end:
                autopilot.read()
                with contextlib.suppress(BlockingIOError):
                    connection = server.accept()[0]
            packed = [sender.attitude_encode(1000 * k + i + 1, 0, 0, 0, 0, 0, 0).pack(sender) for i in range(4)]
            connection.sendall(b"\xfd\x07" + packed[0][:9] + packed[0][:5])  # garbage, and cut in the middle
            connection.sendall(packed[0][5:] + b"".join(packed[1:]))
            assert len(_read(autopilot, 4)) == 4
            connection.close()
        _read(autopilot, 1, seconds=0.1)
        assert "is down" in autopilot.problem
    autopilot.close()


def test_a_serial_line_that_is_unplugged():
    master, slave = pty.openpty()
    autopilot = Autopilot(MavlinkSettings(url=f"serial://{os.ttyname(slave)}:115200"))
    os.close(slave)
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    autopilot.read()
    os.write(master, sender.attitude_encode(10, 0, 0, 0, 0, 0, 0).pack(sender))
    assert len(_read(autopilot, 1)) == 1
    os.close(master)
    _read(autopilot, 1, seconds=0.1)
    assert "is down" in autopilot.problem
    autopilot.close()


@pytest.mark.parametrize(
    "url",
    [
        "",
        "udp",
        "udp:1.2.3.4:5",
        "tcp://host",
        "tcp://host:port",
        "serial:///dev/ttyX:123",
        "serial://ttyX:115200",
    ],
)
def test_a_link_that_is_not_understood_is_refused(url):
    with pytest.raises(SettingsError, match="udpin://HOST:PORT"):
        MavlinkSettings(url=url)
