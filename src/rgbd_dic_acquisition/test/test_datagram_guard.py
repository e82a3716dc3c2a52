"""The guard on real sockets of the loopback interface."""

from __future__ import annotations

import socket

import pytest
from rgbd_dic_acquisition.drivers.datagram_guard import accept_only_from, let_wait
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


def test_more_waits_when_it_may():
    """The kernel gives twice what it is asked for, for what it keeps beside the datagrams (man 7 socket)."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2**30)
        most = ear.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2
        ear.bind(("127.0.0.1", 0))
        for asked in (most // 2, most // 4, 2 * most):
            let_wait(ear.getsockname()[1], asked)
            assert ear.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) == 2 * min(asked, most)
