"""Hostile bytes on the autopilot's link: no crash, no hang, no growing memory, no reading that ROS cannot hold."""

from __future__ import annotations

import contextlib
import math
import random
import resource
import socket
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from autopilot_peers import free_port
from pymavlink.dialects.v20 import common as mavlink
from rgbd_dic_acquisition.bag import make_message
from rgbd_dic_acquisition.drivers.autopilot_readings import Attitude, SystemTime
from rgbd_dic_acquisition.drivers.mavlink import Autopilot, MavlinkSettings
from rgbd_dic_acquisition.message_types import serialise
from rgbd_dic_acquisition.messages import imu_message, stamp_message

IDS = sorted(mavlink.mavlink_map)
READ_IDS = (0, 2, 30, 31, 111)  # what the driver looks into
NASTY = [struct.pack("<f", x) for x in (math.nan, math.inf, -math.inf, 3e38, 0.0)] + [b"\xff" * 8, b"\0" * 8]
# What is kept for a link (parser, clocks, requests) is a few hundred kilobytes; the rest is room of the allocator.
MEMORY_BYTES = 8_000_000


def frame(rng, message_id, payload, sender=(1, 1), version=2):
    """A message with a right checksum, whatever is in it."""
    if version == 1 and message_id < 256:
        body = struct.pack("<BBBBB", len(payload), rng.randrange(256), *sender, message_id) + payload
        marker = b"\xfe"
    else:
        identifier = struct.pack("<I", message_id)[:3]
        flags = rng.choice([0, 0, 0, 1, 2, 255])
        body = struct.pack("<BBBBBB", len(payload), flags, rng.randrange(256), rng.randrange(256), *sender)
        body += identifier + payload
        marker = b"\xfd"
    extra = mavlink.mavlink_map[message_id].crc_extra if message_id in mavlink.mavlink_map else 0
    checksum = mavlink.x25crc(body + bytes([extra])).crc
    signature = rng.randbytes(13) if marker == b"\xfd" and body[1] & 1 else b""
    return marker + body + struct.pack("<H", checksum) + signature


def payload(rng, message_id):
    size = mavlink.mavlink_map[message_id].unpacker.size if rng.random() < 0.8 else rng.randrange(256)
    data = bytearray(rng.randbytes(size))
    while data and rng.random() < 0.5:
        value = rng.choice(NASTY)
        at = rng.randrange(len(data))
        data[at : at + len(value)] = value[: len(data) - at]
    return bytes(data[:255])


def hostile(rng):
    """A piece of anything between noise and a message that is right in all but its content."""
    kind = rng.randrange(6)
    if kind == 0:
        return rng.randbytes(rng.randrange(1500))
    if kind == 1:
        return bytes([rng.choice([0xFD, 0xFE])]) * rng.randrange(600)
    if kind == 2:  # a known kind, as it might be sent by somebody else
        message_id = rng.choice(IDS)
        return frame(rng, message_id, payload(rng, message_id), (rng.randrange(256), rng.randrange(256)))
    message_id = rng.choice(READ_IDS)
    piece = frame(rng, message_id, payload(rng, message_id), version=rng.choice([1, 2]))
    if kind == 3:
        return piece[: rng.randrange(len(piece))]
    if kind == 4:
        changed = bytearray(piece)
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
        return bytes(changed)
    return piece


def check(readings, now_ns):
    """Each can be sent, and lies in no future."""
    for reading in readings:
        assert 0 < reading.stamp_ns <= now_ns
        if isinstance(reading, Attitude):
            assert math.hypot(*reading.orientation_xyzw) == pytest.approx(1)
            about = (make_message, reading.stamp_ns, "base_link", reading.orientation_xyzw, np.eye(3))
            serialise(imu_message(*about, reading.angular_velocity))
        else:
            assert isinstance(reading, SystemTime)
            serialise(stamp_message(make_message, reading.unix_ns))


def attack(send, autopilot, seconds, seed):
    """At least a thousand pieces, and for so long; by how much memory has grown since the first quarter [bytes]."""
    rng = random.Random(seed)
    begin, early, pieces = time.monotonic(), 0, 0
    while pieces < 1000 or time.monotonic() - begin < seconds:
        send(hostile(rng))
        check(autopilot.read(), time.time_ns())
        pieces += 1
        if pieces == 250:
            early = resident_bytes()
    return resident_bytes() - early


def resident_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def is_alive(send, autopilot):
    """Afterwards good messages get through, with stamps of now."""
    good = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    send(b"\0" * 300)  # ends whatever was begun
    begin = time.monotonic()
    for _ in range(100):
        boot_ms = 50_000 + round(1000 * (time.monotonic() - begin))
        send(good.attitude_encode(boot_ms, 0.1, 0.2, 0.3, 0, 0, 0).pack(good))
        time.sleep(0.01)
        now_ns = time.time_ns()
        readings = autopilot.read()
    assert readings and abs(readings[-1].stamp_ns - now_ns) < 50_000_000
    assert autopilot.counts["garbage"] > 0


@contextlib.contextmanager
def udp():
    port = free_port()
    autopilot = Autopilot(MavlinkSettings(url=f"udpin://127.0.0.1:{port}", system_id=1, silence_s=60.0))
    autopilot.read()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as source:
        yield lambda data: source.sendto(data, ("127.0.0.1", port)), autopilot
    autopilot.close()


@contextlib.contextmanager
def tcp():
    with socket.create_server(("127.0.0.1", 0)) as server:
        autopilot = Autopilot(
            MavlinkSettings(url=f"tcp://127.0.0.1:{server.getsockname()[1]}", system_id=1, silence_s=60.0)
        )
        autopilot.read()
        source, _ = server.accept()
        with source:
            source.settimeout(10)
            source.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            yield source.sendall, autopilot
    autopilot.close()


@pytest.mark.parametrize("link", [udp, tcp])
@pytest.mark.parametrize("seconds", [0.0, pytest.param(60.0, marks=pytest.mark.slow)])
def test_hostile_bytes(link, seconds):
    with link() as (send, autopilot):
        assert attack(send, autopilot, seconds, seed=1) < MEMORY_BYTES
        is_alive(send, autopilot)


def test_a_flood_does_not_hold_up_a_reading():
    """Far more than can be read: each call takes a bounded part of it."""
    with tcp() as (send, autopilot):
        noise = random.Random(2).randbytes(1_000_000)
        for _ in range(20):
            with contextlib.suppress(TimeoutError):
                send(noise[:60_000])
            before = sum(autopilot.counts.values())
            autopilot.read()
            assert sum(autopilot.counts.values()) - before <= 16 * 1024


def test_only_udpin_listens_and_only_where_it_is_told():
    """By the kernel's tables: no address but the loopback one, for any kind of link."""
    ports = [free_port() for _ in range(2)]
    with tcp() as (_, over_tcp), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there:
        there.bind(("127.0.0.1", ports[1]))
        links = [Autopilot(MavlinkSettings(url=f"udpin://127.0.0.1:{ports[0]}"))]
        links += [Autopilot(MavlinkSettings(url=f"udpout://127.0.0.1:{ports[1]}"))]
        for autopilot in links:
            autopilot.read()
        bound = [_kernel_address(autopilot._link.fileno()) for autopilot in (*links, over_tcp)]
        assert bound[0] == ("udp", "127.0.0.1", ports[0], "07")  # unconnected
        assert [entry[1] for entry in bound] == ["127.0.0.1"] * 3
        assert bound[1][3] == "01" and bound[2][3] == "01"  # connected: nobody else reaches them
        for autopilot in links:
            autopilot.close()
    assert MavlinkSettings().url == "udpin://127.0.0.1:14550"


def _kernel_address(descriptor):
    """(protocol, local address, port, state) of an open socket."""
    inode = Path(f"/proc/self/fd/{descriptor}").readlink().name.strip("socket:[]")
    for protocol in ("udp", "tcp"):
        for line in Path(f"/proc/net/{protocol}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] == inode:
                address, port = fields[1].split(":")
                return protocol, socket.inet_ntoa(struct.pack("<I", int(address, 16))), int(port, 16), fields[3]
    raise AssertionError(f"no socket {inode}")
