"""The guard on real sockets of the loopback interface."""

from __future__ import annotations

import socket

import pytest
from rgbd_dic_acquisition.drivers.datagram_guard import accept_only_from
from rgbd_dic_acquisition.errors import DeviceError


def test_one_sender_is_heard_and_others_are_not():
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as camera,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        ear.bind(("127.0.0.1", 0))
        ear.settimeout(5.0)
        camera.bind(("127.0.0.2", 0))
        stranger.bind(("127.0.0.3", 0))
        accept_only_from("127.0.0.2", ear.getsockname()[1])
        for number in range(3):
            stranger.sendto(b"stranger", ear.getsockname())
            camera.sendto(bytes([number]), ear.getsockname())
        assert [ear.recv(100) for _ in range(3)] == [b"\0", b"\1", b"\2"]
        ear.setblocking(False)
        with pytest.raises(BlockingIOError):
            ear.recv(100)


def test_a_port_of_nobody_is_an_error():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(DeviceError, match=f"no socket of this process is on port {port}"):
        accept_only_from("127.0.0.2", port)
